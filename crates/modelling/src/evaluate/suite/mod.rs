//! The acceptance suite: what a model must do beyond a small error on recordings like those it was trained on.
//!
//! A network can have a tiny RMSE and still drift while the pressure rests, depend on where it started, or diverge after ten minutes;
//! each criterion here has caught a real model doing one of these. Where the *plant* that made the recordings is known (a simulated
//! rig), it makes new truth for every criterion (`with_plant`). Where it is not (a measured rig), the suite asks what can be
//! asked without truth (`without_plant`): an output that rests when the input rests, that repeats when the input repeats, and that
//! forgets its start when the input has wiped it out.
//!
//! Seeds: the suite's excitations come from `--seed` plus [`SEED_OFFSET`], so that a model trained on `simulate --seed N` is not judged
//! on the signals of seed N.

mod plants;
mod with_plant;
mod without_plant;

use anyhow::Result;
use serde::{Deserialize, Serialize};

pub use plants::{KnownPlant, find};

use super::compare::{Comparison, compare, growth, stretches};
use super::{FileErrors, Judging, mean_nrmse};
use crate::model::Predictor;
use recording::Recording;

/// Keeps the suite's seeds apart from those of training and test sets.
pub const SEED_OFFSET: u64 = 0x0053_7569_7465_0000;
/// Samples of the long run.
pub const LONG_RUN: usize = 100_000;
/// Length of a hold in s.
pub const HOLD_S: f64 = 60.0;
/// Times into a hold at which the error is kept for plots, in s.
pub const HOLD_TIMES_S: [f64; 12] = [0.0, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 40.0, 50.0, 59.9];

/// Limits as shares of the output range, so that one suite fits a catheter of 2 mm and a piezo of 40 um.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// NRMSE on recordings of a known plant; the paper reports 0.0077 and 0.0047 of the excitation amplitude on its real rig.
    pub recordings: f64,
    /// NRMSE on recordings of a measured rig, noise and all.
    pub recordings_measured: f64,
    /// RMSE on new signals of a known plant, and spread between starting histories.
    pub signals: f64,
    /// Largest error during a hold: 0.01 mm of the 2 mm that the default plant travels.
    pub hold: f64,
    /// Change of the output during a hold of a measured rig, from 10 s on; the rig's own creep counts.
    pub hold_drift: f64,
    /// RMSE between fixed point and `f32`: 0.001 mm of 2 mm.
    pub fixed_point: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { recordings: 0.01, recordings_measured: 0.06, signals: 0.005, hold: 0.005, hold_drift: 0.02, fixed_point: 0.0005 }
    }
}

/// One thing a model must do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Criterion {
    /// Short name, stable for programs.
    pub name: String,
    /// What was done and measured, in words.
    pub what: String,
    /// What was measured.
    pub value: f64,
    /// What it may be at most.
    pub limit: f64,
    /// Unit of both.
    pub unit: String,
    /// Whether it holds; a value that is not a number does not.
    pub passed: bool,
}

impl Criterion {
    /// Compares a value with its limit.
    #[must_use]
    pub fn at_most(name: &str, what: String, value: f64, limit: f64, unit: &str) -> Self {
        Self { name: name.to_owned(), what, value, limit, unit: unit.to_owned(), passed: value <= limit }
    }
}

/// One hold of the suite.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hold {
    /// Level of the input.
    pub level: f64,
    /// Largest magnitude of the error from the first to the last sample of the hold; without a plant, of the drift after 10 s.
    pub max_abs: f64,
    /// Error (without a plant: change of the prediction) at each of [`HOLD_TIMES_S`].
    pub errors: Vec<f64>,
}

/// Result of the suite.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SuiteReport {
    /// The plant that made the truth; absent for a measured rig.
    pub plant: Option<String>,
    /// Whether every criterion holds.
    pub passed: bool,
    /// The criteria in order.
    pub criteria: Vec<Criterion>,
    /// The holds by level.
    pub holds: Vec<Hold>,
    /// Times of the holds' errors in s.
    pub hold_times_s: Vec<f64>,
    /// RMSE of each tenth of the long run; without a plant, of the change against the first pass.
    pub long_run: Vec<f64>,
    /// The blob against the model it was made from.
    pub fixed_point: Option<Comparison>,
    /// What could not be judged, and why.
    pub not_judged: Vec<String>,
}

