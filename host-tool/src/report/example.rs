//! Recordings with what models made of them, as plots need them.

use std::path::PathBuf;

use serde::Serialize;

use crate::evaluate::{Errors, Judged, by_family};
use crate::recording::{Recording, Signal};

/// Most examples of one report.
const MOST_EXAMPLES: usize = 8;

/// A recording with what a model made of it, as plots need it.
#[derive(Clone, Debug, Serialize)]
pub struct Example {
    /// The recording.
    pub path: PathBuf,
    /// Its family of excitation.
    pub family: String,
    /// What was played.
    pub input_signal: Signal,
    /// What was measured.
    pub output_signal: Signal,
    /// Times in s, from the recording's first sample.
    pub time_s: Vec<f64>,
    /// Input.
    pub input: Vec<f64>,
    /// Measured output.
    pub measured: Vec<f64>,
    /// First sample that counts.
    pub first: usize,
    /// What models made of it, the one that the report is about last.
    pub predictions: Vec<Prediction>,
}

/// What one model made of a recording.
#[derive(Clone, Debug, Serialize)]
pub struct Prediction {
    /// Name of the model.
    pub model: String,
    /// Prediction, free running.
    pub predicted: Vec<f64>,
    /// Its errors.
    pub errors: Errors,
}

/// Of every family the recording with the largest error, in order of the families, at most eight. `name` is that of the model in legends.
#[must_use]
pub fn examples(name: &str, recordings: &[Recording], judged: &[Judged]) -> Vec<Example> {
    let mut chosen: Vec<usize> = Vec::new();
    for family in by_family(judged.iter().map(|judged| &judged.errors)) {
        let members = (0..judged.len()).filter(|&index| judged[index].errors.family == family.family);
        chosen.extend(members.max_by(|&one, &other| judged[one].errors.errors.rmse.total_cmp(&judged[other].errors.errors.rmse)));
    }
    if chosen.len() > MOST_EXAMPLES {
        chosen.sort_by(|&one, &other| judged[other].errors.errors.rmse.total_cmp(&judged[one].errors.errors.rmse));
        chosen.truncate(MOST_EXAMPLES);
        chosen.sort_unstable();
    }
    chosen.into_iter().map(|index| example(name, &recordings[index], &judged[index])).collect()
}

/// Adds what another model made of the same recordings, behind the model that the report is about.
pub fn add_prediction(examples: &mut [Example], name: &str, judged: &[Judged]) {
    for example in examples {
        if let Some(other) = judged.iter().find(|judged| judged.errors.path == example.path) {
            example.predictions.insert(0, prediction(name, other));
        }
    }
}

fn prediction(name: &str, judged: &Judged) -> Prediction {
    Prediction { model: name.to_owned(), predicted: judged.predicted.clone(), errors: judged.errors.errors }
}

fn example(name: &str, recording: &Recording, judged: &Judged) -> Example {
    Example {
        path: recording.path.clone(),
        family: recording.family.clone(),
        input_signal: recording.input_signal.clone(),
        output_signal: recording.output_signal.clone(),
        time_s: recording.time_s.iter().map(|time_s| time_s - recording.time_s[0]).collect(),
        input: recording.input.clone(),
        measured: recording.output.clone(),
        first: judged.first,
        predictions: vec![prediction(name, judged)],
    }
}
