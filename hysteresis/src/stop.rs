//! The stop operator: the part of the input that a play operator does not follow, an elastic, ideally plastic spring.
//!
//! ```text
//! E(k) = min{ r, max{ -r, E(k-1) + p(k) - p(k-1) } },    E(0) = min{ r, max{ -r, p(0) } }
//! ```
//!
//! It is computed as `p - H`, with `H` the play operator of the same threshold: the two are the same function (M. Brokate and
//! J. Sprekels, *Hysteresis and Phase Transitions*, Springer 1996, section 2.3), and the difference does not collect rounding errors from
//! step to step as the recursion above does. Hence stop + play is the input, up to one rounding.
//!
//! NaN: the output is NaN for a NaN input, and the state is kept; see [`crate::play`].

use crate::error::not_negative;
use crate::{Error, Operator, Real, play};

/// One step of a stop operator: its output. `play_state` is the play operator's state of the same threshold, and is advanced.
#[inline]
pub fn step<T: Real>(threshold: T, input: T, play_state: &mut T) -> T {
    *play_state = play::step(threshold, input, *play_state);
    input - *play_state
}

/// A stop operator with its threshold checked; its state is that of the play operator, zero at the start.
///
/// ```
/// use hysteresis::{Operator, Stop, stop};
///
/// let friction = Stop::new(0.25)?; // mm of elastic travel before it yields
/// let mut state = friction.start();
/// assert_eq!(friction.step(&mut state, 0.125), 0.125);
/// assert_eq!(friction.step(&mut state, 2.0), friction.threshold());
///
/// let mut play_state = 0.0;
/// assert_eq!(stop::step(0.25, 2.0, &mut play_state), 0.25);
/// assert_eq!(play_state, 1.75);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop<T> {
    threshold: T,
}

impl<T: Real> Stop<T> {
    /// A stop operator that yields at this magnitude, in the input's unit.
    ///
    /// # Errors
    /// When `threshold` is negative or not finite.
    pub fn new(threshold: T) -> Result<Self, Error> {
        Ok(Self { threshold: not_negative("threshold", threshold)? })
    }

    /// The magnitude at which it yields.
    #[must_use]
    pub fn threshold(&self) -> T {
        self.threshold
    }
}

impl<T: Real> Operator<T> for Stop<T> {
    type State = T;

    fn start(&self) -> T {
        T::ZERO
    }

    fn step(&self, state: &mut T, input: T) -> T {
        step(self.threshold, input, state)
    }
}
