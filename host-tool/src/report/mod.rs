//! Reports: what was computed, drawn and explained, as one self-contained HTML document.
//!
//! The page is made from the same values that go into the JSON result and from nothing else. [`evaluation_page`] is for
//! `catheter evaluate --html`, [`demo::page`] for `catheter demo`; both are made of the sections here.

mod axis;
pub mod calibration;
pub mod chart;
pub mod check;
mod data;
mod decimate;
pub mod demo;
pub mod discovery;
pub mod fit;
mod page;
mod primer;
pub mod result;
mod sections;
mod svg;
pub use output::text;
pub mod track;

use std::path::PathBuf;

use serde::Serialize;

pub use page::Page;
pub use svg::Svg;

use crate::evaluate::ladder::Ladder;
use crate::evaluate::suite::SuiteReport;
use crate::evaluate::{Errors, FamilyErrors, Judged, by_family};
use crate::model::Description;
use crate::recording::{Recording, Signal};
use crate::train::Milestone;

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

/// The errors of a model on recordings, by family, and the worst of each as plots; nothing without any.
pub fn on_recordings(page: &mut Page, examples: &[Example], families: &[FamilyErrors], unit: &str) {
    if families.is_empty() {
        return;
    }
    page.section("On the recordings");
    sections::families(page, families, unit);
    sections::examples_help(page);
    sections::examples(page, examples);
}

/// How a training went: its error and that of validation, on a logarithmic scale.
pub fn training(page: &mut Page, history: &[Milestone], unit: &str) {
    page.section("How the training went");
    let steps: Vec<f64> = history.iter().map(|at| at.steps as f64).collect();
    let line = |name: &str, class, value: &dyn Fn(&Milestone) -> f64| {
        let values: Vec<f64> = history.iter().map(|at| value(at).log10()).collect();
        chart::Series::new(name, class, &steps, &values)
    };
    let series = vec![
        line("training", "one", &|at| at.training_rmse), //
        line("validation", "model", &|at| at.validation_rmse),
    ];
    let panel = chart::Panel { label: format!("log10(RMSE / {unit})"), series, height: 240.0, zero: false };
    let caption =
        chart::Caption { title: "Errors over the training", description: "Training and validation error over the optimiser's steps." };
    page.figure(
        chart::panels(caption, "optimiser steps", 760.0, &[panel]),
        page::Width::Full,
        "Validation runs freely over recordings that are not trained on; the weights with its least error are kept.",
    );
}

/// The report of one evaluation.
#[must_use]
pub fn evaluation_page(
    model: &Description,
    examples: &[Example],
    families: &[FamilyErrors],
    ladder: Option<&Ladder>,
    suite: Option<&SuiteReport>,
) -> String {
    let mean = families.iter().map(|family| family.rmse * family.files as f64).sum::<f64>();
    let files: usize = families.iter().map(|family| family.files).sum();
    let unit = &model.output.unit;
    let lead = format!(
        "{}: {}. Mean RMSE {} {unit} on {files} recording(s), free running: the model saw the input and never the measured output.",
        model.path.display(),
        model.kind,
        text::number(mean / files.max(1) as f64, 3)
    );
    let mut page = Page::new("How good the model is", &lead);
    page.section("On the recordings");
    sections::families(&mut page, families, unit);
    sections::examples_help(&mut page);
    sections::examples(&mut page, examples);
    if let Some(ladder) = ladder {
        page.section("The ladder: how simple a model suffices?");
        sections::ladder_help(&mut page, ladder);
        sections::ladder(&mut page, ladder, unit, "on the recordings");
    }
    if let Some(suite) = suite {
        page.section("The acceptance suite");
        sections::suite(&mut page, suite);
        sections::holds_help(&mut page, suite.plant.is_some());
        sections::holds(&mut page, &[("this model", suite)], &model.input.unit, unit);
    }
    primer::add(&mut page);
    page.finish(&format!("Made by catheter {}. All figures are in the JSON result (--json).", env!("CARGO_PKG_VERSION")))
}

#[cfg(test)]
mod tests;
