//! Logarithmic creep: after a step the output keeps moving by the same amount every decade of time.
//!
//! The law for a step `x` from rest is `y(t) = x (1 + gamma log10(t / t_0))`. To serve any input it is run as a Kelvin-Voigt chain of unit
//! instant compliance and `N` elements of equal compliance with retardation times in geometric progression,
//!
//! ```text
//! q = (t_1 / t_0)^(1/N),    J_j = gamma log10(q),    tau_j = t_0 q^(j + 1/2) exp(0.57721...),    j = 0 .. N-1
//! ```
//!
//! Euler's constant makes the sum meet the law without an offset, and half a step makes the total creep `gamma log10(t_1 / t_0)`, the law's
//! value at `t_1`. Between `5 t_0` and `t_1 / 20` the step response differs from the law by less than `0.035 gamma x` with one element a
//! decade (of which the ripple between elements is `0.018 gamma`), and by less than `0.015 gamma x` with two. Before `t_0` there is hardly
//! any creep, and after `t_1` it has ended: the law itself is unbounded at both ends.
//!
//! Source: the law in H. Jung and D.-G. Gweon, "Creep characteristics of piezoelectric actuators", Review of Scientific Instruments 71(4),
//! 2000; operators of linear creep in geometric progression in P. Krejci and K. Kuhnen, IEE Proc. Control Theory Appl. 148(3), 2001.
//!
//! NaN: as in [`crate::kelvin_voigt`].

use crate::error::{finite, positive};
use crate::{Error, Hold, KelvinVoigt, KelvinVoigtConfig, KelvinVoigtState, Operator, Real};

/// Euler's constant, the limit of 1 + 1/2 + ... + 1/n - ln n.
const EULER: f64 = 0.577_215_664_901_532_9;

/// Parameters of a [`LogCreep`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogCreepConfig<T> {
    /// Creep a decade of time, as a fraction of the step.
    pub creep_per_decade: T,
    /// Time from which the law counts, in seconds.
    pub shortest_time_s: T,
    /// Time at which creep ends, in seconds.
    pub longest_time_s: T,
    /// Sample period in seconds.
    pub sample_period_s: T,
    /// What the input does between samples.
    pub hold: Hold,
}

/// Logarithmic creep by `N` elements.
///
/// ```
/// use hysteresis::{Hold, LogCreep, LogCreepConfig, Operator};
///
/// // 2 % of a step for every decade of time, from 0.1 s to 1000 s.
/// let creep = LogCreep::<f64, 4>::new(&LogCreepConfig {
///     creep_per_decade: 0.02,
///     shortest_time_s: 0.1,
///     longest_time_s: 1000.0,
///     sample_period_s: 0.02,
///     hold: Hold::Newest,
/// })?;
/// let mut state = creep.state_at(0.0);
/// let mut displacement_mm = 0.0;
/// for _ in 0..500 {
///     displacement_mm = creep.step(&mut state, 1.0);
/// }
/// // After 10 s, two decades.
/// assert!((displacement_mm - 1.04).abs() < 1e-3);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogCreep<T, const N: usize> {
    chain: KelvinVoigt<T, N>,
}

impl<T: Real, const N: usize> LogCreep<T, N> {
    /// Builds the chain.
    ///
    /// # Errors
    /// When a time is not above zero, the longest is not above the shortest, they span more than one decade an element (the sum would
    /// ripple), or a number is not finite.
    pub fn new(config: &LogCreepConfig<T>) -> Result<Self, Error> {
        let creep_per_decade = finite("creep_per_decade", config.creep_per_decade)?.to_f64();
        let shortest = positive("shortest_time_s", config.shortest_time_s)?.to_f64();
        let longest = positive("longest_time_s", config.longest_time_s)?.to_f64();
        if longest <= shortest {
            return Err(Error::OutOfDomain { parameter: "longest_time_s", domain: "above shortest_time_s" });
        }
        let decades_in_all = libm::log10(longest / shortest);
        let elements = (0..N).fold(0.0, |count, _| count + 1.0);
        // A hair of tolerance: four decades of f32 shall fit four elements.
        if decades_in_all > elements * (1.0 + 1e-6) {
            return Err(Error::OutOfDomain { parameter: "longest_time_s", domain: "at most one decade an element above shortest_time_s" });
        }
        let decades = decades_in_all / elements;
        let mut retardation_times_s = [T::ZERO; N];
        let mut position = 0.5;
        for time in &mut retardation_times_s {
            *time = T::from_f64(shortest * libm::exp(EULER) * libm::pow(10.0, decades * position));
            position += 1.0;
        }
        let chain = KelvinVoigt::new(&KelvinVoigtConfig {
            instant_compliance: T::ONE,
            compliances: &[T::from_f64(creep_per_decade * decades); N],
            retardation_times_s: &retardation_times_s,
            sample_period_s: config.sample_period_s,
            hold: config.hold,
        })?;
        Ok(Self { chain })
    }

    /// The state after this input has been there for ever. Zero is rest: a step from there shows the law.
    #[must_use]
    pub fn state_at(&self, input: T) -> KelvinVoigtState<T, N> {
        self.chain.state_at(input)
    }
}

impl<T: Real, const N: usize> Operator<T> for LogCreep<T, N> {
    type State = KelvinVoigtState<T, N>;

    /// No history: the first sample is taken to have been there for ever, fully crept.
    fn start(&self) -> KelvinVoigtState<T, N> {
        self.chain.start()
    }

    fn step(&self, state: &mut KelvinVoigtState<T, N>, input: T) -> T {
        self.chain.step(state, input)
    }
}
