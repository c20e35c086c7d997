//! The first-order lag, discretised exactly for a stated course of the input between samples.
//!
//! `time_constant * dy/dt + y = x`. With `a = exp(-sample_period / time_constant)` its solution at the sample times is
//!
//! ```text
//! y(k) = y(k-1) + b0 (x(k) - y(k-1)) + b1 (x(k-1) - y(k-1)),    b0 + b1 = 1 - a
//! ```
//!
//! and the split between `b0` and `b1` depends on [`Hold`]. This form keeps an equilibrium `y = x` exactly, in any precision.
//!
//! Rounding: increments below half a unit in the last place of the output vanish, so in `f32` time constants of more than about a million
//! sample periods fall short of their end; use `f64` there, or a longer sample period.
//!
//! Source: G. F. Franklin, J. D. Powell, M. Workman, *Digital Control of Dynamic Systems*, 3rd ed., section 6.3 (hold equivalents).
//!
//! NaN: a NaN or infinite input makes the state NaN or infinite and it stays so until reset; keep such samples out.

use crate::error::{not_negative, positive};
use crate::{Error, Operator, Real};

/// What the input does between two samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Hold {
    /// It has had the newest value since the sample before: `b1 = 0`. No delay; the plain exponential filter.
    #[default]
    Newest,
    /// It keeps the sample's value until the next sample, as a converter's output does: `b0 = 0`. One sample of delay.
    Previous,
    /// It goes from sample to sample on a straight line: the most faithful for a sampled continuous signal.
    Linear,
}

/// Parameters of a [`Lag`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LagConfig<T> {
    /// Time constant in seconds, zero for no lag.
    pub time_constant_s: T,
    /// Sample period in seconds.
    pub sample_period_s: T,
    /// What the input does between samples.
    pub hold: Hold,
}

/// A first-order lag, ready to run.
///
/// ```
/// use hysteresis::{Hold, Lag, LagConfig, LagState, Operator};
///
/// let fill = Lag::new(&LagConfig { time_constant_s: 0.1, sample_period_s: 0.02, hold: Hold::Newest })?;
/// let mut state = LagState::at(0.0);
/// for _ in 0..5 {
///     fill.step(&mut state, 1.0);
/// }
/// // After one time constant.
/// let pressure_bar: f64 = state.output().expect("it has begun");
/// assert!((pressure_bar - (1.0 - (-1.0_f64).exp())).abs() < 1e-12);
///
/// let [newest, previous] = fill.coefficients();
/// assert_eq!(fill, Lag::from_coefficient(newest)?);
/// assert_eq!(previous, 0.0);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag<T> {
    newest: T,
    previous: T,
}

/// Memory of a [`Lag`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LagState<T> {
    last: Option<Last<T>>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Last<T> {
    input: T,
    output: T,
}

impl<T: Real> LagState<T> {
    /// In equilibrium at this input: the next sample moves away from there.
    pub fn at(value: T) -> Self {
        Self { last: Some(Last { input: value, output: value }) }
    }

    /// The last output; none before the first sample.
    pub fn output(&self) -> Option<T> {
        self.last.map(|last| last.output)
    }
}

impl<T: Real> Lag<T> {
    /// Builds the lag; coefficients are computed in double precision whatever `T` is.
    ///
    /// # Errors
    /// When the time constant is negative, the sample period is not above zero, or either is not finite.
    pub fn new(config: &LagConfig<T>) -> Result<Self, Error> {
        let time_constant = not_negative("time_constant_s", config.time_constant_s)?.to_f64();
        let period = positive("sample_period_s", config.sample_period_s)?.to_f64();
        let (newest, previous) = split(period / time_constant, config.hold);
        Ok(Self { newest: T::from_f64(newest), previous: T::from_f64(previous) })
    }

    /// The lag with `y(k) = y(k-1) + coefficient (x(k) - y(k-1))`; 1 is no lag.
    ///
    /// # Errors
    /// Unless 0 < `coefficient` <= 1.
    pub fn from_coefficient(coefficient: T) -> Result<Self, Error> {
        if positive("coefficient", coefficient)? > T::ONE {
            return Err(Error::OutOfDomain { parameter: "coefficient", domain: "at most one" });
        }
        Ok(Self { newest: coefficient, previous: T::ZERO })
    }

    /// `[b0, b1]`: the weights of the newest input and the one before.
    #[must_use]
    pub fn coefficients(&self) -> [T; 2] {
        [self.newest, self.previous]
    }
}

/// `(b0, b1)` for a sample period of `ratio` time constants, 0 < ratio <= infinity.
fn split(ratio: f64, hold: Hold) -> (f64, f64) {
    let whole = -libm::expm1(-ratio);
    match hold {
        Hold::Newest => (whole, 0.0),
        Hold::Previous => (0.0, whole),
        Hold::Linear => {
            let newest = if ratio < 0.5 {
                // 1 - (1 - exp(-h))/h cancels for small h; its series h/2! - h^2/3! + h^3/4! ... does not. Eighteen terms leave less
                // than 1e-22 of the first at h = 1/2.
                let mut term = ratio / 2.0;
                let mut sum = 0.0;
                for divisor in 3..21u8 {
                    sum += term;
                    term *= -ratio / f64::from(divisor);
                }
                sum
            } else {
                1.0 - whole / ratio
            };
            (newest, whole - newest)
        }
    }
}

