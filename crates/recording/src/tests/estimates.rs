//! Repeatability, drift and steps against rigs whose truth is known.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::{drift, repeatability};

/// Standard normal: twelve uniform numbers less six.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| random.random_range(0.0..1.0)).sum::<f64>() - 6.0
}

/// Strokes of random depth around 1 bar at 50 Hz, the same for the same seed.
fn strokes(seed: u64, samples: usize) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (mut value, mut target) = (1.0_f64, 2.0_f64);
    (0..samples)
        .map(|_| {
            if (target - value).abs() < 0.03 {
                let depth = random.random_range(0.3..1.0);
                target = if target > 1.0 { 1.0 - depth } else { 1.0 + depth };
            }
            value += 0.03 * (target - value).signum();
            value
        })
        .collect()
}

/// A rig with two play operators, a bend and a lag.
fn rig(input: &[f64]) -> Vec<f64> {
    let (mut small, mut large, mut lag) = (input[0], input[0], 0.0);
    input
        .iter()
        .map(|&value| {
            small = small.clamp(value - 0.1, value + 0.1);
            large = large.clamp(value - 0.4, value + 0.4);
            let wanted = 0.5 * value + 0.8 * small + 0.7 * large - 0.1 * value * value;
            lag += 0.3 * (wanted - lag);
            lag
        })
        .collect()
}

fn recorded(name: &str, input: Vec<f64>, output: Vec<f64>) -> Recording {
    let time_s = (0..input.len()).map(|index| index as f64 * 0.02).collect();
    Recording::new(Path::new(name), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output).expect("valid")
}

/// Recordings of one excitation with these offsets and white noise.
fn repeated(offsets: &[f64], noise: f64, seed: u64) -> Vec<Recording> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let run = |(number, offset): (usize, &f64)| {
        let input = strokes(1, 3000);
        let output = rig(&input).iter().map(|value| value + offset + noise * normal(&mut random)).collect();
        recorded(&format!("r_{number}.csv"), input, output)
    };
    offsets.iter().enumerate().map(run).collect()
}

#[test]
fn offsets_between_repeated_recordings_and_noise_are_what_does_not_repeat() {
    for (offsets, noise) in [([0.05, -0.03, 0.01, -0.06, 0.04], 0.01), ([0.0; 5], 0.02), ([0.01, -0.01, 0.02, 0.0, -0.02], 0.002)] {
        let mean = offsets.iter().sum::<f64>() / 5.0;
        let between: f64 = offsets.iter().map(|offset| (offset - mean).powi(2)).sum::<f64>() / 4.0;
        let truth = (between + noise * noise).sqrt();
        let found = repeatability::estimate(&repeated(&offsets, noise, 3));
        let rms = found.repeatability.expect("everything repeats");
        assert!((rms / truth - 1.0).abs() < 0.15, "{rms} instead of {truth}: {found:?}");
        assert!((found.noise / noise - 1.0).abs() < 0.3, "noise {} instead of {noise}", found.noise);
        assert!(found.method.contains("different recordings") && found.between_groups.is_none());
    }
}

#[test]
fn days_apart_count_between_groups() {
    let mut recordings = repeated(&[0.0, 0.01, 0.2, 0.21, -0.2, -0.19], 0.005, 4);
    for (index, recording) in recordings.iter_mut().enumerate() {
        recording.group = format!("day{}", index / 2);
    }
    let between = repeatability::estimate(&recordings).between_groups.expect("three days");
    // Half the mean squared difference of pairs of different days: 0.2, 0.4 and 0.2 mm apart.
    let truth = ((0.04 + 0.16 + 0.04) / 3.0 / 2.0_f64).sqrt();
    assert!((between / truth - 1.0).abs() < 0.2, "{between} instead of {truth}");
}

#[test]
fn strokes_of_one_recording_repeat_down_to_the_noise() {
    let input: Vec<f64> = (0..6000).map(|index| 1.0 - (f64::from(index) * 0.02 * 1.7).cos()).collect();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let output = rig(&input).iter().map(|value| value + 0.02 * normal(&mut random)).collect();
    let found = repeatability::estimate(&[recorded("r.csv", input, output)]);
    let rms = found.repeatability.expect("strokes repeat");
    assert!((rms / 0.02 - 1.0).abs() < 0.15, "{found:?}");
    assert!(found.method.contains("same recording"));
}

