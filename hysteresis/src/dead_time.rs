//! Dead time (transport delay) by any fraction of a sample, in a ring buffer of fixed capacity.
//!
//! With the delay of `n + f` samples, `n` whole and `0 <= f < 1`, the output is `(1 - f) x(k-n) + f x(k-n-1)`: linear interpolation. Whole
//! delays are exact. A fraction damps a sine of angular frequency `w` (radians a sample) by `1 - |1 - f + f exp(-iw)|`, at most
//! `w^2 / 8`: 0.2 % at 50 samples a period, 5 % at 10.
//!
//! Source: T. I. Laakso et al., "Splitting the unit delay", IEEE Signal Processing Magazine 13(1), 1996 (first-order Lagrange
//! interpolation).
//!
//! NaN: a sample that is not finite comes out when its time has come (twice with a fraction) and leaves no trace after that.

use crate::error::{not_negative, positive};
use crate::{Error, Operator, Real};

/// A dead time of at most `N - 1` samples.
///
/// ```
/// use hysteresis::{DeadTime, DeadTimeState, Operator};
///
/// // 50 ms at a sample every 20 ms: two and a half samples.
/// let tube = DeadTime::<f64, 8>::from_seconds(0.05, 0.02)?;
/// assert_eq!(tube, DeadTime::new(2.5)?);
///
/// let mut state = DeadTimeState::at(0.0);
/// let output_bar = [1.0; 4].map(|pressure_bar| tube.step(&mut state, pressure_bar));
/// assert_eq!(output_bar, [0.0, 0.0, 0.5, 1.0]);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadTime<T, const N: usize> {
    whole: usize,
    fraction: T,
}

/// Memory of a [`DeadTime`]: the newest `N` samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadTimeState<T, const N: usize> {
    line: [T; N],
    newest: usize,
    started: bool,
}

impl<T: Real, const N: usize> DeadTimeState<T, N> {
    /// The input has been at this value for ever.
    #[must_use]
    pub fn at(value: T) -> Self {
        Self { line: [value; N], newest: 0, started: true }
    }
}

impl<T: Real, const N: usize> DeadTime<T, N> {
    /// A dead time in samples.
    ///
    /// # Errors
    /// When it is negative, not finite, or above `N - 1`.
    pub fn new(dead_time_samples: T) -> Result<Self, Error> {
        let mut fraction = not_negative("dead_time_samples", dead_time_samples)?;
        // Counting down needs no float-to-integer cast and is exact: N is small.
        let mut whole = 0;
        while fraction >= T::ONE && whole < N {
            fraction = fraction - T::ONE;
            whole += 1;
        }
        let oldest = if fraction > T::ZERO { whole + 1 } else { whole };
        if oldest >= N {
            return Err(Error::OutOfDomain { parameter: "dead_time_samples", domain: "at most the capacity minus one" });
        }
        Ok(Self { whole, fraction })
    }

    /// A dead time in seconds at a sample period in seconds.
    ///
    /// # Errors
    /// When the sample period is not above zero, or the quotient is refused by [`DeadTime::new`].
    pub fn from_seconds(dead_time_s: T, sample_period_s: T) -> Result<Self, Error> {
        Self::new(not_negative("dead_time_s", dead_time_s)? / positive("sample_period_s", sample_period_s)?)
    }
}

impl<T: Real, const N: usize> Operator<T> for DeadTime<T, N> {
    type State = DeadTimeState<T, N>;

    /// No history: the input is taken to have been at its first sample's value for ever.
    fn start(&self) -> DeadTimeState<T, N> {
        DeadTimeState { line: [T::ZERO; N], newest: 0, started: false }
    }

