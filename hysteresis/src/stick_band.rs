//! The stick band: an output that rests where it is until its input has moved away by more than the band, then jumps to it.
//!
//! ```text
//! y(k) = x(k)    when |x(k) - y(k-1)| > band
//! y(k) = y(k-1)  otherwise
//! ```
//!
//! The shape of stick-slip seen at a slow sample rate: dry friction holds the tip, elastic force builds up, and the slip is over within
//! a sample. Unlike a play operator, which follows at a distance, it catches up fully at every slip. Its memory is the last output; the
//! first input is the start.
//!
//! # NaN
//! A NaN input is no motion: the output holds.

use crate::error::not_negative;
use crate::{Error, Operator, Real};

/// One step: the new output, which is also the new state. `band` must not be negative; zero passes the input through.
///
/// # Deadline
/// A subtraction and two comparisons; made for the control tick.
#[inline]
#[must_use]
pub fn step<T: Real>(band: T, input: T, state: T) -> T {
    let moved = input - state;
    if moved > band || -moved > band { input } else { state }
}

/// A stick band with its width checked. The state is the last output, nothing before the first input.
///
/// ```
/// use hysteresis::{Operator, StickBand, stick_band};
///
/// let tip = StickBand::new(0.1)?; // mm
/// let mut state = tip.start();
/// let output_mm = [0.0, 0.05, 0.12].map(|friction_free_mm| tip.step(&mut state, friction_free_mm));
/// assert_eq!(output_mm, [0.0, 0.0, 0.12]);
/// assert_eq!(stick_band::step(tip.band(), 0.12, 0.0), 0.12);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StickBand<T> {
    band: T,
}

impl<T: Real> StickBand<T> {
    /// A stick band of this half-width, in the unit of its input.
    ///
    /// # Errors
    /// When the band is negative or not finite.
    pub fn new(band: T) -> Result<Self, Error> {
        Ok(Self { band: not_negative("band", band)? })
    }

    /// The half-width.
    #[must_use]
    pub fn band(&self) -> T {
        self.band
    }
}

impl<T: Real> Operator<T> for StickBand<T> {
    type State = Option<T>;

    fn start(&self) -> Self::State {
        None
    }

    fn step(&self, state: &mut Self::State, input: T) -> T {
        let output = state.map_or(input, |last| step(self.band, input, last));
        *state = Some(output);
        output
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rests_within_the_band_and_catches_up_beyond_it() {
        let stick = StickBand::new(0.25).unwrap();
        let mut state = stick.start();
        let inputs = [1.0, 1.2, 1.25, 1.3, 1.1, 1.06, 1.0, f64::NAN, 1.5];
        let outputs = inputs.map(|input| stick.step(&mut state, input));
        // 1.25 is not beyond the band, 1.3 is; from there 1.06 is within and 1.0 is beyond.
        assert_eq!(outputs, [1.0, 1.0, 1.0, 1.3, 1.3, 1.3, 1.0, 1.0, 1.5]);
        assert!(StickBand::new(-0.1).is_err() && StickBand::new(f64::NAN).is_err());
    }

    #[test]
    fn no_band_passes_everything() {
        let stick = StickBand::new(0.0f32).unwrap();
        let mut state = stick.start();
        for index in 0..100u8 {
            let input = f32::from(index % 17) * 0.01;
            assert_eq!(stick.step(&mut state, input), input);
        }
    }
}
