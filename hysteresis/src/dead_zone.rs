//! Dead-zone operators and their superposition: a memoryless, monotone, piecewise linear curve through the origin.
//!
//! ```text
//! S_d(x) = max{ x - d, 0 }  for d > 0,    S_d(x) = min{ x - d, 0 }  for d < 0
//! S(x) = v_0 x + sum_j v_j S_{d_j}(x)
//! ```
//!
//! The slope beyond the j-th threshold, counted outwards from zero on either side, is `V_j = v_0 + v_1 + ... + v_j` of that side. Falling
//! slopes saturate; different sides are asymmetric. When all slopes are above zero the inverse is of the same form: thresholds
//! `d'_j = S(d_j)`, linear weight `1 / v_0`, weights `1 / V_j - 1 / V_{j-1}`.
//!
//! Source: K. Kuhnen, European Journal of Control 9(4), 2003, section 3.
//!
//! NaN: operators yield zero for NaN, but the linear term is NaN, and so is the sum.

use crate::error::{ascending, finite, same_length};
use crate::list::List;
use crate::{Error, Operator, Real};

/// One dead-zone operator: what `input` has beyond `threshold`, on the threshold's side of zero. At threshold zero it is the input.
#[inline]
#[must_use]
pub fn step<T: Real>(threshold: T, input: T) -> T {
    let beyond = input - threshold;
    if threshold == T::ZERO || (threshold > T::ZERO && beyond > T::ZERO) || (threshold < T::ZERO && beyond < T::ZERO) {
        beyond
    } else {
        T::ZERO
    }
}

/// A superposition of at most `M` dead-zone operators and a linear term. No memory: its state is `()`.
///
/// ```
/// use hysteresis::{DeadZones, dead_zone};
///
/// // A slope of 2 up to 1 mm, half a millimetre a millimetre beyond: saturation.
/// let curve = DeadZones::<f64, 2>::new(2.0, &[1.0], &[-1.5])?;
/// assert_eq!(curve.value(0.5), 1.0);
/// assert_eq!(curve.value(2.0), 2.5);
/// assert_eq!(curve.inverse()?.value(2.5), 2.0);
///
/// let beyond_mm = dead_zone::step(curve.thresholds()[0], 2.0);
/// assert_eq!(curve.linear_weight() * 2.0 + curve.weights()[0] * beyond_mm, 2.5);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadZones<T, const M: usize> {
    linear_weight: T,
    thresholds: List<T, M>,
    weights: List<T, M>,
}

impl<T: Real, const M: usize> DeadZones<T, M> {
    /// A curve from the weight of the linear term, the thresholds (either side of zero, ascending) and their weights.
    ///
    /// # Errors
    /// When the slices differ in length or exceed `M`, a number is not finite, thresholds do not increase strictly, or one is zero (that
    /// is the linear term).
    pub fn new(linear_weight: T, thresholds: &[T], weights: &[T]) -> Result<Self, Error> {
        finite("linear_weight", linear_weight)?;
        same_length(thresholds.len(), weights.len())?;
        ascending("dead_zone_thresholds", thresholds)?;
        if thresholds.contains(&T::ZERO) {
            return Err(Error::OutOfDomain { parameter: "dead_zone_thresholds", domain: "different from zero" });
        }
        for weight in weights {
            finite("dead_zone_weights", *weight)?;
        }
        Ok(Self { linear_weight, thresholds: List::from_slice(thresholds)?, weights: List::from_slice(weights)? })
    }