    fn step(&self, state: &mut DeadTimeState<T, N>, input: T) -> T {
        if !state.started {
            *state = DeadTimeState::at(input);
        }
        state.newest = if state.newest == 0 { N.saturating_sub(1) } else { state.newest - 1 };
        if let Some(slot) = state.line.get_mut(state.newest) {
            *slot = input;
        }
        let at = |age: usize| {
            let index = state.newest + age;
            state.line.get(if index >= N { index - N } else { index }).copied().unwrap_or(input)
        };
        let younger = at(self.whole);
        // Without a fraction the older sample must not matter, not even when it is infinite.
        if self.fraction == T::ZERO { younger } else { younger + self.fraction * (at(self.whole + 1) - younger) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_delays_are_exact_up_to_the_capacity() {
        for delay in 0..8u16 {
            let dead_time = DeadTime::<f32, 8>::new(f32::from(delay)).unwrap();
            let mut state = dead_time.start();
            for sample in 0..50u16 {
                assert_eq!(dead_time.step(&mut state, 0.1 * f32::from(sample)), 0.1 * f32::from(sample.saturating_sub(delay)));
            }
        }
    }

    #[test]
    fn a_ramp_is_delayed_exactly_by_any_fraction() {
        let (delay, slope) = (2.37, 0.25);
        let dead_time = DeadTime::<f64, 4>::new(delay).unwrap();
        let mut state = dead_time.start();
        for sample in 0..1000u32 {
            let output = dead_time.step(&mut state, slope * f64::from(sample));
            let exact = slope * (f64::from(sample) - delay);
            assert!(sample < 3 || (output - exact).abs() < 1e-12, "at {sample}: {output}, not {exact}");
        }
    }

    #[test]
    fn the_damping_of_a_sine_is_what_the_documentation_says() {
        let (fraction, frequency) = (0.5, 2.0 * core::f64::consts::PI / 10.0);
        let dead_time = DeadTime::<f64, 2>::new(fraction).unwrap();
        let mut state = dead_time.start();
        let mut largest = 0.0f64;
        for sample in 0..100_000u32 {
            // An offset of the phase that never repeats visits every point of the output sine.
            let output = dead_time.step(&mut state, libm::sin((frequency + 1e-4) * f64::from(sample)));
            largest = if sample > 0 { largest.max(output) } else { 0.0 };
        }
        let damping = 1.0 - largest;
        assert!((damping - (1.0 - libm::cos((frequency + 1e-4) / 2.0))).abs() < 1e-5, "{damping}");
        assert!(damping < frequency * frequency / 8.0);
    }

    #[test]
    fn a_sample_that_is_not_finite_leaves_no_trace() {
        for bad in [f64::NAN, f64::INFINITY] {
            let dead_time = DeadTime::<f64, 4>::new(1.0).unwrap();
            let mut state = dead_time.start();
            let outputs = [1.0, bad, 2.0, 3.0, 4.0].map(|input| dead_time.step(&mut state, input));
            assert_eq!(outputs[..2], [1.0, 1.0]);
            assert!(!outputs[2].is_finite());
            assert_eq!(outputs[3..], [2.0, 3.0]);
        }
    }

    #[test]
    fn refuses_what_does_not_fit_or_is_no_time() {
        let too_long = Error::OutOfDomain { parameter: "dead_time_samples", domain: "at most the capacity minus one" };
        assert_eq!(DeadTime::<f64, 4>::new(3.01), Err(too_long));
        assert_eq!(DeadTime::<f64, 4>::new(1e300), Err(too_long));
        assert_eq!(DeadTime::<f64, 0>::new(0.0), Err(too_long));
        assert!(DeadTime::<f64, 4>::new(3.0).is_ok() && DeadTime::<f64, 1>::new(0.0).is_ok());
        assert_eq!(DeadTime::<f64, 4>::new(-0.5), Err(Error::OutOfDomain { parameter: "dead_time_samples", domain: "zero or more" }));
        assert_eq!(
            DeadTime::<f64, 4>::from_seconds(0.06, 0.0),
            Err(Error::OutOfDomain { parameter: "sample_period_s", domain: "above zero" })
        );
        assert_eq!(DeadTime::<f64, 8>::from_seconds(0.06, 0.02), DeadTime::new(3.0));
    }
}
