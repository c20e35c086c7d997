//! The filter: against an independent f64 Kalman filter, for any input, and in the situations it must stand.

extern crate std;
use std::vec::Vec;

use proptest::prelude::*;

use super::*;

pub(crate) const CONFIG: AdaptationConfig = AdaptationConfig {
    pivot_mm: 7.0,
    span_mm: 10.0,
    zero_limit: 0.15,
    gain_minimum: 0.85,
    gain_maximum: 1.15,
    time_constant_s: 60.0,
    gate: 0.05,
    excitation: 0.1,
    laser_mm: [0.0, 20.0],
};
const WINDOW_S: f32 = 0.02;
const MINUTE: usize = 3000;

/// Strokes over most of the span, in mm around the pivot, with a period of 8 s.
fn stroke_mm(window: usize) -> f32 {
    4.5 * (window as f32 * WINDOW_S * 0.785).sin()
}

/// Runs windows; the laser is a function of window and raw estimate.
fn run(
    state: &mut AdaptationState,
    windows: core::ops::Range<usize>,
    raw_mm: impl Fn(usize) -> f32,
    laser_mm: impl Fn(usize, f32) -> Option<f32>,
) {
    let adaptation = CONFIG.build();
    for window in windows {
        let raw_mm = raw_mm(window);
        adaptation.step(state, Some(raw_mm), laser_mm(window, raw_mm), None, WINDOW_S);
    }
}

#[test]
fn it_is_the_kalman_filter_of_a_textbook() {
    // The same filter written down again: f64, matrices, no bounds.
    let ratio = f64::from(WINDOW_S) / 60.0;
    let noise = [ratio * ratio, 10.0 * ratio * ratio];
    let mut p = [[2.0 * ratio, 0.0], [0.0, 20.0 * ratio]];
    let mut theta = [0.0f64; 2];
    let mut state = AdaptationState { variance: 1.0, updates: 1, ..AdaptationState::default() };
    let adaptation = CONFIG.build();
    for window in 0..20 * MINUTE {
        let raw_mm = 7.0 + stroke_mm(window);
        let laser_mm = 7.3 + 1.04 * stroke_mm(window) + 0.02 * (window as f32 * 1.7).sin();
        adaptation.step(&mut state, Some(raw_mm), Some(laser_mm), None, WINDOW_S);

        let x = (f64::from(raw_mm) - 7.0) / 10.0;
        let innovation = (f64::from(laser_mm) - 7.0) / 10.0 - x - theta[0] - theta[1] * x;
        p[0][0] = (p[0][0] + noise[0]).min(2.0 * ratio);
        p[1][1] = (p[1][1] + noise[1]).min(20.0 * ratio);
        let h = [1.0, x];
        let ph = [p[0][0] * h[0] + p[0][1] * h[1], p[1][0] * h[0] + p[1][1] * h[1]];
        let s = h[0] * ph[0] + h[1] * ph[1] + 1.0;
        for row in 0..2 {
            theta[row] += ph[row] / s * innovation;
            for column in 0..2 {
                p[row][column] -= ph[row] * ph[column] / s;
            }
        }
    }
    // The zero's limit on its speed is not met; the caps are met in the first windows only.
    assert!((f64::from(state.zero) - theta[0]).abs() < 1e-5, "{} and {}", state.zero, theta[0]);
    assert!((f64::from(state.gain_error) - theta[1]).abs() < 1e-5, "{} and {}", state.gain_error, theta[1]);
    let covariance = state.covariance.unwrap();
    for (mine, other) in [(covariance.zero, p[0][0]), (covariance.cross, p[0][1]), (covariance.gain, p[1][1])] {
        assert!((f64::from(mine) - other).abs() < 1e-3 * p[1][1], "{covariance:?} and {p:?}");
    }
    assert!((theta[0] - 0.03).abs() < 1e-3 && (theta[1] - 0.04).abs() < 2e-3, "{theta:?}");
}

#[test]
fn zero_and_gain_of_a_drift_are_told_apart() {
    for (zero_mm, gain) in [(1.0, 1.0), (-1.0, 1.0), (0.0, 1.1), (0.0, 0.9), (0.5, 1.05)] {
        let mut state = AdaptationState::default();
        let drifted = |_: usize, raw_mm: f32| Some(7.0 + zero_mm + gain * (raw_mm - 7.0));
        run(&mut state, 0..15 * MINUTE, |window| 7.0 + stroke_mm(window), drifted);
        let report = CONFIG.build().report(&state);
        assert!((report.zero_mm - zero_mm).abs() < 0.005 && (report.gain - gain).abs() < 0.002, "{zero_mm} mm, {gain}: {report:?}");
        assert_eq!(report.adapting, Adapting::Both);
    }
}

