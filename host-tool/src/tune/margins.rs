//! Stability margins of the feedback loop, by its frequency response.
//!
//! The loop is linearised: the actuator as its steepest incremental gain behind both lags and the dead time, the feedback as a continuous PID
//! behind a window's mean and hold (half a window of delay each). On top of an inverse feed-forward the lags are undone, which leaves
//! the dead time and the smoothing of the inverse. Margins are defined as in K. J. Astrom, R. M. Murray, *Feedback Systems*, section 9.3.

use std::f64::consts::PI;

use firmware::control::PidConfig;
use serde::Serialize;

/// The plant that the feedback sees: correction in mm to displacement in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plant {
    /// Incremental gain, mm/mm.
    pub gain: f64,
    /// Everything that only delays, s.
    pub delay_s: f64,
    /// Lags, s.
    pub lags_s: [f64; 2],
}

/// How far the loop is from oscillating.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Margins {
    /// Factor on the gain that the loop stands.
    pub gain: f64,
    /// Phase that it stands, degrees.
    pub phase_deg: f64,
    /// Additional dead time that it stands, s.
    pub delay_s: f64,
}

/// What a loop must keep.
pub const WANTED: Margins = Margins { gain: 2.0, phase_deg: 45.0, delay_s: 0.03 };

/// What it must keep beside a feed-forward: the motion is done by the latter, and a gentler loop amplifies less of what it cannot
/// follow, as a heartbeat.
pub const WANTED_BESIDE_FEED_FORWARD: Margins = Margins { gain: 4.0, phase_deg: 60.0, delay_s: 0.05 };

impl Margins {
    /// Whether every margin is at least the other's.
    #[must_use]
    pub fn reach(&self, wanted: &Self) -> bool {
        self.gain >= wanted.gain && self.phase_deg >= wanted.phase_deg && self.delay_s >= wanted.delay_s
    }

    /// The smaller of each.
    #[must_use]
    pub fn worse(self, other: Self) -> Self {
        Self { gain: self.gain.min(other.gain), phase_deg: self.phase_deg.min(other.phase_deg), delay_s: self.delay_s.min(other.delay_s) }
    }
}

/// The margins of a loop; infinite without feedback.
#[must_use]
pub fn margins(pid: &PidConfig, plant: &Plant) -> Margins {
    let mut margins = Margins { gain: f64::INFINITY, phase_deg: f64::INFINITY, delay_s: f64::INFINITY };
    let mut last: Option<(f64, f64)> = None;
    // From a cycle in ten minutes to the rate of the windows, 400 steps a decade.
    for step in 0..2000 {
        let omega = 0.01 * 10f64.powf(f64::from(step) / 400.0);
        let (size, phase) = response(pid, plant, omega);
        if let Some((last_size, last_phase)) = last {
            if last_size >= 1.0 && size < 1.0 {
                let left = phase + PI;
                margins.phase_deg = margins.phase_deg.min(left.to_degrees());
                margins.delay_s = margins.delay_s.min(left / omega);
            }
            if last_phase > -PI && phase <= -PI {
                margins.gain = margins.gain.min(1.0 / size);
            }
        }
        last = Some((size, phase));
    }
    margins
}

/// Size and unwrapped phase, rad, of the open loop at an angular frequency, rad/s.
fn response(pid: &PidConfig, plant: &Plant, omega: f64) -> (f64, f64) {
    let [proportional, integral, derivative, filter_s] =
        [pid.proportional, pid.integral_per_s, pid.derivative_s, pid.derivative_filter_s].map(f64::from);
    // The firmware filters the error of the derivative: j w D / (1 + j w F).
    let damping = 1.0 + (omega * filter_s).powi(2);
    let real = proportional + derivative * omega * omega * filter_s / damping;
    let imaginary = derivative * omega / damping - integral / omega;
    let lags: f64 = plant.lags_s.iter().map(|lag_s| (omega * lag_s).atan()).sum();
    let shrink: f64 = plant.lags_s.iter().map(|lag_s| (1.0 + (omega * lag_s).powi(2)).sqrt()).product();
    // The controller's phase lies between -90 and 90 degrees, so nothing has to be unwrapped.
    (plant.gain * real.hypot(imaginary) / shrink, imaginary.atan2(real) - lags - omega * plant.delay_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_integrator_around_a_dead_time_has_the_margins_of_the_textbook() {
        let pid = PidConfig { integral_per_s: 5.0, ..PidConfig::default() };
        let plant = Plant { gain: 1.0, delay_s: 0.1, lags_s: [0.0; 2] };
        let margins = margins(&pid, &plant);
        // Crosses one at 5 rad/s with -90 degrees and 0.5 rad; the phase is -180 degrees at pi/2 / 0.1 s.
        assert!((margins.phase_deg - (90.0 - 0.5f64.to_degrees())).abs() < 0.5, "{margins:?}");
        assert!((margins.gain - PI / 2.0 / 0.1 / 5.0).abs() < 0.03, "{margins:?}");
        assert!((margins.delay_s - (PI / 2.0 - 0.5) / 5.0).abs() < 0.003, "{margins:?}");
    }

    #[test]
    fn lags_cost_phase_and_more_gain_costs_every_margin() {
        let pid = PidConfig { proportional: 0.3, integral_per_s: 3.0, ..PidConfig::default() };
        let fast = margins(&pid, &Plant { gain: 1.0, delay_s: 0.05, lags_s: [0.0; 2] });
        let slow = margins(&pid, &Plant { gain: 1.0, delay_s: 0.05, lags_s: [0.1, 0.02] });
        let steep = margins(&pid, &Plant { gain: 1.5, delay_s: 0.05, lags_s: [0.1, 0.02] });
        assert!(slow.phase_deg < fast.phase_deg, "{fast:?} {slow:?}");
        assert!(steep.gain < slow.gain && steep.phase_deg < slow.phase_deg && steep.delay_s < slow.delay_s, "{slow:?} {steep:?}");
        assert!(slow.reach(&steep) && !steep.reach(&slow));
    }
}
