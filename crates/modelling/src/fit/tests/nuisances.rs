//! Virtual recordings whose shape is known, with and without what moves a whole recording.

use super::*;
use crate::evaluate::{self, Errors};
use crate::fit::judging::mean;
use crate::physics::nuisance::Kind;
use crate::physics::{FittedModel, PhysicsModel};
use recording::{ExtraColumn, Recording};

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
            let sum = |time: f64| {
                0.55 * (std::f64::consts::TAU * slow * time + phase).sin()
                    + 0.45 * (std::f64::consts::TAU * fast * time + 1.3 * phase).sin()
            };
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
    Recording::new(
        Path::new(&format!("r{number:02}.csv")),
        recording::Signal::pressure_bar(),
        recording::Signal::displacement_mm(),
        time_s,
        input,
        output,
    )
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
        recording.extra = vec![
            ExtraColumn { name: "session_time_s".into(), values: session },
            ExtraColumn { name: "temperature_c".into(), values: warm },
        ];
    }
}

/// New recordings of the same map: with what is hidden, by another stream, or clean.
fn fresh(seed: u64, hidden: Hidden) -> Vec<Recording> {
    let mut made: Vec<Recording> = (0..6).map(|number| clean(seed + 50, number)).collect();
    hide(&mut made, hidden, seed + 50);
    made
}

fn fit_hidden(seed: u64, count: usize, hidden: Hidden) -> Outcome {
    let mut train: Vec<Recording> = (0..count).map(|number| clean(seed, number)).collect();
    hide(&mut train, hidden, seed);
    fit(&train, &physics_only(1), &|_| {}).expect("a ladder")
}

fn kinds(fitted: &Outcome) -> Vec<Kind> {
    fitted.ladder[fitted.chosen].nuisances.iter().map(|one| one.kind).collect()
}

fn predictor(fitted: &Outcome) -> Box<dyn Predictor> {
    match &fitted.ladder[fitted.chosen].model {
        RungModel::Physics(model) => Box::new(PhysicsPredictor::new((**model).clone(), Path::new("m"))),
        _ => Box::new(FittedPredictor::new(fitted.fitted(fitted.chosen).expect("a file"), Path::new("m"))),
    }
}

/// Mean error of a fit's model, as is or calibrated, as `evaluate` judges.
fn judged(fitted: &Outcome, recordings: &[Recording], calibrate_s: f64) -> f64 {
    let judging = evaluate::Judging { calibrate_s, ..evaluate::Judging::default() };
    let judged = evaluate::judge(&*predictor(fitted), recordings, judging, 2).expect("a judgement");
    mean(&judged.iter().map(|one| one.errors.errors.rmse).collect::<Vec<_>>())
}

/// Error of the shape on clean recordings: with each one's own zero taken off.
fn shape(fitted: &Outcome, seed: u64) -> f64 {
    let predictor = predictor(fitted);
    let one = |recording: &Recording| {
        let mut predicted = model::predict(&*predictor, recording, model::Fit::default()).expect("a prediction");
        evaluate::set_zero(&mut predicted, recording, 1e9);
        Errors::between(&predicted, &recording.output).rmse
    };
    mean(&fresh(seed, Hidden::default()).iter().map(one).collect::<Vec<_>>())
}

#[test]
fn with_zeros_the_shape_is_as_good_and_both_promises_hold() {
    let (plain, zeros) = (fit_hidden(1, 8, Hidden::default()), Hidden { zeros: 0.02, ..Hidden::default() });
    let fitted = fit_hidden(1, 8, zeros);
    assert_eq!((kinds(&plain), kinds(&fitted)), (vec![], vec![Kind::Zero]));
    let (without, with) = (shape(&plain, 1), shape(&fitted, 1));
    assert!(with < 1.2 * without, "{with} instead of {without}");
    let chosen = &fitted.ladder[fitted.chosen];
    let calibrated = chosen.calibrated.as_ref().expect("whole recordings were left out");
    assert!(calibrated.rmse < 0.2 * chosen.cv_rmse, "{} of {}", calibrated.rmse, chosen.cv_rmse);
    let new = fresh(1, zeros);
    for (error, [low, high]) in
        [(judged(&fitted, &new, 0.0), chosen.cv_interval), (judged(&fitted, &new, calibrated.calibrate_s), calibrated.interval)]
    {
        assert!(low <= error && error <= high, "{error} outside {low} .. {high}");
    }
    assert!(chosen.cv_interval[1] > 0.02 * RANGE, "the interval has the zeros: {:?}", chosen.cv_interval);
}