#[test]
fn recordings_of_other_strokes_are_told_within_a_factor_or_not_at_all() {
    let mut random = ChaCha8Rng::seed_from_u64(6);
    let run = |seed: u64| {
        let input = strokes(seed, 3000);
        let output = rig(&input).iter().map(|value| value + 0.02 * normal(&mut random)).collect();
        recorded("r.csv", input, output)
    };
    let found = repeatability::estimate(&(10..16).map(run).collect::<Vec<_>>());
    // Nothing repeats exactly; what is reported must not be a floor far above the truth.
    assert!(found.repeatability.is_none_or(|rms| (0.015..0.04).contains(&rms)), "{found:?}");
}

#[test]
fn nothing_is_told_where_nothing_repeats() {
    let input: Vec<f64> = (0..3000).map(|index| f64::from(index) * 1e-3).collect();
    let found = repeatability::estimate(&[recorded("ramp.csv", input.clone(), rig(&input))]);
    assert!(found.repeatability.is_none() && found.method.contains("no"), "{found:?}");
    assert!(repeatability::estimate(&[]).repeatability.is_none());
}

#[test]
fn a_step_and_a_drift_within_a_recording_are_told_apart_and_a_clean_one_is_clean() {
    let input = strokes(2, 4000);
    let moved = |by: &dyn Fn(f64) -> f64| {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let output =
            rig(&input).into_iter().enumerate().map(|(index, value)| value + by(index as f64 / 4000.0) + 0.005 * normal(&mut random));
        drift::within(&recorded("r.csv", input.clone(), output.collect()))
    };
    assert_eq!(moved(&|_| 0.0), None);
    match moved(&|part| if part < 0.6 { 0.0 } else { 0.15 }) {
        Some(drift::Moved::Step { time_s, by, .. }) => assert!((time_s - 48.0).abs() < 2.0 && (by - 0.15).abs() < 0.04, "{time_s} {by}"),
        other => panic!("{other:?}"),
    }
    match moved(&|part| 0.2 * part) {
        Some(drift::Moved::Drift { by }) => assert!((by - 0.2).abs() < 0.05, "{by}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_a_loop_remembers_is_no_zero_that_moves() {
    // Strokes that shrink and grow again, and a bias that comes and goes: the output at one input depends on strokes long past.
    let input: Vec<f64> = (0..4000)
        .map(|index| {
            let part = f64::from(index) / 4000.0;
            let size = 0.1 + 0.4 * (1.0 - 2.0 * part).abs();
            0.5 + 0.15 * (12.0 * part).sin() + size * (150.0 * part).sin()
        })
        .collect();
    let mut states = [input[0]; 5];
    let thresholds = [0.03, 0.11, 0.17, 0.26, 0.38];
    let output: Vec<f64> = input
        .iter()
        .map(|&value| {
            hysteresis::play::step_bank(&thresholds, value, &mut states);
            states.iter().sum()
        })
        .collect();
    assert_eq!(drift::within(&recorded("r.csv", input.clone(), output.clone())), None);
    // A step of a twentieth of the range is still seen.
    let by = 0.05 * output.iter().fold(0.0_f64, |most, value| most.max(*value));
    let moved = output.iter().enumerate().map(|(index, value)| if index < 2400 { *value } else { value + by }).collect();
    match drift::within(&recorded("r.csv", input, moved)) {
        Some(drift::Moved::Step { time_s, by: found, .. }) => {
            assert!((time_s - 48.0).abs() < 2.0 && (found / by - 1.0).abs() < 0.2, "{time_s} {found}")
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_zero_that_drifts_from_recording_to_recording_is_seen() {
    let recordings = repeated(&[0.0, 0.02, 0.03, 0.05, 0.07, 0.08, 0.1, 0.12, 0.13], 0.005, 8);
    let offsets = drift::across(&recordings).expect("nine recordings");
    assert!((offsets.drift.expect("a drift") - 0.13).abs() < 0.02, "{offsets:?}");
    assert!(drift::across(&repeated(&[0.0, 0.0, 0.0], 0.005, 8)).expect("three").drift.is_none());
}
