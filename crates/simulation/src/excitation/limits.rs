//! The rig's limits, checked on every sample of an excitation before the first is played.

use super::config::{ExcitationConfig, Samples};
use super::error::ExcitationError;
use super::signal::{Anchor, Signal};

/// What the rig may be asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest pressure in bar.
    pub minimum_bar: f64,
    /// Highest pressure in bar.
    pub maximum_bar: f64,
    /// Fastest change in bar/s between samples.
    pub maximum_slew_bar_per_s: f64,
}

impl Default for Limits {
    /// 0 to 3 bar: the paper's experiments ask for 2A = 3 bar with A = 1.5 bar. 20 bar/s: twice what eq. (1) asks for at its fastest,
    /// 5 bar/s of the 0.8 Hz sine and 5 bar/s of noise (0.1 bar in 0.02 s).
    fn default() -> Self {
        Self { minimum_bar: 0.0, maximum_bar: 3.0, maximum_slew_bar_per_s: 20.0 }
    }
}

impl Limits {
    /// Checks every sample and every step.
    ///
    /// # Errors
    /// With the worst pressure or the fastest change that the excitation would have reached, and when.
    pub fn check(&self, samples: &Samples, excitation: &ExcitationConfig) -> Result<(), ExcitationError> {
        // What is no number is beyond every limit.
        let excess = |pressure: f64| {
            if pressure.is_nan() { f64::INFINITY } else { (pressure - self.maximum_bar).max(self.minimum_bar - pressure) }
        };
        let worst = (0..samples.pressure_bar.len())
            .max_by(|&first, &second| excess(samples.pressure_bar[first]).total_cmp(&excess(samples.pressure_bar[second])));
        // A microbar of play: 2A computed in floating point may end just above a limit of exactly 2A.
        if let Some(index) = worst
            && excess(samples.pressure_bar[index]) > 1e-6
        {
            return Err(ExcitationError::Pressure {
                asked_bar: samples.pressure_bar[index],
                time_s: samples.time_s[index],
                minimum_bar: self.minimum_bar,
                maximum_bar: self.maximum_bar,
                remedy: remedy(excitation),
            });
        }
        let slew = |index: usize| (samples.pressure_bar[index + 1] - samples.pressure_bar[index]).abs() / excitation.sample_period_s;
        let fastest = (0..samples.pressure_bar.len() - 1).max_by(|&first, &second| slew(first).total_cmp(&slew(second)));
        if let Some(index) = fastest
            && slew(index) > self.maximum_slew_bar_per_s * (1.0 + 1e-9)
        {
            return Err(ExcitationError::Slew {
                asked_bar_per_s: slew(index),
                time_s: samples.time_s[index],
                maximum_bar_per_s: self.maximum_slew_bar_per_s,
            });
        }
        Ok(())
    }
}

/// What to do about too high a pressure.
fn remedy(excitation: &ExcitationConfig) -> String {
    let grows = |signal: &Signal| match signal {
        Signal::DescendingSine { decay_per_s, .. } | Signal::DescendingTriangle { decay_per_s, .. } => *decay_per_s < 0.0,
        Signal::AscendingSine { anchor, .. } => *anchor == Anchor::Start,
        _ => false,
    };
    if excitation.segments.iter().any(|segment| grows(&segment.signal)) {
        "An envelope that grows from its start is multiplied by e^(growth x duration): use kind = \"ascending-sine\" with anchor = \"end\", \
         whose amplitude_bar is reached at the end"
            .to_owned()
    } else if excitation.noise_bar > 0.0 {
        "Eq. (1) peaks at twice amplitude_bar plus the noise: lower amplitude_bar or noise_bar (the paper's experiments have none)"
            .to_owned()
    } else {
        "Eq. (1) peaks at twice amplitude_bar: lower amplitude_bar, or the levels of the signal".to_owned()
    }
}

impl ExcitationConfig {
    /// Samples the excitation and checks it against the limits of the rig: what comes back may be played.
    ///
    /// # Errors
    /// As [`Self::sample`] and [`Limits::check`].
    pub fn sample_within(&self, limits: &Limits) -> Result<Samples, ExcitationError> {
        let samples = self.sample()?;
        limits.check(&samples, self)?;
        Ok(samples)
    }
}
