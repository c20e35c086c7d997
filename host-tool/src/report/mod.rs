//! Reports: what was computed, drawn and explained, as one self-contained HTML document.
//!
//! The page is made from the same values that go into the JSON result and from nothing else. [`evaluation_page`] is for
//! `catheter evaluate --html`, [`crate::demo`] makes that of `catheter demo`; both are made of the sections here.

mod axis;
pub mod calibration;
pub mod chart;
pub mod check;
mod data;
mod decimate;
pub mod discovery;
mod example;
pub mod fit;
pub(crate) mod page;
pub(crate) mod primer;
pub mod result;
pub(crate) mod sections;
mod series;
mod svg;
pub use output::text;
pub mod track;

pub use example::{Example, Prediction, add_prediction, examples};
pub use page::Page;
pub use svg::Svg;

use crate::evaluate::FamilyErrors;
use crate::evaluate::ladder::Ladder;
use crate::evaluate::suite::SuiteReport;
use crate::model::Description;
use crate::train::Milestone;

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
        let values: Vec<f64> = history.iter().map(value).collect();
        chart::Series::new(name, class, &steps, &values)
    };
    let series = vec![
        line("training", "one", &|at| at.training_rmse), //
        line("validation", "model", &|at| at.validation_rmse),
    ];
    let caption =
        chart::Caption { title: "Errors over the training", description: "Training and validation error over the optimiser's steps." };
    page.figure(
        chart::decades(caption, "optimiser steps", &format!("RMSE / {unit}"), (760.0, 310.0), &series),
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
