//! Plausibility of one sensor: which samples to believe, and when to stop believing it.
//!
//! Terms. A sample is **rejected** when its code is no measurement or when it lies farther from the last good one than the quantity can
//! have moved; the last good value is then **held**. After several rejections in a row, or when the code stays exactly the same while the command
//! moves, the sensor is **lost**, until it has behaved for [`RECOVERY_TICKS`]. A sensor starts lost: it has to prove itself.
//!
//! A live signal is never exactly constant: the sum of several 12-bit conversions carries the converter's and the sensor's noise. That is what
//! the stuck check builds on, together with a command that moved, so that a quiet hold is not mistaken for a dead sensor.
//!
//! A dead signal may carry noise too, that of the converter alone: [`super::stillness`].

use crate::calibration::Calibration;
use crate::number::MicroBar;

use super::stillness::{Stillness, StillnessState};

#[cfg(test)]
mod tests;

/// Good samples in a row that make a lost sensor believed again.
pub const RECOVERY_TICKS: u16 = 100;

/// What is known about a sensor's signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorConfig {
    /// Fastest change of the quantity, in its unit per second.
    pub maximum_rate_per_s: f32,
    /// Rejections in a row that lose the sensor.
    pub rejected_ms: u16,
    /// Identical codes in a row that lose the sensor if the command moved meanwhile.
    pub stuck_ms: u16,
    /// How far the command must have moved for that.
    pub stuck_command: MicroBar,
    /// How far the command must have moved, in bar, while the sensor was still.
    pub still_command_bar: f32,
    /// Time constant of the rig's response to the command, for that.
    pub still_response_ms: f32,
    /// The map from codes.
    pub calibration: Calibration,
}

/// A sensor's checks, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    calibration: Calibration,
    largest_step: f32,
    rejected_ticks: u16,
    stuck_ticks: u16,
    stuck_command_ubar: i32,
    stillness: Stillness,
}

/// What is wrong with a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Rejection {
    /// Its code is no measurement.
    Range,
    /// It moved faster than the quantity can.
    Rate,
    /// It did not move at all.
    Stuck,
}

/// What to make of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// Believed.
    Good(f32),
    /// Rejected; the last good value stands in.
    Held(f32, Rejection),
    /// The sensor is not believed, for this reason.
    Lost(Rejection),
}

impl Verdict {
    /// The value to use, if there is one.
    pub fn value(self) -> Option<f32> {
        match self {
            Self::Good(value) | Self::Held(value, _) => Some(value),
            Self::Lost(_) => None,
        }
    }
}

/// What a sensor did so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorState {
    /// The last sample that passed, believed or not.
    value: f32,
    rejected_ticks: u16,
    /// Ticks without a sample since the last good one.
    unseen_ticks: u16,
    lost: Option<Rejection>,
    good_ticks: u16,
    last_code: Option<u16>,
    same_code_ticks: u16,
    command_low_ubar: i32,
    command_high_ubar: i32,
    still: StillnessState,
}

impl Default for SensorState {
    fn default() -> Self {
        Self {
            value: 0.0,
            rejected_ticks: 0,
            unseen_ticks: 0,
            lost: Some(Rejection::Range),
            good_ticks: 0,
            last_code: None,
            same_code_ticks: 0,
            command_low_ubar: 0,
            command_high_ubar: 0,
            still: StillnessState::default(),
        }
    }
}

impl SensorState {
    /// The last value that was not rejected, whether or not the sensor is believed.
    pub fn last_value(&self) -> f32 {
        self.value
    }

    /// Ticks since its code last changed.
    pub fn same_code_ticks(&self) -> u16 {
        self.same_code_ticks
    }

    /// Ticks went by without a sample: the quantity moved on meanwhile.
    pub fn miss(&mut self, ticks: u16) {
        self.unseen_ticks = self.unseen_ticks.saturating_add(ticks);
    }

    /// Whether the sensor is believed.
    pub fn is_believed(&self) -> bool {
        self.lost.is_none()
    }
}

impl SensorConfig {
    /// Builds the checks for a tick of 1 ms.
    pub fn build(&self) -> Sensor {
        Sensor {
            calibration: self.calibration,
            // One resolution step on top: a slow signal may cross a code boundary at any tick.
            largest_step: self.maximum_rate_per_s / crate::time::TICKS_PER_S + self.calibration.resolution(),
            rejected_ticks: self.rejected_ms,
            stuck_ticks: self.stuck_ms,
            stuck_command_ubar: self.stuck_command.0,
            stillness: Stillness::new(self.calibration.measured_range(), self.still_command_bar, self.still_response_ms),
        }
    }
}

impl Sensor {
    /// The map from codes.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// Judges one sample; `command` is the output in force while it was taken.
    ///
    /// # Deadline
    /// No loops: a few comparisons and one multiplication.
    pub fn step(&self, state: &mut SensorState, code: u16, command: MicroBar) -> Verdict {
        let value = self.calibration.value(code);
        let rejection = if !self.calibration.is_measurement(code) {
            Some(Rejection::Range)
        } else if state.last_code.is_some() && distance(value, state.value) > self.reach(state) {
            Some(Rejection::Rate)
        } else {
            None
        };
        let value_now = if rejection.is_none() { value } else { state.value };
        let still = self.stillness.step(&mut state.still, value_now, command);
        let stuck = self.watch_code(state, code, command) || still;

        match rejection {
            Some(reason) => {
                state.rejected_ticks = state.rejected_ticks.saturating_add(1);
                state.good_ticks = 0;
                if state.rejected_ticks >= self.rejected_ticks {
                    state.lost = Some(reason);
                }
                // A lost sensor is judged from where it is now: the quantity moved on while nobody looked.
                if state.lost.is_some() && reason == Rejection::Rate {
                    state.value = value;
                }
            }
            None => {
                state.rejected_ticks = 0;
                state.unseen_ticks = 0;
                state.value = value;
                state.good_ticks = state.good_ticks.saturating_add(1);
            }
        }
        if stuck {
            state.lost = Some(Rejection::Stuck);
            state.good_ticks = 0;
        }
        if state.lost.is_some() && state.good_ticks >= RECOVERY_TICKS {
            state.lost = None;
        }
        match (state.lost, rejection) {
            (Some(reason), _) => Verdict::Lost(reason),
            (None, Some(reason)) => Verdict::Held(state.value, reason),
            (None, None) => Verdict::Good(value),
        }
    }

    /// How far the quantity can have moved since the last good sample.
    fn reach(&self, state: &SensorState) -> f32 {
        let ticks = if state.lost.is_some() { 0 } else { state.rejected_ticks.saturating_add(state.unseen_ticks) };
        self.largest_step * f32::from(ticks.saturating_add(1))
    }

    /// Whether the code has been the same for too long although the command moved.
    fn watch_code(&self, state: &mut SensorState, code: u16, command: MicroBar) -> bool {
        if state.last_code == Some(code) {
            state.same_code_ticks = state.same_code_ticks.saturating_add(1);
            state.command_low_ubar = state.command_low_ubar.min(command.0);
            state.command_high_ubar = state.command_high_ubar.max(command.0);
        } else {
            state.last_code = Some(code);
            state.same_code_ticks = 0;
            state.command_low_ubar = command.0;
            state.command_high_ubar = command.0;
        }
        state.same_code_ticks >= self.stuck_ticks
            && state.command_high_ubar.saturating_sub(state.command_low_ubar) >= self.stuck_command_ubar
    }
}

fn distance(a: f32, b: f32) -> f32 {
    let difference = a - b;
    if difference < 0.0 { -difference } else { difference }
}
