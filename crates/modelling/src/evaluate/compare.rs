//! Two implementations of one model on the same inputs: how far apart they are, and whether that grows with time.

use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};

use super::metrics::{range, root_mean_square};
use crate::model::Predictor;

/// Stretches that a long run is cut into, to see growth.
pub const STRETCHES: usize = 10;

/// Differences between two models, in the output's unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Samples compared.
    pub n: usize,
    /// Root mean square difference.
    pub rmse: f64,
    /// RMSE over the range of the first model's output.
    pub nrmse: Option<f64>,
    /// Largest difference.
    pub max_abs: f64,
    /// Root mean square difference of each tenth of the run, in order.
    pub stretches: Vec<f64>,
    /// Last three tenths over first three tenths, less what is no growth: see [`growth`].
    pub growth: f64,
}

/// Runs both models freely on an input.
///
/// # Errors
/// When a model cannot be run.
pub fn compare(reference: &dyn Predictor, other: &dyn Predictor, input: &[f64]) -> Result<Comparison> {
    let (first, second) = (reference.predict(input, &[])?, other.predict(input, &[])?);
    ensure!(first.len() == second.len(), "two models of one input give outputs of different lengths");
    let differences: Vec<f64> = first.iter().zip(&second).map(|(first, second)| second - first).collect();
    let rmse = root_mean_square(differences.iter().copied());
    let span = range(&first);
    let stretches = stretches(&differences);
    Ok(Comparison {
        n: differences.len(),
        rmse,
        nrmse: (span > 0.0).then(|| rmse / span),
        max_abs: differences.iter().map(|difference| difference.abs()).fold(0.0, f64::max),
        growth: growth(&stretches),
        stretches,
    })
}

/// Root mean square of each tenth of a run, in order; fewer when there are fewer samples.
#[must_use]
pub fn stretches(errors: &[f64]) -> Vec<f64> {
    let length = errors.len().div_ceil(STRETCHES).max(1);
    errors.chunks(length).map(|stretch| root_mean_square(stretch.iter().copied())).collect()
}

/// How much larger the error is at the end of a run than at its start: root mean square of the last three stretches less that of the
/// first three, in the unit of the error; negative when it shrinks. Three of ten, so that one lively stretch decides nothing.
#[must_use]
pub fn growth(stretches: &[f64]) -> f64 {
    let few = stretches.len().min(3);
    let part = |part: &[f64]| root_mean_square(part.iter().copied());
    part(&stretches[stretches.len() - few..]) - part(&stretches[..few])
}
