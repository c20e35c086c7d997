//! Error figures.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// How far a prediction is from a measurement; all but `n` and `nrmse` in the output's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Samples that count.
    pub n: usize,
    /// Root mean square error.
    pub rmse: f64,
    /// RMSE over the range of the measured output; absent when that output never moves.
    pub nrmse: Option<f64>,
    /// Largest magnitude of the error.
    pub max_abs: f64,
    /// Mean of prediction less measurement.
    pub mean_error: f64,
    /// Maximum less minimum of the measured output.
    pub output_range: f64,
}

impl Errors {
    /// Compares a prediction with a measurement, sample by sample.
    ///
    /// # Panics
    /// When the lengths differ.
    #[must_use]
    pub fn between(predicted: &[f64], measured: &[f64]) -> Self {
        assert_eq!(predicted.len(), measured.len(), "a prediction for every sample");
        let n = measured.len();
        let count = n.max(1) as f64;
        let errors = || predicted.iter().zip(measured).map(|(predicted, measured)| predicted - measured);
        let rmse = (errors().map(|error| error * error).sum::<f64>() / count).sqrt();
        let output_range = range(measured);
        Self {
            n,
            rmse,
            nrmse: (output_range > 0.0).then(|| rmse / output_range),
            max_abs: errors().map(f64::abs).fold(0.0, f64::max),
            mean_error: errors().sum::<f64>() / count,
            output_range,
        }
    }
}

/// Errors of one recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FileErrors {
    /// The recording.
    pub path: PathBuf,
    /// Its family of excitation.
    pub family: String,
    /// The errors.
    #[serde(flatten)]
    pub errors: Errors,
}

/// Errors of all recordings of a family.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FamilyErrors {
    /// The family.
    pub family: String,
    /// Recordings in it.
    pub files: usize,
    /// Samples in all.
    pub n: usize,
    /// Mean of the files' RMSE.
    pub rmse: f64,
    /// Mean of the files' NRMSE, over those that have one.
    pub nrmse: Option<f64>,
    /// Largest error of all.
    pub max_abs: f64,
}

/// Families in order of their first file.
#[must_use]
pub fn by_family<'a>(files: impl IntoIterator<Item = &'a FileErrors> + Clone) -> Vec<FamilyErrors> {
    let mut names: Vec<&str> = Vec::new();
    for file in files.clone() {
        if !names.contains(&file.family.as_str()) {
            names.push(&file.family);
        }
    }
    let of_family = |name: &str| {
        let members: Vec<&Errors> = files.clone().into_iter().filter(|file| file.family == name).map(|file| &file.errors).collect();
        let relative: Vec<f64> = members.iter().filter_map(|errors| errors.nrmse).collect();
        FamilyErrors {
            family: name.to_owned(),
            files: members.len(),
            n: members.iter().map(|errors| errors.n).sum(),
            rmse: members.iter().map(|errors| errors.rmse).sum::<f64>() / members.len() as f64,
            nrmse: mean(&relative),
            max_abs: members.iter().map(|errors| errors.max_abs).fold(0.0, f64::max),
        }
    };
    names.into_iter().map(of_family).collect()
}

/// Mean of the files' NRMSE, over those that have one.
#[must_use]
pub fn mean_nrmse<'a>(files: impl IntoIterator<Item = &'a FileErrors>) -> Option<f64> {
    let each: Vec<f64> = files.into_iter().filter_map(|file| file.errors.nrmse).collect();
    mean(&each)
}

/// Mean of the files' RMSE; zero without files.
#[must_use]
pub fn mean_rmse<'a>(files: impl IntoIterator<Item = &'a FileErrors>) -> f64 {
    let each: Vec<f64> = files.into_iter().map(|file| file.errors.rmse).collect();
    mean(&each).unwrap_or(0.0)
}

/// Root mean square over all samples of all files, each sample counting the same; zero without files.
#[must_use]
pub fn pooled_rmse<'a>(files: impl IntoIterator<Item = &'a FileErrors>) -> f64 {
    let add = |(sum, count): (f64, f64), file: &FileErrors| {
        let samples = file.errors.n as f64;
        (sum + samples * file.errors.rmse.powi(2), count + samples)
    };
    let (sum, count) = files.into_iter().fold((0.0, 0.0), add);
    (sum / count.max(1.0)).sqrt()
}

/// Arithmetic mean; none of nothing.
pub(super) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Root mean square; zero of nothing.
pub(super) fn root_mean_square(values: impl IntoIterator<Item = f64>) -> f64 {
    let (count, squares) = values.into_iter().fold((0usize, 0.0), |(count, squares), value| (count + 1, squares + value * value));
    (squares / count.max(1) as f64).sqrt()
}

/// Maximum less minimum; zero of nothing.
pub(super) fn range(values: &[f64]) -> f64 {
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)));
    if high >= low { high - low } else { 0.0 }
}
