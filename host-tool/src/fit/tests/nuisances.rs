//! Virtual recordings whose shape is known, with and without what moves a whole recording.

use super::*;
use crate::evaluate::{self, Errors};
use crate::fit::nuisance::Kind;
use crate::recording::ExtraColumn;

/// Seconds between samples, samples of a recording, and the output's range.
const PERIOD_S: f64 = 0.05;
const SAMPLES: usize = 800;
const RANGE: f64 = 8.0;

/// What is hidden, as shares of the output's range.
#[derive(Clone, Copy, Default, Debug)]
struct Hidden {
    zeros: f64,
    /// From the first to the last recording.
    drift: f64,
    /// Over the range of the temperature.
    temperature: f64,
    /// In the middle of every third recording.
    step: f64,
}

/// Numbers in -1..1 that look like chance.
fn chance(seed: u64, number: usize) -> f64 {
    let value = (seed as f64 * 127.1 + number as f64 * 311.7).sin() * 43_758.545_3;
    2.0 * (value - value.floor()) - 1.0
}

/// One recording: play operators and a lag on a sum of sines of its own amplitude, from its own operating point.
fn clean(seed: u64, number: usize) -> Recording {
    let amplitude = 0.6 + 0.4 * chance(seed, 7 * number).abs();
    let (slow, fast) = (0.1 + 0.05 * chance(seed, 7 * number + 1), 0.43 + 0.1 * chance(seed, 7 * number + 2));
    let time_s: Vec<f64> = (0..SAMPLES).map(|index| index as f64 * PERIOD_S).collect();
    let phase = 3.0 * chance(seed, 7 * number + 3);
    let input: Vec<f64> = time_s
        .iter()
        .map(|time| {
            let sum = |time: f64| 0.7 * (std::f64::consts::TAU * slow * time + phase).sin() + 0.3 * (std::f64::consts::TAU * fast * time + 1.3 * phase).sin();
            let begin = (time / 2.0).min(1.0);
            1.0 + begin * amplitude * sum(*time)
        })
        .collect();
    let mut states = [1.0_f64; 3];
    let mut lagged: Option<f64> = None;
    let output = input
        .iter()
        .enumerate()
        .map(|(index, &input)| {
            let mut sum = 0.8 * input;
            for (state, (threshold, weight)) in states.iter_mut().zip([(0.15, 1.2), (0.35, 0.9), (0.7, 1.0)]) {
                *state = (*state).max(input - threshold).min(input + threshold);
                sum += weight * *state;
            }
            let lagged = lagged.get_or_insert(sum);
            *lagged += 0.4 * (sum - *lagged);
            *lagged + 0.01 * chance(seed + 1, number * SAMPLES + index)
        })
        .collect();
    Recording::new(Path::new(&format!("r{number:02}.csv")), crate::recording::Signal::pressure_bar(), crate::recording::Signal::displacement_mm(), time_s, input, output)
        .expect("a recording")
}

fn hide(recordings: &mut [Recording], hidden: Hidden, seed: u64) {
    let count = recordings.len();
    for (number, recording) in recordings.iter_mut().enumerate() {
        let day = number as f64 / (count - 1) as f64 - 0.5;
        let temperature = 25.0 + 4.0 * (5.0 * day).sin() + chance(seed, 900 + number);
        let zero = hidden.zeros * RANGE * 1.7 * chance(seed, 500 + number);
        let length = recording.len();
        for (index, output) in recording.output.iter_mut().enumerate() {
            let behind = number % 3 == 1 && index >= length / 2 + 37;
            let warm = temperature + 0.2 * (index as f64 / length as f64);
            *output += zero
                + hidden.drift * RANGE * (day + index as f64 / length as f64 / count as f64 * 0.1)
                + hidden.temperature * RANGE * (warm - 25.0) / 8.0
                + if behind { hidden.step * RANGE } else { 0.0 };
        }
        let session = (0..length).map(|index| number as f64 * 1800.0 + index as f64 * PERIOD_S).collect();
        let warm = (0..length).map(|index| temperature + 0.2 * (index as f64 / length as f64)).collect();
        recording.extra = vec![ExtraColumn { name: "session_time_s".into(), values: session }, ExtraColumn { name: "temperature_c".into(), values: warm }];
    }
}

/// A fit of hidden recordings, what it names, and the error of its shape on clean recordings.
fn shape(seed: u64, count: usize, hidden: Hidden) -> (Outcome, Vec<Kind>, f64) {
    let mut train: Vec<Recording> = (0..count).map(|number| clean(seed, number)).collect();
    hide(&mut train, hidden, seed);
    let fitted = fit(&train, &physics_only(1), &|_| {}).expect("a ladder");
    let test: Vec<Recording> = (0..6).map(|number| clean(seed + 50, number)).collect();
    let predictor = predictor(&fitted);
    let one = |recording: &Recording| {
        let mut predicted = model::predict(&*predictor, recording, model::Fit::default()).expect("a prediction");
        evaluate::set_zero(&mut predicted, recording, 1e9);
        Errors::between(&predicted, &recording.output).rmse
    };
    let error = mean(&test.iter().map(one).collect::<Vec<_>>());
    let kinds = fitted.ladder[fitted.chosen].nuisances.iter().map(|one| one.kind).collect();
    (fitted, kinds, error)
}

fn predictor(fitted: &Outcome) -> Box<dyn Predictor> {
    match &fitted.ladder[fitted.chosen].model {
        RungModel::Physics(model) => Box::new(PhysicsPredictor::new((**model).clone(), Path::new("m"))),
        _ => Box::new(FittedPredictor::new(fitted.fitted(fitted.chosen).expect("a file"), Path::new("m"))),
    }
}

#[test]
#[ignore = "exploration"]
fn explore() {
    for seed in [1, 2, 3] {
        for count in [6, 12] {
            for hidden in [
                Hidden::default(),
                Hidden { zeros: 0.005, ..Hidden::default() },
                Hidden { zeros: 0.02, ..Hidden::default() },
                Hidden { zeros: 0.05, ..Hidden::default() },
                Hidden { drift: 0.1, ..Hidden::default() },
                Hidden { temperature: 0.05, ..Hidden::default() },
                Hidden { step: 0.05, ..Hidden::default() },
                Hidden { zeros: 0.02, drift: 0.1, temperature: 0.1, step: 0.05 },
            ] {
                let clock = std::time::Instant::now();
                let (fitted, kinds, error) = shape(seed, count, hidden);
                let chosen = &fitted.ladder[fitted.chosen];
                println!("seed {seed} n {count} {hidden:?}: {kinds:?} shape {error:.5} {} cv {:.4} {:?} cal {:?} shape {:.5} {:.1} s", chosen.name, chosen.cv_rmse, chosen.cv_interval, chosen.calibrated.as_ref().map(|c| (c.calibrate_s, c.rmse, c.interval)), chosen.shape_rmse, clock.elapsed().as_secs_f64());
            }
        }
    }
}