#[test]
fn an_hour_without_excitation_moves_no_gain_and_winds_nothing_up() {
    let mut state = AdaptationState::default();
    run(&mut state, 0..10 * MINUTE, |window| 7.0 + stroke_mm(window), |_, raw_mm| Some(7.0 + 1.05 * (raw_mm - 7.0)));
    let gain = state.gain_error;
    // At rest for an hour at the far end, with noise, while the laser drifts by 3 % of the span.
    let raw_mm = |window: usize| 11.0 + 0.02 * (window as f32 * 2.3).sin();
    let laser_mm =
        |window: usize, raw_mm: f32| Some(7.0 + 1.05 * (raw_mm - 7.0) + 0.3 * (window - 10 * MINUTE) as f32 / (60 * MINUTE) as f32);
    // The excitation is forgotten within a minute of rest.
    run(&mut state, 10 * MINUTE..11 * MINUTE, raw_mm, laser_mm);
    let settled = state.gain_error;
    run(&mut state, 11 * MINUTE..70 * MINUTE, raw_mm, laser_mm);
    assert_eq!(state.gain_error, settled);
    assert!((settled - gain).abs() < 0.002, "{gain} then {settled}");
    assert_eq!(state.adapting, Adapting::ZeroOnly);
    let share = WINDOW_S / 60.0;
    let covariance = state.covariance.unwrap();
    assert!(covariance.gain <= 20.0 * share && covariance.zero <= 2.0 * share, "{covariance:?}");
    // The estimate is right where it rests, and when the tip moves again nothing jumps.
    assert!((state.zero - 0.03).abs() < 1e-3, "{state:?}");
    let before = state;
    run(&mut state, 70 * MINUTE..71 * MINUTE, |window| 7.0 + stroke_mm(window), |_, raw_mm| Some(7.3 + 1.05 * (raw_mm - 7.0)));
    assert!((state.gain_error - before.gain_error).abs() < 0.003 && (state.zero - before.zero).abs() < 0.002, "{before:?} {state:?}");
}

#[test]
fn a_sudden_offset_of_a_fifth_of_the_span_is_not_believed_at_once_and_never_passes_the_limit() {
    let mut state = AdaptationState::default();
    run(&mut state, 0..5 * MINUTE, |window| 7.0 + stroke_mm(window), |_, raw_mm| Some(raw_mm));
    let offset = |_: usize, raw_mm: f32| Some(raw_mm + 2.0);
    run(&mut state, 5 * MINUTE..15 * MINUTE, |window| 7.0 + stroke_mm(window), offset);
    assert_eq!(state.adapting, Adapting::Implausible);
    assert!(state.zero.abs() < 0.002 && state.gain_error.abs() < 0.002, "{state:?}");
    // Hours later it is, as far as the limit.
    run(&mut state, 15 * MINUTE..200 * MINUTE, |window| 7.0 + stroke_mm(window), offset);
    assert!(state.zero > 0.1 && state.zero <= CONFIG.zero_limit, "{state:?}");
    assert!(CONFIG.build().is_at_limit(&state));
}

#[test]
fn bursts_of_outliers_are_left_out() {
    let mut state = AdaptationState::default();
    let burst = |window: usize, raw_mm: f32| Some(if window % 500 < 100 { raw_mm + 3.0 } else { raw_mm });
    run(&mut state, 0..5 * MINUTE, |window| 7.0 + stroke_mm(window), |_, raw_mm| Some(raw_mm));
    run(&mut state, 5 * MINUTE..60 * MINUTE, |window| 7.0 + stroke_mm(window), burst);
    assert!(state.zero.abs() < 1e-3 && state.gain_error.abs() < 1e-3, "{state:?}");
}

#[test]
fn a_saturated_or_missing_laser_and_every_hindrance_freeze() {
    let mut state = AdaptationState::default();
    run(&mut state, 0..MINUTE, |window| 7.0 + stroke_mm(window), |_, raw_mm| Some(raw_mm + 0.2));
    let before = state;
    let adaptation = CONFIG.build();
    let reasons = [Adapting::NotRunning, Adapting::Limited, Adapting::OutsideDomain, Adapting::NoLaser];
    for reason in reasons {
        adaptation.step(&mut state, Some(7.0), Some(7.1), Some(reason), WINDOW_S);
        assert_eq!(state.adapting, reason);
    }
    adaptation.step(&mut state, Some(7.0), None, None, WINDOW_S);
    assert_eq!(state.adapting, Adapting::NoLaser);
    adaptation.step(&mut state, None, Some(7.0), None, WINDOW_S);
    assert_eq!(state.adapting, Adapting::NoEstimate);
    // Its range ends at 20 mm.
    adaptation.step(&mut state, Some(19.9), Some(20.0), None, WINDOW_S);
    assert_eq!(state.adapting, Adapting::NoLaser);
    assert_eq!((state.zero, state.gain_error, state.updates), (before.zero, before.gain_error, before.updates));
}

