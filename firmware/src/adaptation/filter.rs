//! The Kalman filter that learns zero and gain, with its formats and bounds: see [`super`].

use model_export::link::adaptation::{AdaptationReport, Adapting};

#[cfg(test)]
pub(super) mod tests;

/// Process noise of the gain over that of the zero: with the tip moving by 0.32 spans (standard deviation) both follow equally fast.
pub const GAIN_SHARE: f32 = 10.0;
/// Largest variances over their steady values with that motion.
const CAP: f32 = 2.0;
/// Smallest variances over their caps, for rounding: positive, and far below what a measurement leaves.
const FLOOR_SHARE: f32 = 1e-6;
/// Largest squared correlation. Below one by more than rounding.
const CORRELATION: f32 = 0.999;
/// Largest window over time constant: only models with windows of a second and more come near.
const LARGEST_SHARE: f32 = 0.1;
/// Farthest raw estimate from the pivot that is believed, spans.
const FARTHEST: f32 = 2.0;
/// Windows per time constant that the excitation is remembered for: a quarter of it.
const EXCITATION_RATE: f32 = 4.0;
/// How fast the gate closes after a time without measurements, over the time constant.
const GATE_RATE: f32 = 0.5;
/// Time in which the gate opens by the zero's limit without an accepted measurement, s.
const GATE_OPENS_S: f32 = 3600.0;

/// How to adapt; see the settings `adaptation.*`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdaptationConfig {
    /// Displacement about which the gain turns, mm.
    pub pivot_mm: f32,
    /// Span, mm.
    pub span_mm: f32,
    /// Largest zero, share of the span.
    pub zero_limit: f32,
    /// Smallest gain.
    pub gain_minimum: f32,
    /// Largest gain.
    pub gain_maximum: f32,
    /// Time constant with which the zero follows, s.
    pub time_constant_s: f32,
    /// Difference of laser and adapted estimate that is still a measurement, share of the span.
    pub gate: f32,
    /// Standard deviation of the estimate from which on the gain is adapted, share of the span.
    pub excitation: f32,
    /// Range of the laser's calibration, mm: what is not inside may be saturated.
    pub laser_mm: [f32; 2],
}

/// Adaptation, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptation {
    config: AdaptationConfig,
    per_span: f32,
    per_time_constant: f32,
    gain_limit: f32,
}

/// What was learned so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AdaptationState {
    zero: f32,
    gain_error: f32,
    /// `None` before the first window, whose length sets the caps.
    covariance: Option<Covariance>,
    mean: f32,
    variance: f32,
    /// What the gate is open beyond its setting, spans; `None` before the first measurement.
    allowance: Option<f32>,
    updates: u32,
    adapting: Adapting,
}

/// Covariance of zero and gain error, in units of the measurement's variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance {
    /// Variance of the zero.
    pub zero: f32,
    /// Covariance of both.
    pub cross: f32,
    /// Variance of the gain error.
    pub gain: f32,
}

/// A correction of the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    pivot_mm: f32,
    zero_mm: f32,
    gain_error: f32,
}

impl Correction {
    /// The adapted estimate for a raw one, mm.
    pub fn apply(&self, raw_mm: f32) -> f32 {
        raw_mm + (self.zero_mm + self.gain_error * (raw_mm - self.pivot_mm))
    }
}

/// Limits a value. What is no number becomes the lower limit. By comparisons, since platforms differ in which of two zeros is the larger.
fn limited(value: f32, low: f32, high: f32) -> f32 {
    if value > high {
        high
    } else if value >= low {
        value
    } else {
        low
    }
}

impl AdaptationConfig {
    /// Builds the filter.
    pub fn build(&self) -> Adaptation {
        Adaptation {
            config: *self,
            per_span: 1.0 / self.span_mm,
            per_time_constant: 1.0 / self.time_constant_s,
            gain_limit: self.farthest_gain(),
        }
    }

