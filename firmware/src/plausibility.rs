//! Plausibility: which samples to believe, and when to stop believing a sensor.
//!
//! Terms. A sample is **rejected** when its code is no measurement or when it lies farther from the last good one than the quantity can
//! have moved; the last good value is then **held**. After several rejections in a row, or when the code stays exactly the same while the command
//! moves, the sensor is **lost**, until it has behaved for [`RECOVERY_TICKS`]. A sensor starts lost: it has to prove itself.
//!
//! A live signal is never exactly constant: the sum of several 12-bit conversions carries the converter's and the sensor's noise. That is what
//! the stuck check builds on, together with a command that moved, so that a quiet hold is not mistaken for a dead sensor.
//!
//! A dead signal may carry noise too, that of the converter alone. So a sensor is **still** as long as it stays within [`STILL_SHARE`] of its range, and
//! when the command moved far meanwhile, and had the time to be followed, the sensor is lost as well. During a hold the command does not move, and nothing
//! is judged.
//!
//! [`Follower`] compares two quantities that should agree: commanded against measured pressure, or model against laser.

use crate::calibration::Calibration;
use crate::number::MicroBar;

/// Good samples in a row that make a lost sensor believed again.
pub const RECOVERY_TICKS: u16 = 100;

/// Share of the measured range within which a sensor counts as still: more than any noise, less than any motion worth the name.
pub const STILL_SHARE: f32 = 0.01;
/// Time constants at zero command after which a sensor that was still may prove itself again: everything is at rest then.
const STILL_FORGOTTEN: f32 = 5.0;

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
    still_band: f32,
    still_command_bar: f32,
    /// Share of the way to the command that the rig goes in a tick.
    still_response: f32,
    still_forgotten_ticks: f32,
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
    still: Stillness,
}

/// Since when a sensor is still, and how far the command moved meanwhile.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Stillness {
    /// The command as the slowest rig follows it, bar.
    followed_bar: f32,
    /// Since the sensor moved last: what the command went through, what the slowest rig would have followed, and the sensor's values.
    command_bar: Range,
    slow_bar: Range,
    value: Range,
    /// Ticks at zero command.
    zero_ticks: f32,
}

/// Lowest and highest of what was seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Range {
    lowest: f32,
    highest: f32,
}

impl Range {
    fn at(value: f32) -> Self {
        Self { lowest: value, highest: value }
    }

    /// Takes in a value and gives the width.
    fn width_with(&mut self, value: f32) -> f32 {
        self.lowest = self.lowest.min(value);
        self.highest = self.highest.max(value);
        self.highest - self.lowest
    }
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
            still: Stillness::default(),
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
            still_band: STILL_SHARE * self.calibration.measured_range(),
            still_command_bar: self.still_command_bar,
            // Backward Euler of a first-order lag: stable for every time constant.
            still_response: 1.0 / (1.0 + self.still_response_ms),
            still_forgotten_ticks: STILL_FORGOTTEN * self.still_response_ms,
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
        let still = self.watch_motion(&mut state.still, value_now, command);
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

    /// Whether the sensor has been still for too long although the command moved.
    fn watch_motion(&self, still: &mut Stillness, value: f32, command: MicroBar) -> bool {
        still.followed_bar += self.still_response * (command.bar() - still.followed_bar);
        still.zero_ticks = if command == MicroBar::ZERO { still.zero_ticks + 1.0 } else { 0.0 };
        if still.value.width_with(value) > self.still_band || still.zero_ticks > self.still_forgotten_ticks {
            still.value = Range::at(value);
            still.command_bar = Range::at(command.bar());
            still.slow_bar = Range::at(still.followed_bar);
        }
        // Both: a rig that is fast has come to rest before a slow one would have moved.
        let (command_bar, slow_bar) = (still.command_bar.width_with(command.bar()), still.slow_bar.width_with(still.followed_bar));
        command_bar.min(slow_bar) >= self.still_command_bar
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

/// Two quantities that should agree, one of them after a first-order response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerConfig {
    /// Time constant of the response in steps; 0 is none.
    pub response_steps: f32,
    /// Tolerated difference.
    pub tolerance: f32,
    /// Steps in a row beyond the tolerance that make a mismatch.
    pub steps: u16,
}

/// The comparison, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follower {
    coefficient: f32,
    tolerance: f32,
    steps: u16,
}

/// The comparison so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FollowerState {
    expected: Option<f32>,
    beyond: u16,
}

impl FollowerConfig {
    /// Builds the comparison.
    pub fn build(&self) -> Follower {
        // Backward Euler of a first-order lag: stable for every time constant.
        Follower { coefficient: 1.0 / (1.0 + self.response_steps), tolerance: self.tolerance, steps: self.steps }
    }
}