    /// Weight of the linear term: the slope at zero.
    #[must_use]
    pub fn linear_weight(&self) -> T {
        self.linear_weight
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

    /// The curve's value.
    #[must_use]
    pub fn value(&self, input: T) -> T {
        let mut output = self.linear_weight * input;
        for (threshold, weight) in self.thresholds().iter().zip(self.weights()) {
            output += *weight * step(*threshold, input);
        }
        output
    }

    /// The inverse curve.
    ///
    /// # Errors
    /// When a slope is not above zero (a curve that saturates fully has lost its input), or rounding merges two thresholds.
    pub fn inverse(&self) -> Result<Self, Error> {
        let mut inverse = *self;
        let slope_at_zero = self.linear_weight.to_f64();
        if slope_at_zero <= 0.0 {
            return Err(Error::NotInvertible { condition: "the linear weight must be above zero", index: 0 });
        }
        inverse.linear_weight = T::from_f64(1.0 / slope_at_zero);
        let negative = self.thresholds().iter().filter(|threshold| **threshold < T::ZERO).count();
        let (below, above) = inverse.weights.as_mut_slice().split_at_mut(negative.min(self.weights().len()));
        let falling = below.iter_mut().enumerate().rev();
        invert_side(slope_at_zero, falling)?;
        invert_side(slope_at_zero, above.iter_mut().enumerate().map(|(index, weight)| (index + negative, weight)))?;
        for threshold in inverse.thresholds.as_mut_slice() {
            *threshold = self.value(*threshold);
        }
        Self::new(inverse.linear_weight, inverse.thresholds(), inverse.weights())
    }
}

/// Replaces weights by those of the inverse, from the innermost outwards.
fn invert_side<'a, T: Real>(mut slope: f64, weights: impl Iterator<Item = (usize, &'a mut T)>) -> Result<(), Error> {
    for (index, weight) in weights {
        let before = slope;
        slope += weight.to_f64();
        if slope <= 0.0 {
            return Err(Error::NotInvertible { condition: "every slope of the dead-zone superposition must be above zero", index });
        }
        *weight = T::from_f64(-weight.to_f64() / (slope * before));
    }
    Ok(())
}

impl<T: Real, const M: usize> Operator<T> for DeadZones<T, M> {
    type State = ();

    fn start(&self) {}

    fn step(&self, _state: &mut (), input: T) -> T {
        self.value(input)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_has_the_slopes_of_its_partial_sums() {
        // Slopes from left to right: 1.5, 2 (around zero), 1, 0.5. All values are exact in binary.
        let curve = DeadZones::<f64, 4>::new(2.0, &[-1.0, 0.5, 1.0], &[-0.5, -1.0, -0.5]).unwrap();
        let values = [-3.0, -1.0, 0.0, 0.5, 1.0, 3.0].map(|input| curve.value(input));
        assert_eq!(values, [-5.0, -2.0, 0.0, 1.0, 1.5, 2.5]);
        let inverse = curve.inverse().unwrap();
        assert_eq!(inverse.thresholds(), [-2.0, 1.0, 1.5]);
        assert_eq!(inverse.linear_weight(), 0.5);
        for (output, input) in values.into_iter().zip([-3.0, -1.0, 0.0, 0.5, 1.0, 3.0]) {
            assert!((inverse.value(output) - input).abs() < 1e-15);
        }
    }

    #[test]
    fn a_curve_that_is_flat_somewhere_has_no_inverse() {
        let flat = |thresholds: &[f64], weights: &[f64]| DeadZones::<f64, 2>::new(1.0, thresholds, weights).unwrap().inverse().unwrap_err();
        let condition = "every slope of the dead-zone superposition must be above zero";
        assert_eq!(flat(&[-2.0, 2.0], &[0.5, -1.0]), Error::NotInvertible { condition, index: 1 });
        // Counted outwards: the threshold at -2 lies beyond the one at -1.
        assert_eq!(flat(&[-2.0, -1.0], &[-0.5, -0.5]), Error::NotInvertible { condition, index: 0 });
        assert!(DeadZones::<f64, 0>::new(0.0, &[], &[]).unwrap().inverse().is_err());
    }

    #[test]
    fn refuses_a_dead_zone_of_no_width() {
        let error = Error::OutOfDomain { parameter: "dead_zone_thresholds", domain: "different from zero" };
        assert_eq!(DeadZones::<f32, 2>::new(1.0, &[0.0], &[1.0]), Err(error));
        assert_eq!(DeadZones::<f32, 1>::new(1.0, &[1.0, 2.0], &[1.0, 1.0]), Err(Error::TooLong { capacity: 1, found: 2 }));
    }
}
