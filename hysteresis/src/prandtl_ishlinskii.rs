//! The Prandtl-Ishlinskii model: a weighted sum of play operators, and its inverse, which is another one.
//!
//! With thresholds `r_0 < r_1 < ...`, weights `w_i` and plays `H_i` (see [`crate::play`]) the output is `y = sum_i w_i H_i(p)`.
//!
//! When `r_0 = 0` and every partial sum `W_i = w_0 + ... + w_i` is above zero (for i = 0 that is `w_0 > 0`), the model has an inverse of
//! the same form,
//!
//! ```text
//! r'_i = sum_{j <= i} w_j (r_i - r_j)
//! w'_0 = 1 / w_0,    w'_i = 1 / W_i - 1 / W_{i-1} = -w_i / (W_i W_{i-1})
//! H'_i = W_i H_i + sum_{j > i} w_j H_j                                       matching start states
//! ```
//!
//! and either order of the two is the identity. The `W_i` are the slopes of the curve that the model follows on its first loading: where
//! one is zero or negative, one output belongs to several inputs and no inverse exists. Single weights may be negative.
//!
//! Rounding: an error of the output is amplified by at most the largest `1 / W_i`; there is no accumulation from step to step, because a
//! play operator's new state is either the old one or computed from the input alone.
//!
//! Source: the paper's eq. (3); P. Krejci and K. Kuhnen, "Inverse control of systems with hysteresis and creep", IEE Proc. Control Theory
//! Appl. 148(3), 2001; K. Kuhnen, "Modeling, identification and compensation of complex hysteretic nonlinearities: a modified
//! Prandtl-Ishlinskii approach", European Journal of Control 9(4), 2003.
//!
//! # NaN and infinity
//! A NaN input holds the output: no play operator moves. An infinite input wipes the memory out, and gives NaN where weights of both signs
//! meet; the next finite input gives finite output again.

use crate::error::{ascending, finite, not_negative, same_length};
use crate::list::List;
use crate::{Error, Operator, Real, play};

/// One step of the model on slices of the caller's: advances `states`, returns `sum_i w_i H_i`.
///
/// The shortest slice decides how many operators are computed. For lists whose length is known only at run time; otherwise
/// [`PrandtlIshlinskii`] keeps the slices together and checked.
///
/// # Deadline
/// About six floating-point operations a play operator.
#[inline]
pub fn step<T: Real>(thresholds: &[T], weights: &[T], input: T, states: &mut [T]) -> T {
    play::step_bank(thresholds, input, states);
    sum(weights, states)
}

fn sum<T: Real>(weights: &[T], states: &[T]) -> T {
    let mut output = T::ZERO;
    for (weight, state) in weights.iter().zip(states) {
        output += *weight * *state;
    }
    output
}

/// Writes the inverse model's thresholds and weights; both are computed in double precision and then rounded.
///
/// # Errors
/// When the slices differ in length, thresholds are negative or do not increase strictly, the first threshold is not zero, or a partial
/// sum of the weights is not above zero. The outputs are unspecified then.
pub fn invert<T: Real>(thresholds: &[T], weights: &[T], inverse_thresholds: &mut [T], inverse_weights: &mut [T]) -> Result<(), Error> {
    for length in [weights.len(), inverse_thresholds.len(), inverse_weights.len()] {
        same_length(thresholds.len(), length)?;
    }
    check(thresholds, weights)?;
    if thresholds.first() != Some(&T::ZERO) {
        return Err(Error::NotInvertible { condition: "the first threshold must be zero", index: 0 });
    }
    let (mut slope, mut last_threshold, mut inverse_threshold) = (0.0, 0.0, 0.0);
    let parameters = thresholds.iter().zip(weights);
    for (index, ((threshold, weight), inverse)) in parameters.zip(inverse_thresholds.iter_mut().zip(inverse_weights)).enumerate() {
        // sum_{j <= i} w_j (r_i - r_j) grows by the slope so far times the distance to the next threshold.
        inverse_threshold += slope * (threshold.to_f64() - last_threshold);
        last_threshold = threshold.to_f64();
        let before = slope;
        slope += weight.to_f64();
        if slope <= 0.0 {
            return Err(Error::NotInvertible { condition: "every partial sum of the weights must be above zero", index });
        }
        *inverse.0 = T::from_f64(inverse_threshold);
        *inverse.1 = T::from_f64(if index == 0 { 1.0 / slope } else { -weight.to_f64() / (slope * before) });
    }
    Ok(())
}

fn check<T: Real>(thresholds: &[T], weights: &[T]) -> Result<(), Error> {
    same_length(thresholds.len(), weights.len())?;
    ascending("thresholds", thresholds)?;
    if let Some(first) = thresholds.first() {
        not_negative("thresholds", *first)?;
    }
    for weight in weights {
        finite("weights", *weight)?;
    }
    Ok(())
}

