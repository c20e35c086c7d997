//! What a discovery results in, with the keys of the command's contract.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::explanation::diagnosis::{LoopArea, Residual};
use crate::explanation::horizon;
use crate::explanation::residual_map::Disagreement;

/// How to discover.
#[derive(Clone, Debug)]
pub struct DiscoverConfig {
    /// Worker threads.
    pub threads: usize,
    /// Most effects to add.
    pub most_effects: usize,
    /// Seed of the surrogates.
    pub seed: u64,
}

impl Default for DiscoverConfig {
    fn default() -> Self {
        Self { threads: std::thread::available_parallelism().map_or(1, usize::from), most_effects: 3, seed: 1 }
    }
}

/// What was found out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The model explains the recordings down to the noise.
    #[default]
    None,
    /// The effects named explain the gap.
    Named,
    /// Two effects explain it equally well, the one that was found leaves more than its law would, or recordings that were kept out do not confirm it.
    Ambiguous,
    /// Nothing in the catalogue explains it.
    Unknown,
}

/// An effect that was named.
#[derive(Clone, Debug, Serialize)]
pub struct Effect {
    /// Name from the vocabulary.
    pub name: String,
    /// Which form of it.
    pub form: String,
    /// How sure, 0 to 1, against all other effects.
    pub confidence: f64,
    /// Parameters in the lab's units.
    pub parameters: BTreeMap<String, f64>,
    /// Where each non-linear parameter lies with 95 % confidence.
    pub intervals: BTreeMap<String, [f64; 2]>,
}

/// The effect that came second.
#[derive(Clone, Debug, Serialize)]
pub struct RunnerUp {
    /// Its name.
    pub name: String,
    /// Whether the recordings tell it from the first.
    pub separable: bool,
}

/// One effect tried alone.
#[derive(Clone, Debug, Serialize)]
pub struct Candidate {
    /// Its name.
    pub name: String,
    /// Share of the mean square that it takes away on the selecting samples, 0 to 1; may be negative.
    pub score: f64,
    /// Probability of such a gain by chance.
    pub p_value: f64,
}

/// A member of the confidence set.
#[derive(Clone, Debug, Serialize)]
pub struct Member {
    /// Names of its effects; empty for the model without any.
    pub effects: Vec<String>,
    /// Mean log predictive density over that of the model without effects, nats per sample.
    pub criterion: f64,
    /// Probability of a distance from the other members like its own, were all as good.
    pub p_value: f64,
}

/// The result, with the keys of the command's contract.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Discovery {
    /// Verdict.
    pub verdict: Verdict,
    /// Effects, the largest first.
    pub effects: Vec<Effect>,
    /// Second best explanation.
    pub runner_up: Option<RunnerUp>,
    /// RMSE of the simulation without the effects on test samples, free running, output units.
    pub rmse_before: f64,
    /// RMSE of the simulation with them on test samples, free running, output units.
    pub rmse_after: f64,
    /// Noise, output units.
    pub noise_floor: f64,
    /// Share of the gap closed, `(before - after) / (before - floor)`, 0 to 1.
    pub gap_closed: f64,
    /// Where something jumps: RMSE of the smooth observer, which knows no jumps, on test samples, one step ahead, output units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rmse_before_one_step: Option<f64>,
    /// The same of the observer that knows the jumps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rmse_after_one_step: Option<f64>,
    /// Share of the gap closed one step ahead, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gap_closed_one_step: Option<f64>,
    /// Start-up stretch of each kept-out recording over which the zero was set before and after, s, and which does not count; absent when
    /// the simulations ran as they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibrate_s: Option<f64>,
    /// Share of the mean square above the noise that stays unexplained on the samples worked with, 0 to 1.
    pub unexplained: f64,
    /// Mean log predictive density of recordings that took no part in the fit, of the model with the effects over that of the model without,
    /// nats per sample; absent when nothing was compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub criterion: Option<f64>,
    /// The simplest explanations that no other predicts such recordings significantly better than, best first.
    pub confidence_set: Vec<Member>,
    /// Every effect tried alone, best first.
    pub candidates: Vec<Candidate>,
    /// Where the model without effects and the measurement disagree.
    #[serde(rename = "where")]
    pub disagreements: Vec<Disagreement>,
    /// The same in a sentence.
    pub summary: String,
    /// Error of the best predictor that sees a window of the input, against the window's length; empty where recordings cannot tell.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub memory_horizon: Vec<horizon::Window>,
    /// What opens the loops of the model without effects.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loop_area: Option<LoopArea>,
    /// How far from noise the residual is without the effects.
    pub residual_before: Residual,
    /// The same with them.
    pub residual_after: Residual,
    /// What happens between command and measured pressure, where the recordings have both: effects named there; empty when none is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pressure_path: Option<Vec<String>>,
    /// Strokes of the input in the recordings worked with.
    pub strokes: usize,
    /// How many of them are unlike all before.
    pub unlike_strokes: usize,
    /// Whether these are too few to tell what each of them has by chance from an effect.
    pub few_strokes: bool,
    /// Samples left out as outliers.
    pub excluded_samples: usize,
    /// Names of the test recordings.
    pub kept_out: Vec<String>,
    /// Names of those among them whose input goes beyond all that was worked with: there a model extrapolates.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub beyond_range: Vec<String>,
    /// Whether nothing is missing in what was worked with, and something is in what was kept out.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub errs_kept_out_only: bool,
    /// Names of those among them that were made about when the set-up changed, nobody knows on which side: no figure counts them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub side_unknown: Vec<String>,
}

impl Discovery {
    /// Figures one step ahead, where something jumps: before and after in output units, and the share of the gap closed.
    #[must_use]
    pub fn one_step(&self) -> Option<[f64; 3]> {
        Some([self.rmse_before_one_step?, self.rmse_after_one_step?, self.gap_closed_one_step?])
    }
}