    /// How far the gain may be from one.
    pub fn farthest_gain(&self) -> f32 {
        let (above, below) = (self.gain_maximum - 1.0, 1.0 - self.gain_minimum);
        if above > below { above } else { below }
    }
}

impl AdaptationState {
    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// The covariance, once there was a window.
    pub fn covariance(&self) -> Option<Covariance> {
        self.covariance
    }

    /// What the last window did.
    pub fn adapting(&self) -> Adapting {
        self.adapting
    }
}

impl Adaptation {
    /// What the filter was built from.
    pub fn config(&self) -> &AdaptationConfig {
        &self.config
    }

    /// The correction in force.
    pub fn correction(&self, state: &AdaptationState) -> Correction {
        Correction { pivot_mm: self.config.pivot_mm, zero_mm: state.zero * self.config.span_mm, gain_error: state.gain_error }
    }

    /// What was learned, for the host.
    pub fn report(&self, state: &AdaptationState) -> AdaptationReport {
        AdaptationReport {
            adapting: state.adapting,
            zero_mm: state.zero * self.config.span_mm,
            gain: 1.0 + state.gain_error,
            updates: state.updates,
        }
    }

    /// Whether zero or gain are at a limit.
    pub fn is_at_limit(&self, state: &AdaptationState) -> bool {
        let gain = 1.0 + state.gain_error;
        state.zero.abs() >= self.config.zero_limit || gain <= self.config.gain_minimum || gain >= self.config.gain_maximum
    }

    /// One window of `window_s`: the means of raw estimate and laser over it, mm, and what else forbids to learn from it.
    ///
    /// # Deadline
    /// No loops, one division.
    pub fn step(
        &self,
        state: &mut AdaptationState,
        raw_mm: Option<f32>,
        laser_mm: Option<f32>,
        hindrance: Option<Adapting>,
        window_s: f32,
    ) {
        let share = limited(window_s * self.per_time_constant, 0.0, LARGEST_SHARE);
        let caps = [CAP * share, CAP * GAIN_SHARE * share];
        let before = state.covariance.unwrap_or(Covariance { zero: caps[0], cross: 0.0, gain: caps[1] });
        let predicted = Covariance { zero: before.zero + share * share, gain: before.gain + GAIN_SHARE * share * share, ..before };
        let predicted = predicted.bounded(caps);
        let forget = 1.0 - EXCITATION_RATE * share;
        match self.measurement(state, raw_mm, laser_mm, hindrance) {
            Err(reason) => {
                state.adapting = reason;
                state.covariance = Some(predicted);
                state.variance *= forget;
                let wider = window_s * (self.config.zero_limit / GATE_OPENS_S);
                // Never narrower than it was: what it is before the first measurement is more than the limit.
                state.allowance =
                    state.allowance.map(|allowance| if allowance < self.config.zero_limit { allowance + wider } else { allowance });
            }
            Ok((x, innovation)) => {
                let distance = x - state.mean;
                state.mean = if state.updates == 0 { x } else { state.mean + (1.0 - forget) * distance };
                state.variance = if state.updates == 0 { 0.0 } else { forget * (state.variance + (1.0 - forget) * distance * distance) };
                let excited = state.variance >= self.config.excitation * self.config.excitation;
                let [zero_gain, gain_gain] =
                    if excited { predicted.kalman_gain(x) } else { [predicted.zero / (predicted.zero + 1.0), 0.0] };
                let step = |gain: f32, limit: f32| limited(gain * innovation, -limit * share, limit * share);
                let zero = state.zero + step(zero_gain, self.config.zero_limit);
                state.zero = limited(zero, -self.config.zero_limit, self.config.zero_limit);
                let gain_error = state.gain_error + step(gain_gain, self.gain_limit);
                state.gain_error = limited(gain_error, self.config.gain_minimum - 1.0, self.config.gain_maximum - 1.0);
                state.covariance = Some(predicted.updated(x, [zero_gain, gain_gain]).bounded(caps));
                state.allowance = Some(self.allowance(state) * (1.0 - GATE_RATE * share));
                state.updates = state.updates.saturating_add(1);
                state.adapting = if excited { Adapting::Both } else { Adapting::ZeroOnly };
            }
        }
    }