/// A Prandtl-Ishlinskii model of at most `N` play operators.
///
/// ```
/// use hysteresis::{Operator, PrandtlIshlinskii, PrandtlIshlinskiiState, prandtl_ishlinskii};
///
/// // Thresholds in bar, weights in mm/bar.
/// let model = PrandtlIshlinskii::<f64, 2>::new(&[0.0, 0.2], &[0.5, 0.5])?;
/// let mut state: PrandtlIshlinskiiState<f64, 2> = model.start();
/// assert_eq!(model.step(&mut state, 1.0), 0.9);
/// assert_eq!(state.plays(), [1.0, 0.8]);
/// assert_eq!(model.output(&state), 0.9);
///
/// // Model and inverse undo each other from any state that matches.
/// let inverse = model.inverse()?;
/// let mut inverse_state = inverse.inverse_state(&inverse.start());
/// assert_eq!(inverse_state, model.start());
/// inverse_state = model.inverse_state(&model.state_at(&[1.0, 0.8])?);
/// assert!((inverse.step(&mut inverse_state, 0.85) - 0.9).abs() < 1e-12);
///
/// // On slices of the caller's.
/// let (mut thresholds_mm, mut weights) = ([0.0; 2], [0.0; 2]);
/// prandtl_ishlinskii::invert(model.thresholds(), model.weights(), &mut thresholds_mm, &mut weights)?;
/// assert_eq!((thresholds_mm, weights), ([0.0, 0.1], [2.0, -1.0]));
/// assert_eq!(prandtl_ishlinskii::step(&[0.0, 0.2], &[0.5, 0.5], 1.0, &mut [0.0; 2]), 0.9);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrandtlIshlinskii<T, const N: usize> {
    thresholds: List<T, N>,
    weights: List<T, N>,
}

/// Memory of a [`PrandtlIshlinskii`] model: the outputs of its play operators.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrandtlIshlinskiiState<T, const N: usize> {
    plays: List<T, N>,
}

impl<T: Real, const N: usize> PrandtlIshlinskiiState<T, N> {
    /// The outputs of the play operators, in the order of the thresholds, in the input's unit.
    #[must_use]
    pub fn plays(&self) -> &[T] {
        self.plays.as_slice()
    }
}

impl<T: Real, const N: usize> PrandtlIshlinskii<T, N> {
    /// A model with these thresholds, in the input's unit, and weights, in output per input.
    ///
    /// # Errors
    /// When the slices differ in length or exceed `N`, a number is not finite, a threshold is negative, or they do not increase strictly.
    pub fn new(thresholds: &[T], weights: &[T]) -> Result<Self, Error> {
        check(thresholds, weights)?;
        Ok(Self { thresholds: List::from_slice(thresholds)?, weights: List::from_slice(weights)? })
    }

    /// The thresholds, ascending.
    #[must_use]
    pub fn thresholds(&self) -> &[T] {
        self.thresholds.as_slice()
    }

    /// The weights, in the order of the thresholds.
    #[must_use]
    pub fn weights(&self) -> &[T] {
        self.weights.as_slice()
    }

    /// A start state with these outputs of the play operators, in the order of the thresholds.
    ///
    /// # Errors
    /// When the number of outputs is not that of the operators, one is not finite, or no input history leads there: neighbours may differ
    /// by no more than their thresholds do (`|H_i - H_{i-1}| <= r_i - r_{i-1}`), and the inverse holds from such states only.
    pub fn state_at(&self, plays: &[T]) -> Result<PrandtlIshlinskiiState<T, N>, Error> {
        same_length(self.thresholds().len(), plays.len())?;
        for play in plays {
            finite("plays", *play)?;
        }
        for (index, (outputs, thresholds)) in plays.windows(2).zip(self.thresholds().windows(2)).enumerate() {
            if let ([before, after], [smaller, larger]) = (outputs, thresholds) {
                // A state that a run has left behind is off by the rounding of its two boundaries.
                let rounding = T::from_f64(4.0) * T::EPSILON * (before.abs() + after.abs() + *larger);
                if (*after - *before).abs() > *larger - *smaller + rounding {
                    return Err(Error::UnreachableState { index: index + 1 });
                }
            }
        }
        Ok(PrandtlIshlinskiiState { plays: List::from_slice(plays)? })
    }

    /// The output that belongs to a state, without a step.
    #[must_use]
    pub fn output(&self, state: &PrandtlIshlinskiiState<T, N>) -> T {
        sum(self.weights(), state.plays())
    }

    /// The inverse model: it turns outputs of this one back into inputs, and its outputs are the inputs that make this model give what is
    /// wanted.
    ///
    /// # Errors
    /// When the first threshold is not zero, a partial sum of the weights is not above zero, or a slope is so small beside another that
    /// rounding merges two thresholds of the inverse.
    pub fn inverse(&self) -> Result<Self, Error> {
        let (mut thresholds, mut weights) = (List::zeros_like(&self.thresholds), List::zeros_like(&self.weights));
        invert(self.thresholds(), self.weights(), thresholds.as_mut_slice(), weights.as_mut_slice())?;
        check(thresholds.as_slice(), weights.as_slice())?;
        Ok(Self { thresholds, weights })
    }

    /// The state of the inverse model that matches a state of this one: from there the two undo each other.
    ///
    /// The start states (all zero) match already.
    #[must_use]
    pub fn inverse_state(&self, state: &PrandtlIshlinskiiState<T, N>) -> PrandtlIshlinskiiState<T, N> {
        let mut inverse = PrandtlIshlinskiiState { plays: List::zeros_like(&self.weights) };
        let (mut slope, mut above) = (T::ZERO, self.output(state));
        for ((weight, play), inverse) in self.weights().iter().zip(state.plays()).zip(inverse.plays.as_mut_slice()) {
            slope += *weight;
            above = above - *weight * *play;
            *inverse = slope * *play + above;
        }
        inverse
    }
}

impl<T: Real, const N: usize> Operator<T> for PrandtlIshlinskii<T, N> {
    type State = PrandtlIshlinskiiState<T, N>;

    /// All play operators at zero; the first sample then follows the paper's initial condition.
    fn start(&self) -> PrandtlIshlinskiiState<T, N> {
        PrandtlIshlinskiiState { plays: List::zeros_like(&self.weights) }
    }

    fn step(&self, state: &mut PrandtlIshlinskiiState<T, N>, input: T) -> T {
        step(self.thresholds(), self.weights(), input, state.plays.as_mut_slice())
    }
}
