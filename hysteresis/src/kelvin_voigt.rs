//! The Kelvin-Voigt chain: springs with dampers beside them, in series; linear creep with a few time constants.
//!
//! Element i, of compliance `J_i` and retardation time `tau_i`, answers the load `x` by `tau_i de_i/dt + e_i = J_i x`; a spring of compliance
//! `J_0` alone gives the instant part. The output is `y = J_0 x + sum_i e_i`, and a step of the load from rest gives
//! `y(t) / x = J_0 + sum_i J_i (1 - exp(-t / tau_i))`. Each element is discretised exactly, see [`crate::lag`], where the
//! limit of slow elements in `f32` stands too.
//!
//! Source: W. N. Findley, J. S. Lai, K. Onaran, *Creep and Relaxation of Nonlinear Viscoelastic Materials*, Dover 1989, section 5.
//!
//! NaN: a NaN or infinite input makes the state NaN or infinite and it stays so until reset; keep such samples out.

use crate::error::{finite, positive, same_length};
use crate::list::List;
use crate::{Error, Hold, Lag, LagConfig, Operator, Real};

/// Parameters of a [`KelvinVoigt`] chain; the two lists are of one length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KelvinVoigtConfig<'a, T> {
    /// Output per input of the lone spring.
    pub instant_compliance: T,
    /// Output per input of each element, fully crept.
    pub compliances: &'a [T],
    /// Time constant of each element in seconds, above zero.
    pub retardation_times_s: &'a [T],
    /// Sample period in seconds.
    pub sample_period_s: T,
    /// What the input does between samples.
    pub hold: Hold,
}

/// A chain of at most `N` Kelvin-Voigt elements and a spring.
///
/// ```
/// use hysteresis::{Hold, KelvinVoigt, KelvinVoigtConfig, KelvinVoigtState, Operator};
///
/// // 1 mm/bar at once, a fifth of it again with a time constant of 10 s.
/// let chain = KelvinVoigt::<f64, 1>::new(&KelvinVoigtConfig {
///     instant_compliance: 1.0,
///     compliances: &[0.2],
///     retardation_times_s: &[10.0],
///     sample_period_s: 0.1,
///     hold: Hold::Newest,
/// })?;
/// let mut state: KelvinVoigtState<f64, 1> = chain.state_at(0.0);
/// let mut displacement_mm = 0.0;
/// for _ in 0..100 {
///     displacement_mm = chain.step(&mut state, 1.0);
/// }
/// let crept = 1.0 - (-1.0_f64).exp();
/// assert!((displacement_mm - (1.0 + 0.2 * crept)).abs() < 1e-12);
/// assert!((state.yielded()[0] - crept).abs() < 1e-12);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KelvinVoigt<T, const N: usize> {
    instant_compliance: T,
    compliances: List<T, N>,
    newest: List<T, N>,
    previous: List<T, N>,
}

/// Memory of a [`KelvinVoigt`] chain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KelvinVoigtState<T, const N: usize> {
    last_input: Option<T>,
    /// Each element's deflection over its compliance: the load it has yielded to.
    yielded: List<T, N>,
}

impl<T: Real, const N: usize> KelvinVoigtState<T, N> {
    /// The load that each element has yielded to, in the input's unit; all equal to the input when creep has come to its end.
    #[must_use]
    pub fn yielded(&self) -> &[T] {
        self.yielded.as_slice()
    }
}

impl<T: Real, const N: usize> KelvinVoigt<T, N> {
    /// Builds the chain; coefficients are computed in double precision whatever `T` is.
    ///
    /// # Errors
    /// When the lists differ in length or exceed `N`, a time is not above zero, or a number is not finite.
    pub fn new(config: &KelvinVoigtConfig<'_, T>) -> Result<Self, Error> {
        same_length(config.compliances.len(), config.retardation_times_s.len())?;
        finite("instant_compliance", config.instant_compliance)?;
        for compliance in config.compliances {
            finite("compliances", *compliance)?;
        }
        positive("sample_period_s", config.sample_period_s)?;
        let compliances = List::from_slice(config.compliances)?;
        let (mut newest, mut previous) = (List::zeros_like(&compliances), List::zeros_like(&compliances));
        let coefficients = newest.as_mut_slice().iter_mut().zip(previous.as_mut_slice());
        for ((newest, previous), time_constant) in coefficients.zip(config.retardation_times_s) {
            let time_constant_s = positive("retardation_times_s", *time_constant)?;
            let lag = Lag::new(&LagConfig { time_constant_s, sample_period_s: config.sample_period_s, hold: config.hold })?;
            [*newest, *previous] = lag.coefficients();
        }
        Ok(Self { instant_compliance: config.instant_compliance, compliances, newest, previous })
    }

    /// The state after this input has been there for ever. Zero is rest: a step from there shows the whole creep.
    #[must_use]
    pub fn state_at(&self, input: T) -> KelvinVoigtState<T, N> {
        let mut yielded = List::zeros_like(&self.compliances);
        yielded.as_mut_slice().fill(input);
        KelvinVoigtState { last_input: Some(input), yielded }
    }
}

impl<T: Real, const N: usize> Operator<T> for KelvinVoigt<T, N> {
    type State = KelvinVoigtState<T, N>;

    /// No history: the first sample is taken to have been there for ever, fully crept.
    fn start(&self) -> KelvinVoigtState<T, N> {
        KelvinVoigtState { last_input: None, yielded: List::zeros_like(&self.compliances) }
    }

    fn step(&self, state: &mut KelvinVoigtState<T, N>, input: T) -> T {
        let before = match state.last_input {
            Some(before) => before,
            None => {
                *state = self.state_at(input);
                input
            }
        };
        state.last_input = Some(input);
        let mut output = self.instant_compliance * input;
        let coefficients = self.newest.as_slice().iter().zip(self.previous.as_slice());
        for (((newest, previous), compliance), yielded) in coefficients.zip(self.compliances.as_slice()).zip(state.yielded.as_mut_slice()) {
            let last = *yielded;
            *yielded = last + *newest * (input - last) + *previous * (before - last);
            output += *compliance * *yielded;
        }
        output
    }
}
