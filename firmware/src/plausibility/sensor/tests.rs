//! What a sensor may do without being lost, and what loses it.

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
