//! Prandtl-Ishlinskii with thresholds that widen with the speed of the input, so that loops open up as it moves faster.
//!
//! ```text
//! r_i(t) = r_i0 + beta_i |dp/dt|,    y = sum_i w_i H_{r_i(t)}(p)
//! ```
//!
//! The speed is the backward difference of the samples, zero at the first one, unless the caller knows better and gives it
//! ([`RateDependent::step_at_rate`]).
//!
//! # Dilation condition
//! The closed-form inverse of [`crate::prandtl_ishlinskii`], with the thresholds of the moment, stays exact as long as the distances
//! `r_i(t) - r_{i-1}(t)` between neighbouring thresholds, from the second operator with memory on, never decrease in time; they may not
//! even return after they grew, since the memory of the outer operator would then lie out of the inner one's reach. A speed that comes and
//! goes meets this in one way only: all `beta_i` of the operators with memory are equal, and the distances constant. (How the first
//! operator with memory moves against the threshold zero does not matter, so that value is free.) [`RateDependent::inverse`] asks for
//! exactly this; the forward model runs with any `beta_i >= 0`.
//!
//! The inverse needs the speed of the input that it is about to find. In feed-forward control that is the speed of the planned motion.
//!
//! Source: M. Al Janaideh and P. Krejci, "Inverse rate-dependent Prandtl-Ishlinskii model for feedforward compensation of hysteresis in a
//! piezomicropositioning actuator", IEEE/ASME Transactions on Mechatronics 18(5), 2013.
//!
//! NaN: a NaN input holds the output, and the speed of the next good sample is reckoned over one period from the last good one.

use crate::error::{not_negative, positive, same_length};
use crate::list::List;
use crate::{Error, Operator, PrandtlIshlinskii, Real, play};

/// Parameters of a [`RateDependent`] model; the three lists are of one length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateDependentConfig<'a, T> {
    /// Thresholds at rest, in the input's unit, ascending from zero or more.
    pub thresholds: &'a [T],
    /// Growth of each threshold with the input's speed, in seconds, zero or more.
    pub rate_coefficients_s: &'a [T],
    /// Weights, in output per input.
    pub weights: &'a [T],
    /// Sample period in seconds.
    pub sample_period_s: T,
}

/// A rate-dependent Prandtl-Ishlinskii model of at most `N` play operators.
///
/// ```
/// use hysteresis::{InverseRateDependent, RateDependent, RateDependentConfig, RateDependentState};
///
/// // At 10 bar/s the second threshold grows from 0.2 to 0.3 bar.
/// let model = RateDependent::<f64, 2>::new(&RateDependentConfig {
///     thresholds: &[0.0, 0.2],
///     rate_coefficients_s: &[0.0, 0.01],
///     weights: &[0.5, 0.5],
///     sample_period_s: 0.02,
/// })?;
/// let inverse: InverseRateDependent<f64, 2> = model.inverse()?;
/// let mut inverse_state: RateDependentState<f64, 2> = inverse.start();
/// let mut state = inverse.start();
/// let displacement_mm = model.step_at_rate(&mut state, 1.0, 10.0);
/// assert!((displacement_mm - 0.85).abs() < 1e-12);
/// assert!((state.plays()[1] - 0.7).abs() < 1e-12);
/// assert!((inverse.step_at_rate(&mut inverse_state, displacement_mm, 10.0) - 1.0).abs() < 1e-12);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateDependent<T, const N: usize> {
    at_rest: PrandtlIshlinskii<T, N>,
    rate_coefficients: List<T, N>,
    sample_period: T,
}

/// The inverse of a [`RateDependent`] model that meets the dilation condition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseRateDependent<T, const N: usize> {
    at_rest: PrandtlIshlinskii<T, N>,
    /// What a unit of speed adds to each threshold of the inverse, in output per input speed.
    growth: List<T, N>,
}

/// Memory of a [`RateDependent`] model or of its inverse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateDependentState<T, const N: usize> {
    plays: List<T, N>,
    last_input: Option<T>,
}

impl<T: Real, const N: usize> RateDependentState<T, N> {
    /// The outputs of the play operators, in the order of the thresholds.
    #[must_use]
    pub fn plays(&self) -> &[T] {
        self.plays.as_slice()
    }
}