impl Follower {
    /// Whether `measured` has failed to follow `leader` for too long. The response starts where `measured` is.
    pub fn step(&self, state: &mut FollowerState, leader: f32, measured: f32) -> bool {
        let before = state.expected.unwrap_or(measured);
        let expected = before + self.coefficient * (leader - before);
        state.expected = Some(expected);
        // Not `>`: a difference that is no number is beyond every tolerance.
        let within = distance(measured, expected) <= self.tolerance;
        state.beyond = if within { 0 } else { state.beyond.saturating_add(1) };
        state.beyond >= self.steps
    }
}

fn distance(a: f32, b: f32) -> f32 {
    let difference = a - b;
    if difference < 0.0 { -difference } else { difference }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{CalibrationConfig, ConverterConfig};

    const ZERO: MicroBar = MicroBar::ZERO;

    fn sensor() -> Sensor {
        let calibration =
            CalibrationConfig { low_v: 0.6, low_value: 0.0, high_v: 3.0, high_value: 20.0, fault_below_v: 0.567, fault_above_v: 3.12 }
                .build(&ConverterConfig { full_scale_code: 8190, full_scale_v: 3.3 })
                .unwrap();
        SensorConfig {
            maximum_rate_per_s: 500.0,
            rejected_ms: 5,
            stuck_ms: 40,
            stuck_command: MicroBar(50_000),
            still_command_bar: 1.2,
            still_response_ms: 200.0,
            calibration,
        }
        .build()
    }

    /// A sensor that has proved itself at 10 mm.
    fn believed(sensor: &Sensor) -> SensorState {
        let mut state = SensorState::default();
        for tick in 0..=RECOVERY_TICKS {
            sensor.step(&mut state, sensor.calibration.code(10.0) + tick % 2, ZERO);
        }
        assert!(state.is_believed());
        state
    }

    #[test]
    fn a_sensor_must_behave_before_it_is_believed() {
        let sensor = sensor();
        let mut state = SensorState::default();
        let code = sensor.calibration.code(10.0);
        let first_good = (1..1000u16).find(|tick| sensor.step(&mut state, code + tick % 2, ZERO).value().is_some());
        assert_eq!(first_good, Some(RECOVERY_TICKS));
    }

    #[test]
    fn a_single_spike_is_held_and_forgotten() {
        let sensor = sensor();
        let mut state = believed(&sensor);
        let verdict = sensor.step(&mut state, sensor.calibration.code(15.0), ZERO);
        assert!(matches!(verdict, Verdict::Held(value, Rejection::Rate) if (value - 10.0).abs() < 0.01), "{verdict:?}");
        assert!(matches!(sensor.step(&mut state, sensor.calibration.code(10.1), ZERO), Verdict::Good(_)));
    }

    #[test]
    fn a_fault_code_loses_the_sensor_after_five_ticks_and_a_cured_one_needs_a_hundred() {
        let sensor = sensor();
        let mut state = believed(&sensor);
        let fault_code = 1396; // 3.75 mA
        for tick in 1..=5 {
            let verdict = sensor.step(&mut state, fault_code, ZERO);
            assert_eq!(verdict == Verdict::Lost(Rejection::Range), tick == 5, "tick {tick}: {verdict:?}");
        }
        let code = sensor.calibration.code(3.0);
        let back = (1..1000u16).find(|tick| sensor.step(&mut state, code + tick % 2, ZERO).value().is_some());
        // The first sample is a jump from the last good value, so it does not count.
        assert_eq!(back, Some(RECOVERY_TICKS + 1));
    }

    #[test]
    fn a_jump_that_stays_loses_the_sensor() {
        let sensor = sensor();
        let mut state = believed(&sensor);
        let lost = (1..100).find(|_| sensor.step(&mut state, sensor.calibration.code(18.0), ZERO) == Verdict::Lost(Rejection::Rate));
        assert_eq!(lost, Some(5));
    }

    #[test]
    fn the_fastest_real_motion_is_not_rejected() {
        let sensor = sensor();
        let mut state = believed(&sensor);
        for tick in 1..=18u16 {
            // 500 mm/s is half a millimetre a tick; rounding to codes on top.
            let verdict = sensor.step(&mut state, sensor.calibration.code(10.0 + 0.5 * f32::from(tick)), ZERO);
            assert!(matches!(verdict, Verdict::Good(_)), "tick {tick}: {verdict:?}");
        }
    }

    #[test]
    fn a_constant_code_is_stuck_only_if_the_command_moved() {
        let sensor = sensor();
        let code = sensor.calibration.code(10.0) + 7;
        let mut state = believed(&sensor);
        assert!((0..1000).all(|_| sensor.step(&mut state, code, ZERO).value().is_some()));

        let mut state = believed(&sensor);
        let lost = (1..1000).find(|tick| sensor.step(&mut state, code, MicroBar(tick * 2_000)) == Verdict::Lost(Rejection::Stuck));
        assert_eq!(lost, Some(41));

        // One code of noise is a sign of life, until the command has moved by far.
        let mut state = believed(&sensor);
        let lost = (1..1_500).find(|tick| {
            let code = code + u16::from(tick % 30 == 0);
            sensor.step(&mut state, code, MicroBar(tick * 2_000)) == Verdict::Lost(Rejection::Stuck)
        });
        // The ramp of 2 bar/s is followed 0.2 s behind.
        assert_eq!(lost, Some(797));
    }

    /// Noise of two codes either way.
    fn noisy(code: u16, tick: i32) -> u16 {
        let noise = tick.cast_unsigned().wrapping_mul(0x9e37_79b9) >> 13;
        code + u16::try_from(noise % 5).unwrap() - 2
    }

    #[test]
    fn a_sensor_that_is_frozen_with_noise_is_lost_when_the_command_moves_far_and_never_in_a_hold() {
        let sensor = sensor();
        let code = sensor.calibration.code(10.0);
        let sine = |tick: i32, amplitude: f64| {
            let phase = f64::from(tick) * 1e-3 * 0.8 * core::f64::consts::TAU;
            MicroBar::from_bar((amplitude * (1.0 - f64::cos(phase))) as f32).unwrap()
        };
        // From any moment of a sine on.
        for began in (0..1_250).step_by(10) {
            let mut state = believed(&sensor);
            let live = |tick: i32| sensor.calibration.code(10.0 + 2.0 * sine(tick, 1.2).bar());
            for tick in 0..2_500 + began {
                assert!(sensor.step(&mut state, noisy(live(tick), tick), sine(tick, 1.2)).value().is_some(), "{tick}");
            }
            let frozen = live(2_500 + began);
            let lost = (0..5_000).find(|tick| {
                let command = sine(2_500 + began + tick, 1.2);
                sensor.step(&mut state, noisy(frozen, *tick), command) == Verdict::Lost(Rejection::Stuck)
            });
            assert!(lost.is_some_and(|ticks| ticks < 900), "{began}: {lost:?}");
        }
        // Steps that a fast rig has followed long before a slow one.
        let mut state = believed(&sensor);
        for tick in 0..20_000 {
            let command = MicroBar(if tick % 4_000 < 2_000 { 3_000_000 } else { 0 });
            let target = code + if command == ZERO { 0 } else { 3_000 };
            let code = sensor.calibration.code(state.last_value());
            let next = if target > code { code + (target - code).min(100) } else { code - (code - target).min(100) };
            assert!(sensor.step(&mut state, noisy(next, tick), command).value().is_some(), "{tick}");
        }
        // Holds of half an hour, wherever they begin, and small movements that stick-slip may swallow.
        for (bar, amplitude) in [(0.0, 0.0), (1.5, 0.0), (3.0, 0.0), (0.5, 0.5)] {
            let mut state = believed(&sensor);
            for tick in 0..1_800_000 {
                let command = MicroBar(sine(tick, amplitude).0 + MicroBar::from_bar(bar).unwrap().0);
                // The hold begins with a movement that the sensor sees.
                let code = code + u16::try_from(tick.min(200)).unwrap();
                assert!(sensor.step(&mut state, noisy(code, tick), command).value().is_some(), "{bar} bar, {tick}");
            }
        }
    }

    #[test]
    fn a_sensor_that_was_still_can_prove_itself_again_after_a_vent() {
        let sensor = sensor();
        let code = sensor.calibration.code(10.0);
        let mut state = believed(&sensor);
        let moving = |tick: i32| MicroBar(if tick % 4_000 < 2_000 { 2_000_000 } else { 0 });
        assert!((0..4_000).any(|tick| sensor.step(&mut state, noisy(code, tick), moving(tick)) == Verdict::Lost(Rejection::Stuck)));
        let back = (0..5_000).find(|tick| sensor.step(&mut state, noisy(code, *tick), ZERO).value().is_some());
        assert!(back.is_some_and(|ticks| ticks < 1_500), "{back:?}");
    }

    #[test]
    fn a_follower_tolerates_its_response_and_nothing_slower() {
        let follower = FollowerConfig { response_steps: 20.0, tolerance: 0.3, steps: 30 }.build();
        let mut state = FollowerState::default();
        let mut measured = 0.0;
        for _ in 0..500 {
            measured += (2.0 - measured) / 25.0;
            assert!(!follower.step(&mut state, 2.0, measured));
        }
        let mut state = FollowerState::default();
        let mismatch = (1..500).find(|_| follower.step(&mut state, 2.0, 0.0));
        // The expected pressure passes 0.3 bar in the fourth step.
        assert_eq!(mismatch, Some(33));
        assert!(follower.step(&mut FollowerState { expected: Some(0.0), beyond: 29 }, f32::NAN, 0.0));
    }
}
