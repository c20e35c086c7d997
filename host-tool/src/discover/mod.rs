//! Which physical effect does the simulation lack? From recordings to a verdict, a better model and the figures that show it.
//!
//! The baseline is a bank of play operators with weights that are not negative. Every effect of the [`catalogue`] is fitted on top of it,
//! its parameters by a grid and a simplex, the weights of everything linear inside (variable projection), on one half of the recordings;
//! the other half selects. Effects come in one at a time, are polished together and leave again when they stop paying. What is still
//! there in the end decides between `named` and `unknown`. Kept-out recordings only give the final figures.

mod alike;
mod bursts;
pub mod catalogue;
#[cfg(test)]
mod closed_form;
mod columns;
pub mod corpus;
mod descent;
mod diagnosis;
pub mod effects;
mod figures;
pub mod file;
mod find;
pub mod folder;
mod frozen;
mod grid;
pub mod horizon;
mod intervals;
mod jump_evidence;
mod jump_naming;
pub mod jumps;
mod late_steps;
mod least_squares;
mod line;
mod mask;
mod model;
mod noise;
mod operators;
mod pairs;
mod past;
mod paths;
pub mod physics;
pub mod plan;
mod rounds;
mod search;
mod session;
mod tip_jumps;
mod turning;
mod valve_jumps;
mod verdict;
pub mod whereabouts;
mod workspace;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use diagnosis::{Correlation, LoopArea, Residual, Share};
pub use model::{Model, Slot};
pub use past::Past;
pub use session::{Beginning, Role, Run, Session, SessionError};
pub use whereabouts::Disagreement;

use crate::model::{self as models, Predictor};
use crate::recording::{ExtraColumn, Recording};
use catalogue::Place;
use rounds::Bench;

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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The model explains the recordings down to the noise.
    None,
    /// The effects named explain the gap.
    Named,
    /// Two effects explain it equally well, or recordings that were kept out do not confirm the one that was found.
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