#[test]
fn evaluate_reproduces_both_figures_and_the_list_survives_the_file() {
    let hidden = Hidden { zeros: 0.02, drift: 0.1, temperature: 0.1, step: 0.05 };
    let fitted = fit_hidden(2, 14, hidden);
    let found = kinds(&fitted);
    // Zeros as large as what the temperature does hide it in so few recordings.
    assert!([Kind::Zero, Kind::Drift, Kind::Step].iter().all(|kind| found.contains(kind)), "{found:?}");
    let error = shape(&fitted, 2);
    // The noise is 0.0058 mm.
    assert!(error < 0.012, "{error}");
    // What the fit says of left-out predictions is what `evaluate` says of them.
    let chosen = &fitted.ladder[fitted.chosen];
    let calibrated = chosen.calibrated.as_ref().expect("whole recordings were left out");
    let recordings = &fitted.prepared.recordings;
    for (calibrate_s, promised) in [(0.0, chosen.cv_rmse), (calibrated.calibrate_s, calibrated.rmse)] {
        let one = |(recording, predicted): (&Recording, &Vec<f64>)| {
            let replay = Replay { description: predictor(&fitted).description().clone(), predicted: predicted.clone() };
            let judging = evaluate::Judging { calibrate_s, ..evaluate::Judging::default() };
            evaluate::judge(&replay, std::slice::from_ref(recording), judging, 1).expect("a judgement")[0].errors.errors.rmse
        };
        let errors: Vec<f64> = recordings.iter().zip(&chosen.predictions).map(one).collect();
        assert!((mean(&errors) - promised).abs() < 1e-12, "{} instead of {promised}", mean(&errors));
    }
    // Every rung's file keeps the list and both promises, and the model is the same without them.
    let folder = tempfile::tempdir().expect("a folder");
    for index in 0..fitted.ladder.len() {
        let path = folder.path().join("model");
        folder::write_rung(&fitted, index, &path).expect("written");
        let (expected, nuisances) = match model::format(&path).expect("a format") {
            model::Format::Fitted => {
                let read = FittedModel::read(&path).expect("read");
                (Some(read.expected), read.nuisances)
            }
            _ => {
                let read = PhysicsModel::read(&path).expect("read");
                (read.expected, read.nuisances)
            }
        };
        let rung = &fitted.ladder[index];
        assert_eq!((expected, &nuisances), (Some(fitted.expected(index)), &rung.nuisances), "{}", rung.name);
        assert!(!nuisances.is_empty(), "{}", rung.name);
    }
}

#[test]
fn damaged_files_are_refused() {
    let fitted = fit_hidden(3, 4, Hidden { zeros: 0.05, ..Hidden::default() });
    let index = fitted.ladder.iter().position(|rung| rung.name == "PI + dynamics").expect("a rung");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("model");
    fitted.fitted(index).expect("a sum").write(&path).expect("written");
    let text = std::fs::read_to_string(&path).expect("text");
    let line = |key: &str, value: &str| -> String {
        let lines =
            text.lines().map(|line| if line.starts_with(&format!("{key} = ")) { format!("{key} = {value}") } else { line.to_owned() });
        lines.collect::<Vec<_>>().join("\n")
    };
    assert!(FittedModel::read(&path).is_ok());
    for (key, value) in [
        ("constant", "1e300"),
        ("constant", "nan"),
        ("limits", "[-1e300, 1e300]"),
        ("lag_s", "-0.1"),
        ("dead_time_s", "1e8"),
        ("sample_period_s", "-1.0"),
        ("rmse", "nan"),
        ("minimum", "inf"),
    ] {
        let damaged = line(key, value);
        assert_ne!(damaged.trim(), text.trim(), "the file has a `{key}`");
        std::fs::write(&path, damaged).expect("written");
        let refused = model::load(&path).map(|_| ()).expect_err("a damaged file").to_string();
        assert!(refused.len() > 20, "{key} = {value}: {refused}");
    }
}

#[test]
fn a_recording_that_was_saved_twice_counts_once_and_notes_are_repeated() {
    let mut recordings: Vec<Recording> = (0..4).map(|number| clean(4, number)).collect();
    let mut again = recordings[1].clone();
    again.path = Path::new("again.csv").into();
    again.output.iter_mut().for_each(|value| *value = (*value * 1e5).round() / 1e5);
    recordings.push(again.until(700).expect("most of it"));
    let note = recording::Note::new(recording::Subject::Clipped, "The output may be clipped.");
    recordings[2].notes.push(note);
    let prepared = prepare::prepare(&recordings).expect("recordings");
    assert_eq!(prepared.recordings.len(), 4);
    assert!(prepared.notes.iter().any(|note| note.contains("again.csv") && note.contains("copy")), "{:?}", prepared.notes);
    assert!(prepared.notes.iter().any(|note| note.contains("r02.csv") && note.contains("clipped")), "{:?}", prepared.notes);
}

/// A predictor that says what another said.
struct Replay {
    description: model::Description,
    predicted: Vec<f64>,
}

impl Predictor for Replay {
    fn description(&self) -> &model::Description {
        &self.description
    }

    fn predict(&self, _: &[f64], _: &[usize]) -> Result<Vec<f64>, model::ModelError> {
        Ok(self.predicted.clone())
    }
}