impl<T: Real> Operator<T> for Lag<T> {
    type State = LagState<T>;

    /// No history: the first sample is taken as an equilibrium and comes out unchanged.
    fn start(&self) -> LagState<T> {
        LagState { last: None }
    }

    fn step(&self, state: &mut LagState<T>, input: T) -> T {
        let Last { input: before, output: last } = state.last.unwrap_or(Last { input, output: input });
        let output = last + self.newest * (input - last) + self.previous * (before - last);
        state.last = Some(Last { input, output });
        output
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.02;
    const TIME_CONSTANT_S: f64 = 0.2;

    fn lag(hold: Hold) -> Lag<f64> {
        Lag::new(&LagConfig { time_constant_s: TIME_CONSTANT_S, sample_period_s: PERIOD_S, hold }).unwrap()
    }

    #[test]
    fn a_step_is_answered_by_the_exact_exponential() {
        for (hold, delay) in [(Hold::Newest, 0), (Hold::Previous, 1)] {
            let (lag, mut state) = (lag(hold), LagState::at(0.0));
            for step in 0..2000u32 {
                let exact = 1.0 - libm::exp(-PERIOD_S * f64::from(step + 1 - delay) / TIME_CONSTANT_S);
                // Rounding of a contracting recursion: a few units in the last place.
                assert!((lag.step(&mut state, 1.0) - exact).abs() < 4e-15, "{hold:?} at {step}");
            }
        }
    }

    #[test]
    fn a_ramp_is_answered_exactly_when_the_input_goes_in_straight_lines() {
        let (lag, mut state) = (lag(Hold::Linear), LagState::at(0.0));
        for step in 1..2000u32 {
            let time = PERIOD_S * f64::from(step);
            let exact = time - TIME_CONSTANT_S * (1.0 - libm::exp(-time / TIME_CONSTANT_S));
            assert!((lag.step(&mut state, time) - exact).abs() < 1e-13, "at {step}");
        }
    }

    #[test]
    fn series_and_closed_form_of_the_linear_hold_meet() {
        // Either side of the switch at one half: the function is smooth, so the coefficients must be too.
        let (below, above) = (split(0.5 - 1e-13, Hold::Linear), split(0.5, Hold::Linear));
        assert!((below.0 - above.0).abs() < 1e-13 && (below.1 - above.1).abs() < 1e-13);
        // Far below, the leading terms are h/2 - h^2/6 and h/2 - h^2/3.
        let h = 1e-5;
        let (newest, previous) = split(h, Hold::Linear);
        assert!((newest / (h / 2.0 - h * h / 6.0) - 1.0).abs() < 1e-10);
        assert!((previous / (h / 2.0 - h * h / 3.0) - 1.0).abs() < 1e-10);
    }

    #[test]
    fn no_time_constant_is_no_lag() {
        for (hold, delay) in [(Hold::Newest, false), (Hold::Linear, false), (Hold::Previous, true)] {
            let lag = Lag::new(&LagConfig { time_constant_s: 0.0, sample_period_s: 0.1f32, hold }).unwrap();
            let mut state = LagState::at(0.0);
            assert_eq!(lag.step(&mut state, 3.0), if delay { 0.0 } else { 3.0 });
            assert_eq!(lag.step(&mut state, -1.0), if delay { 3.0 } else { -1.0 });
        }
    }

    #[test]
    fn an_equilibrium_is_kept_to_the_bit_for_ever() {
        let slow = Lag::new(&LagConfig { time_constant_s: 1e5f32, sample_period_s: 1e-3, hold: Hold::Linear }).unwrap();
        let mut state = slow.start();
        for _ in 0..1000 {
            assert_eq!(slow.step(&mut state, 0.1), 0.1);
        }
        assert_eq!(state.output(), Some(0.1));
    }

    #[test]
    fn refuses_what_is_no_lag() {
        let new = |time_constant_s, sample_period_s| Lag::new(&LagConfig { time_constant_s, sample_period_s, hold: Hold::Newest });
        assert_eq!(new(-1.0, 1.0).unwrap_err(), Error::OutOfDomain { parameter: "time_constant_s", domain: "zero or more" });
        assert_eq!(new(1.0, 0.0).unwrap_err(), Error::OutOfDomain { parameter: "sample_period_s", domain: "above zero" });
        assert_eq!(new(f64::NAN, 1.0).unwrap_err(), Error::NotFinite { parameter: "time_constant_s" });
        assert!(Lag::from_coefficient(0.0).is_err() && Lag::from_coefficient(1.01).is_err() && Lag::from_coefficient(1.0).is_ok());
    }
}