/// One step with thresholds `r_i0 + growth_i * speed`.
fn step_at_rate<T: Real, const N: usize>(
    at_rest: &PrandtlIshlinskii<T, N>,
    growth: &List<T, N>,
    plays: &mut List<T, N>,
    input: T,
    speed: T,
) -> T {
    let mut output = T::ZERO;
    let parameters = at_rest.thresholds().iter().zip(growth.as_slice()).zip(at_rest.weights());
    for (((threshold, growth), weight), state) in parameters.zip(plays.as_mut_slice()) {
        *state = play::step(*threshold + *growth * speed, input, *state);
        output += *weight * *state;
    }
    output
}

impl<T: Real, const N: usize> RateDependent<T, N> {
    /// Builds the model.
    ///
    /// # Errors
    /// When lists differ in length or exceed `N`, thresholds do not increase strictly from zero or more, a rate coefficient is negative, the
    /// sample period is not above zero, or a number is not finite.
    pub fn new(config: &RateDependentConfig<'_, T>) -> Result<Self, Error> {
        let at_rest = PrandtlIshlinskii::new(config.thresholds, config.weights)?;
        same_length(config.thresholds.len(), config.rate_coefficients_s.len())?;
        for coefficient in config.rate_coefficients_s {
            not_negative("rate_coefficients_s", *coefficient)?;
        }
        Ok(Self {
            at_rest,
            rate_coefficients: List::from_slice(config.rate_coefficients_s)?,
            sample_period: positive("sample_period_s", config.sample_period_s)?,
        })
    }

    /// One step at a given rate of the input, in its unit a second; the sign does not matter.
    pub fn step_at_rate(&self, state: &mut RateDependentState<T, N>, input: T, input_rate: T) -> T {
        // A hold, as documented: a NaN must not become the reference of the next difference.
        if input.is_finite() {
            state.last_input = Some(input);
        }
        step_at_rate(&self.at_rest, &self.rate_coefficients, &mut state.plays, input, input_rate.abs())
    }

    /// The inverse model; the start states of the two match.
    ///
    /// # Errors
    /// When the model at rest has no inverse, the first rate coefficient is not zero (the first threshold must stay zero), or those of the
    /// other operators are not all equal (the dilation condition).
    pub fn inverse(&self) -> Result<InverseRateDependent<T, N>, Error> {
        let coefficients = self.rate_coefficients.as_slice();
        if coefficients.first().is_some_and(|first| *first != T::ZERO) {
            return Err(Error::NotInvertible { condition: "the first rate coefficient must be zero", index: 0 });
        }
        let unequal = coefficients.iter().skip(1).position(|coefficient| Some(coefficient) != coefficients.get(1));
        if let Some(position) = unequal {
            let condition = "the rate coefficients of all operators with memory must be equal (dilation condition)";
            return Err(Error::NotInvertible { condition, index: position + 1 });
        }
        let at_rest = self.at_rest.inverse()?;
        // r'_i = sum_{j <= i} w_j (r_i - r_j), and only the distance to the operator of threshold zero grows with the rate.
        let mut growth = List::zeros_like(&self.rate_coefficients);
        let linear_weight = self.at_rest.weights().first().copied().unwrap_or(T::ZERO);
        for (growth, coefficient) in growth.as_mut_slice().iter_mut().zip(coefficients) {
            *growth = linear_weight * *coefficient;
        }
        Ok(InverseRateDependent { at_rest, growth })
    }
}

impl<T: Real, const N: usize> InverseRateDependent<T, N> {
    /// All play operators at zero, as in the forward model's start.
    #[must_use]
    pub fn start(&self) -> RateDependentState<T, N> {
        RateDependentState { plays: List::zeros_like(&self.growth), last_input: None }
    }

    /// The input that gives this output at this rate of the input, in its unit a second; the sign does not matter.
    pub fn step_at_rate(&self, state: &mut RateDependentState<T, N>, output: T, input_rate: T) -> T {
        step_at_rate(&self.at_rest, &self.growth, &mut state.plays, output, input_rate.abs())
    }
}

impl<T: Real, const N: usize> Operator<T> for RateDependent<T, N> {
    type State = RateDependentState<T, N>;

    fn start(&self) -> RateDependentState<T, N> {
        RateDependentState { plays: List::zeros_like(&self.rate_coefficients), last_input: None }
    }

    fn step(&self, state: &mut RateDependentState<T, N>, input: T) -> T {
        let rate = (input - state.last_input.unwrap_or(input)) / self.sample_period;
        self.step_at_rate(state, input, rate)
    }
}
