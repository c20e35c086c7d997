//! What the suite works on, what it finds, and its limits.

use serde::{Deserialize, Serialize};

use super::plants::KnownPlant;
use crate::evaluate::compare::Comparison;
use crate::evaluate::{FileErrors, Judging};
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

/// Range of the recordings' output over all files.
pub(super) fn output_range(request: &Request<'_>) -> f64 {
    span(request.recordings.iter().flat_map(|recording| &recording.output)).map_or(0.0, |(low, high)| high - low)
}

/// Smallest and largest value; none of nothing.
pub(super) fn span<'a>(values: impl IntoIterator<Item = &'a f64>) -> Option<(f64, f64)> {
    let mut values = values.into_iter();
    let first = *values.next()?;
    Some(values.fold((first, first), |(low, high), &value| (low.min(value), high.max(value))))
}

/// Largest magnitude; not a number as soon as one value is not, so that no limit is met by nonsense.
pub(super) fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |largest: f64, value| if value.is_nan() || largest.is_nan() { f64::NAN } else { largest.max(value.abs()) })
}

/// The samples at [`HOLD_TIMES_S`] of a hold.
pub(super) fn at_hold_times(errors: &[f64], period_s: f64) -> Vec<f64> {
    let index = |time_s: f64| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a sample number within a minute")]
        let index = (time_s / period_s).round() as usize;
        index.min(errors.len().saturating_sub(1))
    };
    HOLD_TIMES_S.iter().filter_map(|&time_s| errors.get(index(time_s)).copied()).collect()
}
