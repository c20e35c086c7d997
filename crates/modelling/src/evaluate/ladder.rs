//! The ladder: models of growing complexity side by side on the same recordings, and the simplest one that suffices.
//!
//! The rungs stand in the order of what they assume, not of their error: a static curve, play operators (Prandtl-Ishlinskii), play
//! operators with a curve (modified), play operators behind a dead time and a lag, then networks. A rung *suffices* when its mean RMSE
//! is at most [`WITHIN`] times the best rung's, or at most [`FLOOR`] of the mean output range, below which a difference is of no
//! consequence at the rig. The first rung that suffices is the one to use: what stands above it costs more and gains nothing.

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use super::metrics::{FamilyErrors, mean};
use super::statics::Polynomial;
use super::{Judged, Judging, by_family, judge, mean_nrmse, mean_rmse};
use crate::identify::{self, Choice, FitConfig, Kind, PhysicsModel};
use crate::model::{PhysicsPredictor, Predictor};
use recording::Recording;

/// A rung suffices within this factor of the best.
pub const WITHIN: f64 = 1.25;
/// A rung suffices below this share of the output range.
pub const FLOOR: f64 = 0.001;

/// The rule in words, for reports.
#[must_use]
pub fn rule() -> String {
    format!(
        "the first rung whose mean RMSE is at most {WITHIN} times the best rung's, or at most {} % of the mean output range",
        100.0 * FLOOR
    )
}

/// One model on the ladder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rung {
    /// Short name.
    pub name: String,
    /// What it is, in words.
    pub kind: String,
    /// Numbers that were fitted.
    pub parameters: usize,
    /// Multiplications of one step.
    pub macs_per_step: usize,
    /// Mean of the files' RMSE.
    pub mean_rmse: f64,
    /// Mean of the files' NRMSE.
    pub mean_nrmse: Option<f64>,
    /// Largest error.
    pub max_abs: f64,
    /// Errors by family.
    pub families: Vec<FamilyErrors>,
    /// Whether it suffices by the rule.
    pub sufficient: bool,
}

/// All rungs, lowest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ladder {
    /// The rungs.
    pub rungs: Vec<Rung>,
    /// Name of the simplest one that suffices.
    pub simplest_sufficient: Option<String>,
    /// The rule that chose it.
    pub rule: String,
}

/// A named model.
pub struct Entry {
    /// Short name.
    pub name: String,
    /// The model.
    pub model: Box<dyn Predictor>,
}

/// Fits the rungs below the networks: static curve, Prandtl-Ishlinskii, modified Prandtl-Ishlinskii, and play operators behind a dead
/// time and a lag. The first `skip_s` seconds of each recording do not count.
///
/// # Errors
/// When the recordings do not go together or cannot be identified.
pub fn simple_rungs(training: &[Recording], skip_s: f64) -> Result<Vec<Entry>> {
    let fit = identify::fit(training, &FitConfig { skip_s, ..FitConfig::default() }).context("the ladder's rung `PI`")?;
    simple_rungs_from(fit.model, training, skip_s)
}

/// As [`simple_rungs`], around a Prandtl-Ishlinskii model that was already fitted to the same recordings.
///
/// # Errors
/// As [`simple_rungs`].
pub fn simple_rungs_from(fitted: PhysicsModel, training: &[Recording], skip_s: f64) -> Result<Vec<Entry>> {
    let base = || FitConfig { skip_s, ..FitConfig::default() };
    let physics = |name: &str, config: FitConfig| -> Result<Entry> {
        let fit = identify::fit(training, &config).with_context(|| format!("the ladder's rung `{name}`"))?;
        Ok(Entry { name: name.to_owned(), model: Box::new(PhysicsPredictor::new(fit.model, std::path::Path::new(name))) })
    };
    Ok(vec![
        Entry { name: "static".to_owned(), model: Box::new(Polynomial::fit(training, skip_s)?) },
        Entry { name: "PI".to_owned(), model: Box::new(PhysicsPredictor::new(fitted, std::path::Path::new("PI"))) },
        physics("modified PI", FitConfig { kind: Kind::ModifiedPrandtlIshlinskii, ..base() })?,
        physics(
            "modified PI, delayed",
            FitConfig { kind: Kind::ModifiedPrandtlIshlinskii, dead_time_s: Choice::Auto, lag_time_constant_s: Choice::Auto, ..base() },
        )?,
    ])
}

/// A rung from what a model made of the recordings.
#[must_use]
pub fn rung(name: &str, model: &dyn Predictor, judged: &[Judged]) -> Rung {
    let files: Vec<_> = judged.iter().map(|judged| &judged.errors).collect();
    let description = model.description();
    Rung {
        name: name.to_owned(),
        kind: description.kind.clone(),
        parameters: description.parameters,
        macs_per_step: description.macs_per_step,
        mean_rmse: mean_rmse(files.iter().copied()),
        mean_nrmse: mean_nrmse(files.iter().copied()),
        max_abs: files.iter().map(|file| file.errors.max_abs).fold(0.0, f64::max),
        families: by_family(files.iter().copied()),
        sufficient: false,
    }
}

/// Puts rungs side by side and applies the rule; `output_range` is the mean range of the recordings' outputs.
#[must_use]
pub fn ladder(mut rungs: Vec<Rung>, output_range: f64) -> Ladder {
    let best = rungs.iter().map(|rung| rung.mean_rmse).fold(f64::INFINITY, f64::min);
    let bound = (WITHIN * best).max(FLOOR * output_range);
    rungs.iter_mut().for_each(|rung| rung.sufficient = rung.mean_rmse <= bound);
    let simplest_sufficient = rungs.iter().find(|rung| rung.sufficient).map(|rung| rung.name.clone());
    Ladder { rungs, simplest_sufficient, rule: rule() }
}

/// Judges every entry on the recordings and puts them side by side, in the order given.
///
/// # Errors
/// As [`judge`].
pub fn climb(entries: &[Entry], recordings: &[Recording], judging: Judging, threads: usize) -> Result<Ladder> {
    let mut rungs = Vec::with_capacity(entries.len());
    let mut ranges = Vec::new();
    for entry in entries {
        let judged = judge(&*entry.model, recordings, judging, threads).with_context(|| format!("rung `{}`", entry.name))?;
        ranges = judged.iter().map(|judged| judged.errors.errors.output_range).collect();
        rungs.push(rung(&entry.name, &*entry.model, &judged));
    }
    Ok(ladder(rungs, mean(&ranges).unwrap_or(0.0)))
}