/// What the suite works on.
pub struct Request<'a> {
    /// The model to judge.
    pub model: &'a dyn Predictor,
    /// The same model before quantisation.
    pub reference: Option<&'a dyn Predictor>,
    /// Recordings: they give the range of the input, and, for a measured rig, the signals.
    pub recordings: &'a [Recording],
    /// Errors on these recordings.
    pub errors: &'a [FileErrors],
    /// How recordings are judged.
    pub judging: Judging,
    /// The plant that made the recordings, where known.
    pub plant: Option<&'a KnownPlant>,
    /// Limits.
    pub limits: Limits,
    /// Seed of the suite's signals; [`SEED_OFFSET`] is added.
    pub seed: u64,
    /// Threads; the result does not depend on them.
    pub threads: usize,
}

/// Runs the suite.
///
/// # Errors
/// When a model cannot be run. A limit that does not hold is no error but a criterion that is not passed.
pub fn run(request: &Request<'_>) -> Result<SuiteReport> {
    let mut report = SuiteReport {
        plant: request.plant.map(|plant| plant.name.clone()),
        passed: false,
        criteria: Vec::new(),
        holds: Vec::new(),
        hold_times_s: HOLD_TIMES_S.to_vec(),
        long_run: Vec::new(),
        fixed_point: None,
        not_judged: Vec::new(),
    };
    on_recordings(request, &mut report);
    let long_input = match request.plant {
        Some(plant) => with_plant::run(request, plant, &mut report)?,
        None => without_plant::run(request, &mut report)?,
    };
    if let Some(reference) = request.reference {
        fixed_point(request, reference, &long_input, &mut report)?;
    }
    report.passed = report.criteria.iter().all(|criterion| criterion.passed);
    Ok(report)
}

fn on_recordings(request: &Request<'_>, report: &mut SuiteReport) {
    let limit = if request.plant.is_some() { request.limits.recordings } else { request.limits.recordings_measured };
    match mean_nrmse(request.errors) {
        Some(value) => {
            let what = format!("mean NRMSE on the {} recording(s) given, free running", request.errors.len());
            report.criteria.push(Criterion::at_most("recordings", what, value, limit, "of range"));
        }
        None => report.not_judged.push("recordings: the measured output never moves".to_owned()),
    }
}

fn fixed_point(request: &Request<'_>, reference: &dyn Predictor, long_input: &[f64], report: &mut SuiteReport) -> Result<()> {
    let comparison = compare(reference, request.model, long_input)?;
    let range = output_range(request);
    let unit = &request.model.description().output.unit;
    let n = comparison.n;
    let limit = request.limits.fixed_point * range;
    let what = format!("RMSE between fixed point and f32 over {n} samples with holds");
    report.criteria.push(Criterion::at_most("fixed-point", what, comparison.rmse, limit, unit));
    let what = format!("growth of that difference from the first to the last three tenths of {n} samples");
    report.criteria.push(Criterion::at_most("fixed-point-growth", what, comparison.growth, 0.25 * limit, unit));
    report.fixed_point = Some(comparison);
    Ok(())
}

/// Range of the recordings' output over all files.
fn output_range(request: &Request<'_>) -> f64 {
    span(request.recordings.iter().flat_map(|recording| &recording.output)).map_or(0.0, |(low, high)| high - low)
}

/// Smallest and largest value; none of nothing.
fn span<'a>(values: impl IntoIterator<Item = &'a f64>) -> Option<(f64, f64)> {
    let mut values = values.into_iter();
    let first = *values.next()?;
    Some(values.fold((first, first), |(low, high), &value| (low.min(value), high.max(value))))
}

/// Largest magnitude; not a number as soon as one value is not, so that no limit is met by nonsense.
fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |largest: f64, value| if value.is_nan() || largest.is_nan() { f64::NAN } else { largest.max(value.abs()) })
}

/// The samples at [`HOLD_TIMES_S`] of a hold.
fn at_hold_times(errors: &[f64], period_s: f64) -> Vec<f64> {
    let index = |time_s: f64| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a sample number within a minute")]
        let index = (time_s / period_s).round() as usize;
        index.min(errors.len().saturating_sub(1))
    };
    HOLD_TIMES_S.iter().filter_map(|&time_s| errors.get(index(time_s)).copied()).collect()
}