    fn allowance(&self, state: &AdaptationState) -> f32 {
        // Nothing is known before the first measurement: everything is plausible that the limits allow on the span.
        state.allowance.unwrap_or(self.config.zero_limit + 0.5 * self.gain_limit)
    }

    /// Distance of the raw estimate from the pivot and innovation, in spans; or why this window is no measurement.
    fn measurement(
        &self,
        state: &AdaptationState,
        raw_mm: Option<f32>,
        laser_mm: Option<f32>,
        hindrance: Option<Adapting>,
    ) -> Result<(f32, f32), Adapting> {
        if let Some(hindrance) = hindrance {
            return Err(hindrance);
        }
        let raw_mm = raw_mm.ok_or(Adapting::NoEstimate)?;
        let [low_mm, high_mm] = self.config.laser_mm;
        let laser_mm = laser_mm.filter(|mm| *mm > low_mm && *mm < high_mm).ok_or(Adapting::NoLaser)?;
        let x = (raw_mm - self.config.pivot_mm) * self.per_span;
        let measured = (laser_mm - self.config.pivot_mm) * self.per_span;
        let innovation = measured - x - state.zero - state.gain_error * x;
        // Not `>`: what is no number is within no limit.
        let plausible = x.abs() <= FARTHEST && innovation.abs() <= self.config.gate + self.allowance(state);
        if plausible { Ok((x, innovation)) } else { Err(Adapting::Implausible) }
    }
}

impl Covariance {
    /// The Kalman gain for a measurement `zero + x gain_error`.
    fn kalman_gain(&self, x: f32) -> [f32; 2] {
        let (zero, gain) = (self.zero + x * self.cross, self.cross + x * self.gain);
        // The variance of the measurement is one. The rest is not negative but for rounding.
        let innovation = limited(zero + x * gain, 0.0, f32::MAX) + 1.0;
        [zero / innovation, gain / innovation]
    }

    /// After a measurement taken in with this gain, whichever it is: `(I - K h) P (I - K h)' + K K'`.
    fn updated(&self, x: f32, [zero_gain, gain_gain]: [f32; 2]) -> Self {
        let (a, b, c, d) = (1.0 - zero_gain, -zero_gain * x, -gain_gain, 1.0 - gain_gain * x);
        let (upper_zero, upper_gain) = (a * self.zero + b * self.cross, a * self.cross + b * self.gain);
        let (lower_zero, lower_gain) = (c * self.zero + d * self.cross, c * self.cross + d * self.gain);
        Self {
            zero: upper_zero * a + upper_gain * b + zero_gain * zero_gain,
            cross: upper_zero * c + upper_gain * d + zero_gain * gain_gain,
            gain: lower_zero * c + lower_gain * d + gain_gain * gain_gain,
        }
    }

    /// Positive definite and within the caps, whatever came in: variances are limited, and what correlates them with them.
    fn bounded(&self, [zero_cap, gain_cap]: [f32; 2]) -> Self {
        let zero = limited(self.zero, FLOOR_SHARE * zero_cap, zero_cap);
        let gain = limited(self.gain, FLOOR_SHARE * gain_cap, gain_cap);
        // A cap takes from the covariance more than the square root that the correlation would ask for.
        let capped = |variance: f32, cap: f32| if variance > cap { cap / variance } else { 1.0 };
        let cross = self.cross * capped(self.zero, zero_cap) * capped(self.gain, gain_cap);
        let (square, largest) = (cross * cross, CORRELATION * zero * gain);
        // `cross * largest / square` has the square `largest^2 / square`, which is not above `largest`. What is no number goes to zero.
        let cross = if square <= largest { cross } else { cross * (largest / square) };
        Self { zero, cross: if cross * cross <= largest { cross } else { 0.0 }, gain }
    }
}