fn any_number() -> impl Strategy<Value = f32> {
    prop_oneof![4 => -30.0f32..50.0, 1 => any::<u32>().prop_map(f32::from_bits), 1 => prop::num::f32::ANY]
}

fn any_window() -> impl Strategy<Value = (Option<f32>, Option<f32>, bool)> {
    (prop::option::weighted(0.9, any_number()), prop::option::weighted(0.9, any_number()), prop::bool::weighted(0.1))
}

fn any_config() -> impl Strategy<Value = AdaptationConfig> {
    (0.0f32..=0.25, 0.8f32..=1.0, 1.0f32..=1.25, 10.0f32..=600.0, 0.005f32..=0.25, 0.01f32..=1.0, 0.1f32..=1000.0).prop_map(
        |(zero_limit, gain_minimum, gain_maximum, time_constant_s, gate, excitation, span_mm)| AdaptationConfig {
            zero_limit,
            gain_minimum,
            gain_maximum,
            time_constant_s,
            gate,
            excitation,
            span_mm,
            ..CONFIG
        },
    )
}

proptest! {
    /// What the module promises, for any windows, with any settings and any length of a window.
    #[test]
    fn limits_speeds_and_a_positive_definite_covariance_hold_for_every_input(
        config in any_config(),
        // Some windows of a model, then of anything: the filter must have something to lose.
        near in prop::collection::vec((-1.0f32..1.0, -0.1f32..0.1), 0..300),
        windows in prop::collection::vec(any_window(), 1..200),
        ticks in prop_oneof![Just(20u16), 1u16..=u16::MAX],
    ) {
        let adaptation = config.build();
        let mut state = AdaptationState::default();
        let window_s = f32::from(ticks) / 1000.0;
        let share = (window_s / config.time_constant_s).min(LARGEST_SHARE);
        let sensible = near.iter().map(|(x, off)| {
            let raw_mm = config.pivot_mm + x * config.span_mm;
            (Some(raw_mm), Some(raw_mm + off * config.span_mm), false)
        });
        let all: Vec<(Option<f32>, Option<f32>, bool)> = sensible.chain(windows.iter().copied()).collect();
        for (raw_mm, laser_mm, hindered) in all {
            let before = state;
            adaptation.step(&mut state, raw_mm, laser_mm, hindered.then_some(Adapting::Limited), window_s);
            prop_assert!(state.zero.abs() <= config.zero_limit);
            prop_assert!((config.gain_minimum - 1.0..=config.gain_maximum - 1.0).contains(&state.gain_error));
            // One rounding of a number below the limit.
            prop_assert!((state.zero - before.zero).abs() <= config.zero_limit * share * 1.001 + 2e-8);
            prop_assert!((state.gain_error - before.gain_error).abs() <= config.farthest_gain() * share * 1.001 + 2e-8);
            let Covariance { zero, cross, gain } = state.covariance.unwrap();
            prop_assert!(zero > 0.0 && gain > 0.0 && zero <= CAP * share * 1.001 && gain <= CAP * GAIN_SHARE * share * 1.001);
            // In f64, where nothing is rounded: positive definite.
            prop_assert!(f64::from(cross) * f64::from(cross) < f64::from(zero) * f64::from(gain));
            prop_assert!(state.variance >= 0.0 && state.variance.is_finite() && state.mean.is_finite());
            prop_assert!(state.allowance.is_none_or(|allowance| (0.0..=0.5).contains(&allowance)));
        }
    }

    #[test]
    fn the_joseph_form_stays_positive_definite_for_any_gain(
        zero in 1e-7f32..1e-2, gain in 1e-6f32..1e-1, correlation in -0.999f32..0.999, x in -2.0f32..2.0,
        k in prop::array::uniform2(-2.0f32..2.0),
    ) {
        let covariance = Covariance { zero, cross: correlation * (zero * gain).sqrt(), gain };
        let updated = covariance.updated(x, k).bounded([1e3, 1e3]);
        prop_assert!(updated.zero > 0.0 && updated.gain > 0.0);
        prop_assert!(f64::from(updated.cross).powi(2) < f64::from(updated.zero) * f64::from(updated.gain));
    }
}
