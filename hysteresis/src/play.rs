//! The play (backlash) operator, the memory that Prandtl-Ishlinskii models are made of.
//!
//! Input `p` drags the output `H` through a slack of half-width `r`, the *threshold*:
//!
//! ```text
//! H(k) = max{ p(k) - r, min{ p(k) + r, H(k-1) } }
//! H(0) = max{ p(0) - r, min{ p(0) + r, 0 } }
//! ```
//!
//! The state is the last output; zero is the start, and the second line is the first with that state. Any other finite start state is
//! as good.
//!
//! Source: M. A. Krasnosel'skii and A. V. Pokrovskii, *Systems with Hysteresis*, Springer 1989; the discrete form as printed in
//! "Towards Modeling of Hysteresis in Robotic Catheters based on LSTM", eq. (2).
//!
//! # NaN and infinity
//! A NaN input leaves the state as it is and returns it: the output holds. An infinite input makes the state infinite, and the next
//! finite input brings it back to that input's boundary; the memory before is lost. A NaN state stays NaN.

use crate::error::not_negative;
use crate::{Error, Operator, Real};

/// One step of a play operator: the new output, which is also the new state.
///
/// `threshold` must not be negative. Input, state and threshold share one unit. Never fails and never panics.
///
/// # Deadline
/// An addition, a subtraction and two comparisons; made for the control tick.
#[inline]
#[must_use]
pub fn step<T: Real>(threshold: T, input: T, state: T) -> T {
    let (low, high) = (input - threshold, input + threshold);
    // Comparisons in this order hold the state when the input is NaN.
    if state < low {
        low
    } else if state > high {
        high
    } else {
        state
    }
}

/// One step of many play operators on the same input: `states[i]` becomes the output of the operator with `thresholds[i]`.
///
/// The shorter of the two slices decides how many are computed.
#[inline]
pub fn step_bank<T: Real>(thresholds: &[T], input: T, states: &mut [T]) {
    for (threshold, state) in thresholds.iter().zip(states) {
        *state = step(*threshold, input, *state);
    }
}

/// A play operator with its threshold checked. The state is the last output, zero at the start.
///
/// ```
/// use hysteresis::{Operator, Play, play};
///
/// let slack = Play::new(0.1)?; // bar
/// let mut state = slack.start();
/// assert_eq!(slack.step(&mut state, 0.5), 0.4);
/// assert_eq!(slack.step(&mut state, 0.45), 0.4, "back within the slack: the output stays");
/// assert_eq!(slack.threshold(), 0.1);
///
/// // Without the type: one step, and one step of a bank.
/// assert_eq!(play::step(0.1, 0.5, 0.0), 0.4);
/// let mut outputs_bar = [0.0; 2];
/// play::step_bank(&[0.0, 0.1], 0.5, &mut outputs_bar);
/// assert_eq!(outputs_bar, [0.5, 0.4]);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Play<T> {
    threshold: T,
}

impl<T: Real> Play<T> {
    /// A play operator of this half-width, in the input's unit.
    ///
    /// # Errors
    /// When `threshold` is negative or not finite.
    pub fn new(threshold: T) -> Result<Self, Error> {
        Ok(Self { threshold: not_negative("threshold", threshold)? })
    }

    /// The half-width.
    #[must_use]
    pub fn threshold(&self) -> T {
        self.threshold
    }
}

impl<T: Real> Operator<T> for Play<T> {
    type State = T;

    fn start(&self) -> T {
        T::ZERO
    }

    fn step(&self, state: &mut T, input: T) -> T {
        *state = step(self.threshold, input, *state);
        *state
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_sample_follows_the_papers_initial_condition() {
        let play = Play::new(0.3).unwrap();
        for (input, output) in [(0.0, 0.0), (0.2, 0.0), (-0.2, 0.0), (0.3, 0.0), (1.0, 1.0 - 0.3), (-1.0, -1.0 + 0.3)] {
            assert_eq!(play.step(&mut play.start(), input), output);
        }
    }

    #[test]
    fn any_start_state_is_dragged_only_as_far_as_needed() {
        // All values are exact in binary.
        let play = Play::new(0.25).unwrap();
        for (start, input, output) in [(0.5, 0.5, 0.5), (0.5, 0.75, 0.5), (0.5, 1.0, 0.75), (0.5, 0.0, 0.25), (-8.0, 0.0, -0.25)] {
            let mut state = start;
            assert_eq!(play.step(&mut state, input), output);
            assert_eq!(state, output);
        }
    }

    #[test]
    fn a_nan_input_holds_and_an_infinite_one_loses_the_memory() {
        let play = Play::new(0.5).unwrap();
        let mut state = 2.0;
        assert_eq!(play.step(&mut state, f64::NAN), 2.0);
        assert_eq!(play.step(&mut state, f64::INFINITY), f64::INFINITY);
        assert_eq!(play.step(&mut state, 1.0), 1.5);
        let mut state = f64::NAN;
        assert!(play.step(&mut state, 1.0).is_nan());
    }

    #[test]
    fn refuses_thresholds_that_are_no_width() {
        assert_eq!(Play::new(-1e-9), Err(Error::OutOfDomain { parameter: "threshold", domain: "zero or more" }));
        assert_eq!(Play::new(f32::NAN), Err(Error::NotFinite { parameter: "threshold" }));
        assert_eq!(Play::new(f32::INFINITY), Err(Error::NotFinite { parameter: "threshold" }));
    }

    #[test]
    fn a_bank_steps_each_operator_as_if_alone() {
        let thresholds = [0.0, 0.1, 0.7];
        let mut states = [0.0f32; 3];
        let mut alone = [0.0f32; 3];
        for input in [0.9, -0.3, 0.2, 0.25, -1.0] {
            step_bank(&thresholds, input, &mut states);
            for (threshold, state) in thresholds.iter().zip(&mut alone) {
                *state = step(*threshold, input, *state);
            }
            assert_eq!(states, alone);
            assert_eq!(states[0], input);
        }
    }
}