/// The result, with the keys of the command's contract.
#[derive(Clone, Debug, Serialize)]
pub struct Discovery {
    /// Verdict.
    pub verdict: Verdict,
    /// Effects, the largest first.
    pub effects: Vec<Effect>,
    /// Second best explanation.
    pub runner_up: Option<RunnerUp>,
    /// RMSE of the simulation without the effects on kept-out samples, free running, output units.
    pub rmse_before: f64,
    /// RMSE of the simulation with them on kept-out samples, free running, output units.
    pub rmse_after: f64,
    /// Noise, output units.
    pub noise_floor: f64,
    /// Share of the gap closed, `(before - after) / (before - floor)`, 0 to 1.
    pub gap_closed: f64,
    /// Where something jumps: RMSE of the smooth observer, which knows no jumps, on kept-out samples, one step ahead, output units.
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
    /// Samples left out as outliers.
    pub excluded_samples: usize,
    /// Names of the kept-out recordings.
    pub kept_out: Vec<String>,
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

/// A finished discovery: the result and what it was made of.
pub struct Finding {
    /// The result.
    pub discovery: Discovery,
    /// The recordings, normalised.
    pub session: Session,
    /// The model without effects.
    pub before: Model,
    /// The model with them.
    pub after: Model,
    /// The model with the second best effect instead, where there is one.
    pub second: Option<Model>,
    /// What the simulation without effects predicts for every run, normalised: the given model's word, or `before`'s.
    pub simulated: Vec<Vec<f64>>,
    /// What the simulation with them predicts for runs of recordings that the figures count, normalised.
    pub with_effects: Vec<Option<Vec<f64>>>,
}

/// Where to start from: a simulation model that somebody already has.
pub struct Start {
    /// Its predictions, one for each recording and then each kept one, in output units.
    pub predictions: Vec<Vec<f64>>,
    /// The file, when discovery wrote it: its effects are kept, and what is found comes on top.
    pub discovered: Option<file::DiscoveredModel>,
}

impl Start {
    /// Lets a model predict every recording; `discovered` is that model when discovery wrote it.
    ///
    /// # Errors
    /// When the model was not made for the recordings or cannot be run.
    pub fn new(
        model: &dyn Predictor,
        discovered: Option<file::DiscoveredModel>,
        recordings: &[Recording],
        kept: &[Recording],
    ) -> anyhow::Result<Self> {
        let mut predictions = Vec::new();
        for recording in recordings.iter().chain(kept) {
            predictions.push(models::predict(model, recording, models::Fit::default())?);
        }
        Ok(Self { predictions, discovered })
    }
}

/// Upper tail of the normal distribution.
fn tail(deviations: f64) -> f64 {
    // Complementary error function, Abramowitz and Stegun 7.1.26 (absolute error below 1.5e-7).
    let x = deviations.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let poly = t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let upper = 0.5 * poly * (-x * x).exp();
    if deviations >= 0.0 { upper } else { 1.0 - upper }
}

/// Finds what the model lacks in `recordings`; `kept` take no part in any choice (some of `recordings` are set apart when empty).
///
/// # Errors
/// When there is too little to learn from.
pub fn discover(recordings: &[Recording], kept: &[Recording], config: &DiscoverConfig) -> Result<Finding, SessionError> {
    discover_from(recordings, kept, None, config, &|_| {})
}

/// As [`discover`], from a given simulation model; `watch` hears of every stage as it begins.
///
/// # Errors
/// When there is too little to learn from.
pub fn discover_from(
    recordings: &[Recording],
    kept: &[Recording],
    start: Option<&Start>,
    config: &DiscoverConfig,
    watch: &dyn Fn(&str),
) -> Result<Finding, SessionError> {
    watch("baseline");
    let pressure_path = match measured_pressure(recordings) {
        Some(path) => Some(effects_of_the_pressure(&path, config)?),
        None => None,
    };
    let mut session = Session::new(recordings, kept)?;
    let mut before = prepare(&mut session);
    let given = start.map(|start| session.normalised(&start.predictions));
    let mut model = before.clone();
    if let Some(file) = start.and_then(|start| start.discovered.as_ref()) {
        model.slots = file.slots_in(&session).map_err(|problem| SessionError::Model { problem })?;
    }
    let owned = model.slots.len();
    let search = find::effects(&session, model, pressure_path.as_deref(), config, watch);
    watch("figures");
    let mut after = search.model;
    // Fast motion that the first model lacked may have looked wrong: only what the last model finds wrong too is an outlier.
    for run in &mut session.runs {
        run.keep.fill(true);
    }
    let residual = after.residuals(&session);
    let kind = if search.found.jump_scatter.is_some() { mask::Residual::OfJumps } else { mask::Residual::OfModel };
    mask::outliers(&mut session, &residual, kind);
    after.fit_all(&session);
    after.anchor(&session);
    before.fit_all(&session);
    let loop_area = diagnosis::loop_area(&session, &before, config.threads);
    before = before.refined();
    before.fit_all(&session);
    before = before.pruned();
    let simulated = given.unwrap_or_else(|| before.outputs(&session, |_| true));
    let residual_before: Vec<Vec<f64>> = session
        .runs
        .iter()
        .zip(&simulated)
        .map(|(run, simulated)| run.output.iter().zip(simulated).map(|(y, p)| y - p).collect())
        .collect();
    let mut found = search.found;
    let mut discovery = verdict::judge(&session, &residual_before, &after, &found, owned);
    // What makes recordings worse that it has not seen is no part of an explanation.
    while discovery.verdict == Verdict::Unknown && discovery.rmse_after > discovery.rmse_before {
        let Some(fewer) = verdict::without_the_least(&session, &before, &after, &mut found) else { break };
        after = fewer;
        discovery = verdict::judge(&session, &residual_before, &after, &found, owned);
    }
    let written = |model: &Model| file::DiscoveredModel::bare(model, &session, &recordings[0]);
    let with_effects = written(&after);
    discovery.calibrate_s = with_effects.calibrate_s;
    let calibrate_s = discovery.calibrate_s.unwrap_or(0.0);
    let counted = figures::Counted::new(&session, &after, recordings, kept, config.threads);
    let was = match start {
        Some(start) => counted.given(&start.predictions, calibrate_s),
        None => counted.simulate(written(&before), calibrate_s)?,
    };
    let is = counted.simulate(with_effects, calibrate_s)?;
    verdict::confirm(&mut discovery, was.rmse, is.rmse, verdict::one_step(&session, &after, config.threads));
    let with_effects = session.normalised_where(&is.outputs);
    discovery.disagreements = whereabouts::disagreements(&session, &residual_before, config.seed);
    discovery.summary = whereabouts::sentence(&discovery.disagreements, discovery.rmse_before, discovery.noise_floor, &session.output_unit);
    discovery.loop_area = loop_area;
    discovery.memory_horizon = horizon::horizon(&session);
    discovery.residual_before = diagnosis::examine(&session, &residual_before);
    discovery.residual_after = diagnosis::examine(&session, &after.residuals(&session));
    discovery.pressure_path = pressure_path;
    let second = search.second.filter(|_| discovery.runner_up.is_some()).map(|mut second| {
        second.fit_all(&session);
        second.anchor(&session);
        second
    });
    Ok(Finding { discovery, session, before, after, second, simulated, with_effects })
}

/// Masks outliers and fits the baseline, twice: the first fit is pulled about by what it is to find.
fn prepare(session: &mut Session) -> Model {
    let zero: Vec<Vec<f64>> = session.runs.iter().map(|run| run.output.clone()).collect();
    mask::outliers(session, &zero, mask::Residual::Output);
    let mut before = baseline(session);
    for _ in 0..2 {
        let residual = before.residuals(session);
        mask::outliers(session, &residual, mask::Residual::OfModel);
        before.fit(session, model::Scope::Fit);
    }
    before.fit(session, model::Scope::Both);
    before
}

/// The recordings with the measured pressure as their output, when all have one.
fn measured_pressure(recordings: &[Recording]) -> Option<Vec<Recording>> {
    let column = |recording: &Recording| -> Option<ExtraColumn> {
        recording.extra.iter().find(|column| column.name == "pressure_measured_bar").cloned()
    };
    recordings.iter().map(|recording| column(recording).map(|column| Recording { output: column.values, ..recording.clone() })).collect()
}

/// Names of what happens between command and measured pressure: valve, supply and tube.
fn effects_of_the_pressure(recordings: &[Recording], config: &DiscoverConfig) -> Result<Vec<String>, SessionError> {
    let mut session = Session::new(recordings, &[])?;
    let before = prepare(&mut session);
    let mut forms = catalogue::forms();
    forms.retain(|form| form.place() <= Place::Tube);
    let bench = Bench { session: &session, forms, threads: config.threads };
    let found = find::find(&bench, before, 1, &|_| {});
    Ok(found.found.order.into_iter().map(str::to_owned).collect())
}

/// The baseline that fits best: operators that begin fresh in every recording, or ones that remember.
fn baseline(session: &Session) -> Model {
    let mut fresh = Model::baseline(Past::Fresh, false);
    let mut stops = Model::baseline(Past::Fresh, true);
    let (fresh_square, _) = fresh.fit(session, model::Scope::Fit);
    let (stops_square, _) = stops.fit(session, model::Scope::Fit);
    if stops_square < 0.5 * fresh_square {
        return stops;
    }
    fresh.with_best_past(session).model
}

/// Correlation of neighbouring residuals.
fn neighbour_correlation(session: &Session, residual: &[Vec<f64>]) -> f64 {
    let (mut square, mut product) = (1e-30, 0.0);
    for (run, residual) in session.runs.iter().zip(residual) {
        for (pair, keep) in residual.windows(2).zip(run.keep.windows(2)) {
            if keep[0] && keep[1] {
                square += pair[0] * pair[0];
                product += pair[0] * pair[1];
            }
        }
    }
    (product / square).clamp(0.0, 0.98)
}

#[cfg(test)]
mod tests;
