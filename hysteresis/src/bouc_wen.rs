//! The Bouc-Wen model: hysteresis as a differential equation, smooth where play operators have corners.
//!
//! ```text
//! dz/dt = A dx/dt - beta |dx/dt| |z|^(n-1) z - gamma dx/dt |z|^n
//! y     = k (alpha x + (1 - alpha) z)
//! ```
//!
//! Every term of the right side has `dx/dt` to the first power, so time drops out: over the distance `s` that the input travels in the
//! direction `d` (+1 or -1), `dz/ds = d A - |z|^n (beta sgn z + gamma d)`. That equation is integrated, by the classical Runge-Kutta
//! method of fourth order in steps of a fixed *distance*; the model is rate-independent by construction and needs no sample period.
//! Between samples the input is taken to travel straight.
//!
//! With `beta > 0` and `-beta < gamma <= beta` the memory stays within `z_max = (A / (beta + gamma))^(1/n)` and the model dissipates energy.
//! `L = z_max / A` is its characteristic distance: after a travel of 40 of them in one direction the past counts for less than
//! `exp(-39)`, so of a longer travel only the last 40 are integrated, which bounds the cost of a sample.
//!
//! Accuracy: fourth order in the step where the right side is smooth. At `z = 0` its derivative of order `n` jumps in general, and a passage
//! through zero then costs an error of order `n + 1` in the step.
//!
//! Source: R. Bouc, "Forced vibration of mechanical systems with hysteresis", Prague 1967; Y. K. Wen, "Method for random vibration of
//! hysteretic systems", ASCE J. Eng. Mech. Div. 102(2), 1976; bounds in F. Ikhouane and J. Rodellar, *Systems with Hysteresis*, Wiley 2007,
//! chapter 2.
//!
//! NaN: an input that is not finite gives an output that is not, and leaves the state as it is.

use crate::error::{finite, positive};
use crate::{Error, Operator, Real};

/// After this many characteristic distances in one direction the past no longer counts.
const MEMORY_LENGTHS: u32 = 40;

/// Parameters of a [`BoucWen`] model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoucWenConfig<T> {
    /// `k`: output per input on the first loading, with `A = 1`.
    pub stiffness: T,
    /// `alpha`: the part of the stiffness without memory, 0 to 1.
    pub elastic_fraction: T,
    /// `A`: slope of the memory at zero, above zero; 1 by convention.
    pub amplitude: T,
    /// `beta`, above zero.
    pub beta: T,
    /// `gamma`, above `-beta` and at most `beta`.
    pub gamma: T,
    /// `n`: sharpness of the yield, 1 or more.
    pub exponent: T,
    /// Runge-Kutta steps for each characteristic distance, 1 to 1000. With 8, the error is 2e-6 of `z_max` for `n = 2`, `beta = gamma`; for
    /// `n = 1` a passage through zero costs up to 1e-3, falling with the square of this number.
    pub steps_per_length: u16,
}

/// A Bouc-Wen model, ready to run.
///
/// ```
/// use hysteresis::{BoucWen, BoucWenConfig, BoucWenState, Operator};
///
/// // 2 N/mm on the first loading, a tenth of it elastic; the friction saturates at 1 mm.
/// let config = BoucWenConfig {
///     stiffness: 2.0,
///     elastic_fraction: 0.1,
///     amplitude: 1.0,
///     beta: 0.5,
///     gamma: 0.5,
///     exponent: 1.0,
///     steps_per_length: 20,
/// };
/// let spring = BoucWen::new(&config)?;
/// assert_eq!(spring.largest_memory(), 1.0);
///
/// let mut state: BoucWenState<f64> = spring.state_at(0.0, 0.0)?;
/// let force_n = spring.step(&mut state, 10.0);
/// assert!((force_n - 2.0 * (0.1 * 10.0 + 0.9)).abs() < 1e-3);
/// assert_eq!(state.input(), 10.0);
/// assert!((state.memory() - 1.0).abs() < 1e-3);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoucWen<T> {
    stiffness: T,
    elastic_fraction: T,
    amplitude: T,
    beta: T,
    gamma: T,
    exponent: T,
    limit: T,
    step: T,
    steps_at_most: u32,
}

/// Memory of a [`BoucWen`] model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoucWenState<T> {
    input: T,
    memory: T,
}

impl<T: Real> BoucWenState<T> {
    /// The last finite input.
    pub fn input(&self) -> T {
        self.input
    }

    /// `z`, in the input's unit times `A`.
    pub fn memory(&self) -> T {
        self.memory
    }
}

impl<T: Real> BoucWen<T> {
    /// Builds the model.
    ///
    /// # Errors
    /// When a parameter is outside the domain that its field names, or not finite.
    pub fn new(config: &BoucWenConfig<T>) -> Result<Self, Error> {
        let outside = |parameter, domain| Err(Error::OutOfDomain { parameter, domain });
        let elastic_fraction = finite("elastic_fraction", config.elastic_fraction)?;
        if elastic_fraction < T::ZERO || elastic_fraction > T::ONE {
            return outside("elastic_fraction", "from zero to one");
        }
        let amplitude = positive("amplitude", config.amplitude)?;
        let beta = positive("beta", config.beta)?;
        let gamma = finite("gamma", config.gamma)?;
        if gamma <= -beta || gamma > beta {
            return outside("gamma", "above -beta and at most beta");
        }
        let exponent = finite("exponent", config.exponent)?;
        if exponent < T::ONE {
            return outside("exponent", "one or more");
        }
        if !(1..=1000).contains(&config.steps_per_length) {
            return outside("steps_per_length", "1 to 1000");
        }
        let limit = positive("largest memory", (amplitude / (beta + gamma)).powf(T::ONE / exponent))?;
        let step = positive("step", limit / amplitude / T::from_f64(f64::from(config.steps_per_length)))?;
        Ok(Self {
            stiffness: finite("stiffness", config.stiffness)?,
            elastic_fraction,
            amplitude,
            beta,
            gamma,
            exponent,
            limit,
            step,
            steps_at_most: MEMORY_LENGTHS * u32::from(config.steps_per_length),
        })
    }

    /// `z_max`: the memory stays within plus and minus this.
    #[must_use]
    pub fn largest_memory(&self) -> T {
        self.limit
    }

    /// A start state: the input there and the memory.
    ///
    /// # Errors
    /// When either is not finite or the memory is beyond [`BoucWen::largest_memory`].
    pub fn state_at(&self, input: T, memory: T) -> Result<BoucWenState<T>, Error> {
        if finite("memory", memory)?.abs() > self.limit {
            return Err(Error::OutOfDomain { parameter: "memory", domain: "at most the largest memory" });
        }
        Ok(BoucWenState { input: finite("input", input)?, memory })
    }

    /// `dz/ds` in the given direction.
    fn slope(&self, direction: T, memory: T) -> T {
        let side = if memory < T::ZERO { -self.beta } else { self.beta };
        direction * self.amplitude - memory.abs().powf(self.exponent) * (side + self.gamma * direction)
    }

    /// The memory after a distance in the given direction, by one Runge-Kutta step.
    fn advance(&self, direction: T, memory: T, distance: T) -> T {
        let (half, two) = (T::from_f64(0.5), T::from_f64(2.0));
        let first = self.slope(direction, memory);
        let second = self.slope(direction, memory + half * distance * first);
        let third = self.slope(direction, memory + half * distance * second);
        let fourth = self.slope(direction, memory + distance * third);
        let after = memory + distance / T::from_f64(6.0) * (first + two * second + two * third + fourth);
        // The exact solution never leaves these bounds.
        if after > self.limit {
            self.limit
        } else if after < -self.limit {
            -self.limit
        } else {
            after
        }
    }
}

impl<T: Real> Operator<T> for BoucWen<T> {
    type State = BoucWenState<T>;

    /// At rest at zero: the first sample is reached from there on the first loading, as play operators do.
    fn start(&self) -> BoucWenState<T> {
        BoucWenState { input: T::ZERO, memory: T::ZERO }
    }

    fn step(&self, state: &mut BoucWenState<T>, input: T) -> T {
        if input.is_finite() {
            let travel = input - state.input;
            let direction = if travel < T::ZERO { -T::ONE } else { T::ONE };
            let mut left = travel.abs();
            for _ in 0..self.steps_at_most {
                let distance = if left < self.step { left } else { self.step };
                if distance <= T::ZERO {
                    break;
                }
                state.memory = self.advance(direction, state.memory, distance);
                left = left - distance;
            }
            state.input = input;
        }
        self.stiffness * (self.elastic_fraction * input + (T::ONE - self.elastic_fraction) * state.memory)
    }
}
