//! `catheter fit`: recordings in, the model out that will be best on the next recording, with the error to expect there.
//!
//! Terms. A *rung* is a kind of model; the *ladder* is all of them, simplest first. Its errors are those of nested cross-validation: each
//! recording is predicted, free running, by a model whose weights and settings it took no part in. [`choice`] ships the simplest rung
//! that is as good as the best.
//!
//! Data flow: [`prepare`] puts recordings onto one even clock; the physics rungs of [`identification`] and those of
//! [`crate::identify`] are searched and judged; [`networks`] are trained where physics leaves more than the rig itself repeats;
//! [`chip`] turns what the microcontroller can hold into its own format; [`mod@file`] is where the rest is kept, and [`folder`] all of it.

pub mod chip;
pub mod file;
pub mod folder;
pub mod judging;
pub mod networks;
pub mod nuisance;
mod operators;
pub mod prepare;

use std::path::Path;
use std::time::Instant;

use anyhow::{Result, ensure};
use identification::choice::{self, Entry, Evidence};
use identification::search::{RungResult, Search};
use identification::{LinearModel, Nuisances, Partition, Series, SplitKind, physics_rungs};
use serde::Serialize;

use crate::identify::PhysicsModel;
use crate::model::{NetworkModel, PhysicsPredictor, Predictor as _};
use crate::network::TrainedModel;
use file::{Expected, FittedModel, Member};
use judging::{Calibrated, Judging};
use nuisance::Nuisance;
use prepare::Prepared;
use recording::Recording;
use recording::repeatability::{self, Repeatability};

/// How to fit.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Seed of every random choice.
    pub seed: u64,
    /// Worker threads.
    pub threads: usize,
    /// CPU time of the training of one shipped network in s; cross-validation trains with half of it. `None`: no networks.
    pub network_budget_cpu_s: Option<f64>,
    /// Seconds at the start of each recording that the error with calibration takes to set the zero; `None`: about a tenth of the shortest
    /// recording, and the result states it.
    pub calibrate_s: Option<f64>,
}

/// What is reported while it goes.
#[derive(Clone, Debug)]
pub enum Progress {
    /// A model that can be used already.
    First(Box<FittedModel>),
    /// So many of so many outer folds of the physics rungs are done.
    Physics {
        /// Done.
        done: usize,
        /// In all.
        of: usize,
    },
    /// A training begins: number, trainings in all, and what is trained.
    Network {
        /// Number, from 1.
        number: usize,
        /// In all.
        of: usize,
        /// Which.
        name: &'static str,
    },
    /// Share of the processor time of all trainings that is behind.
    Trained(f64),
    /// Why no network is trained, or what else a person should know.
    Note(String),
}

/// A model of any rung.
#[derive(Clone, Debug)]
pub enum RungModel {
    /// A weighted sum of columns.
    Linear(LinearModel),
    /// The weighted mean of other rungs, by index and share.
    Average(Vec<(usize, f64)>),
    /// An identified physics model.
    Physics(Box<PhysicsModel>),
    /// A trained network.
    Network(Box<TrainedModel>),
}

/// One rung of the finished ladder.
#[derive(Clone, Debug, Serialize)]
pub struct LadderRung {
    /// Short name.
    pub name: String,
    /// What it is, in words.
    pub what: String,
    /// Mean error on recordings that took no part, in the output's unit.
    pub cv_rmse: f64,
    /// Central 95 % prediction interval for the error on the next recording.
    pub cv_interval: [f64; 2],
    /// The same with the zero set at the start of the recording; absent for blocks.
    pub calibrated: Option<Calibrated>,
    /// Mean error with each recording's own nuisances taken off: what rungs are compared by, and no promise.
    pub shape_rmse: f64,
    /// Numbers that were fitted.
    pub parameters: usize,
    /// Instructions of one step on the Cortex-M4F, about.
    pub step_instructions: usize,
    /// Whether the microcontroller's blob can hold it.
    pub on_chip: bool,
    /// Whether these data may choose it.
    pub eligible: bool,
    /// Wall time in s; that of all physics rungs is shared among them.
    pub seconds: f64,
    /// Error on each unit left out, as it is.
    pub errors: Vec<f64>,
    /// The same with the unit's own nuisances taken off.
    pub shape_errors: Vec<f64>,
    /// The model fitted to all data.
    #[serde(skip)]
    pub model: RungModel,
    /// Predictions by models that took no part, one list an even recording.
    #[serde(skip)]
    pub predictions: Vec<Vec<f64>>,
    /// The nuisances that the data name, as this model sees them.
    #[serde(skip)]
    pub nuisances: Vec<Nuisance>,
}

/// How recordings were left out.
#[derive(Clone, Debug, Serialize)]
pub struct Splits {
    /// What was left out at a time.
    pub kind: SplitKind,
    /// Outer folds.
    pub folds: usize,
    /// Recordings or blocks.
    pub units: usize,
    /// What the data can decide.
    pub evidence: Evidence,
    /// The same in words.
    pub what: String,
    /// Fold of each unit, by the recording's name.
    pub members: Vec<(String, usize)>,
}

/// A finished ladder.
pub struct Outcome {
    /// The data as they were fitted.
    pub prepared: Prepared,
    /// Simplest first.
    pub ladder: Vec<LadderRung>,
    /// Index of the rung to ship.
    pub chosen: usize,
    /// What the rig repeats.
    pub repeatability: Repeatability,
    /// Seconds at the start of each recording that the errors with calibration take.
    pub calibrate_s: f64,
    /// How recordings were left out.
    pub splits: Splits,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// Networks are not trained where physics is within this factor of what the rig repeats.
const AT_REPEATABILITY: f64 = 1.1;
/// Errors below this share of the output's range are equal.
const EQUAL: f64 = 1e-6;
/// Instructions of one multiplication of a sum of columns, with its loads and its share of the comparisons: counted by hand from the
/// Cortex-M4F's instruction set, for models that have no blob to measure.
const INSTRUCTIONS: usize = 7;

/// Fits the ladder.
///
/// # Errors
/// When the recordings do not go together or carry nothing to fit.
pub fn fit(recordings: &[Recording], settings: &Settings, tell: &(dyn Fn(Progress) + Sync)) -> Result<Outcome> {
    let prepared = prepare::prepare(recordings)?;
    let repeatability = repeatability::estimate(&prepared.recordings);
    let series = &prepared.series;
    let partition = Partition::new(series);
    let evidence = Evidence::of(&partition, prepared.duration_s);
    let search = Search::new(series, &partition, prepared.period_s, settings.seed).with_covariates(prepared.covariates.clone());
    let calibrate_s = settings.calibrate_s.unwrap_or_else(|| judging::calibration_s(&prepared));
    let judging = Judging { prepared: &prepared, partition: &partition, search: &search, calibrate_s };
    let rungs = physics_rungs();
    let splits = splits(&prepared, &partition, evidence);

    // The first two rungs give an answer within seconds.
    let training = partition.training();
    let quick = search.ladder(&rungs[..2], &training);
    let quick = quick.iter().flatten().min_by(|a, b| a.score.total_cmp(&b.score)).cloned();
    if let Some(found) = quick
        && let Some(model) = search.model(&found, &training.all)
    {
        let expected = Expected {
            rmse: found.score,
            interval: judging.next(&[found.score]),
            left_out: "a first look: inner folds only".to_owned(),
            calibrated: None,
        };
        let member = Member { name: "first look".to_owned(), share: 1.0, model: model.pruned() };
        tell(Progress::First(Box::new(fitted(&prepared, "first look", vec![member], expected, Vec::new()))));
    }

    let clock = Instant::now();
    let results = search.nested(&rungs, settings.threads, &|done, of| tell(Progress::Physics { done, of }));
    ensure!(!results.is_empty(), "no model can be fitted to these recordings: does the input move, and the output with it?");
    let each_s = clock.elapsed().as_secs_f64() / results.len() as f64;
    let mut ladder: Vec<LadderRung> = Vec::new();
    for result in results {
        let eligible = rungs.iter().find(|rung| rung.name == result.name).is_some_and(|rung| evidence.admits(rung));
        let paths = result.paths.clone();
        let name = result.name;
        ladder.push(linear(result, eligible, each_s, &judging));
        // Operators with free thresholds stand beside those on a grid, and share the dead time and lag found with them.
        if name == "PI" || name == "PI + dynamics" {
            ladder.extend(operators::rungs(&judging, name == "PI + dynamics", &paths, evidence, settings.threads));
        }
    }
    let mut notes = prepared.notes.clone();
    notes.iter().for_each(|note| tell(Progress::Note(note.clone())));
    let named = search.nuisances(&training);
    // Rungs are compared beside the nuisances, and so is what the rig repeats.
    let beside = match named.is_empty() {
        true => repeatability.clone(),
        false => repeatability::estimate(&nuisance::cleaned(&prepared, &partition, &search, &[])),
    };
    networks::add(&mut ladder, &judging, &beside, settings, tell, &mut notes)?;
    add_average(&mut ladder, &judging);
    add_nuisances(&mut ladder, &judging, &named);
    let best = ladder.iter().filter(|rung| rung.eligible).map(|rung| rung.shape_rmse).fold(f64::INFINITY, f64::min);
    // What the rig does not repeat no model can know; an estimate above what models reach is wrong.
    let floor = beside.repeatability.filter(|&repeats| repeats <= AT_REPEATABILITY * best).unwrap_or(0.0);
    // Below a millionth of the range nobody can use the difference.
    let floor = floor.max(EQUAL * (prepared.output.maximum - prepared.output.minimum));
    let entries: Vec<Entry> = ladder.iter().map(entry).collect();
    let chosen = choice::simplest(&entries, floor);
    let Some(chosen) = chosen else { anyhow::bail!("no rung of the ladder predicts these recordings at all; look at `catheter check`") };
    for nuisance in &ladder[chosen].nuisances {
        let note = nuisance.sentence();
        tell(Progress::Note(note.clone()));
        notes.push(note);
    }
    drop(search);
    Ok(Outcome { prepared, ladder, chosen, repeatability, calibrate_s, splits, notes })
}

/// A rung as the choice sees it.
fn entry(rung: &LadderRung) -> Entry {
    Entry { name: rung.name.clone(), errors: rung.shape_errors.clone(), predictions: rung.predictions.clone(), eligible: rung.eligible }
}

fn linear(result: RungResult, eligible: bool, seconds: f64, judging: &Judging) -> LadderRung {
    LadderRung {
        parameters: result.model.parameters(),
        step_instructions: INSTRUCTIONS * result.model.multiplications(),
        on_chip: chip::physics(&result.model, judging.prepared).is_some(),
        eligible,
        seconds,
        ..LadderRung::new(result.name, result.what, judging, result.predictions, RungModel::Linear(result.model))
    }
}

impl LadderRung {
    /// A rung with the errors of its left-out predictions, for the rest to be filled in.
    fn new(name: &str, what: &str, judging: &Judging, predictions: Vec<Vec<f64>>, model: RungModel) -> Self {
        let verdict = judging.of(&predictions);
        Self {
            name: name.to_owned(),
            what: what.to_owned(),
            cv_rmse: verdict.cv_rmse,
            cv_interval: verdict.cv_interval,
            calibrated: verdict.calibrated,
            shape_rmse: mean(&verdict.shape_errors),
            parameters: 0,
            step_instructions: 0,
            on_chip: false,
            eligible: true,
            seconds: 0.0,
            errors: verdict.errors,
            shape_errors: verdict.shape_errors,
            model,
            predictions,
            nuisances: Vec::new(),
        }
    }
}

/// Adds the mean of the sums that are nearly as good as the best of them.
fn add_average(ladder: &mut Vec<LadderRung>, judging: &Judging) {
    let sums: Vec<usize> = (0..ladder.len()).filter(|&index| matches!(ladder[index].model, RungModel::Linear(_))).collect();
    let entries: Vec<Entry> = sums.iter().map(|&index| entry(&ladder[index])).collect();
    let Some(average) = choice::average(&entries, judging.partition, |unit, predictions| judging.search.shape_residuals(unit, predictions))
    else {
        return;
    };
    let members: Vec<(usize, f64)> = average.members.into_iter().map(|(member, share)| (sums[member], share)).collect();
    let total = |of: fn(&LadderRung) -> usize| members.iter().map(|&(member, _)| of(&ladder[member])).sum();
    let names: Vec<String> = members.iter().map(|&(member, share)| format!("{:.0} % {}", 100.0 * share, ladder[member].name)).collect();
    let what = format!("the weighted mean of {}", names.join(", "));
    ladder.push(LadderRung {
        parameters: total(|rung| rung.parameters),
        step_instructions: total(|rung| rung.step_instructions),
        ..LadderRung::new("average", &what, judging, average.entry.predictions, RungModel::Average(members))
    });
}

/// Lists the nuisances that the data name, as each model sees them.
fn add_nuisances(ladder: &mut [LadderRung], judging: &Judging, named: &Nuisances) {
    if named.is_empty() {
        return;
    }
    for index in 0..ladder.len() {
        let predicted: Option<Vec<Vec<f64>>> = judging.prepared.series.iter().map(|one| simulated(ladder, index, one)).collect();
        let Some(predicted) = predicted else { continue };
        let mean_zero = constant(ladder, index);
        ladder[index].nuisances = nuisance::list(judging.prepared, judging.search, named, &predicted, mean_zero);
    }
}

/// What a rung's model makes of a recording.
fn simulated(ladder: &[LadderRung], rung: usize, series: &Series) -> Option<Vec<f64>> {
    let inputs: Vec<&[f64]> = series.inputs.iter().map(Vec::as_slice).collect();
    match &ladder[rung].model {
        RungModel::Linear(model) => Some(model.simulate(&inputs, &series.gaps)),
        RungModel::Average(members) => {
            let mut sum = vec![0.0; series.len()];
            for &(member, share) in members {
                sum.iter_mut().zip(simulated(ladder, member, series)?).for_each(|(sum, value)| *sum += share * value);
            }
            Some(sum)
        }
        RungModel::Physics(model) => PhysicsPredictor::new((**model).clone(), Path::new("model")).simulate(&inputs, &series.gaps).ok(),
        RungModel::Network(model) => NetworkModel::new((**model).clone(), Path::new("model")).ok()?.simulate(&inputs, &series.gaps).ok(),
    }
}

/// The constant of a rung's model, which is the mean zero.
fn constant(ladder: &[LadderRung], rung: usize) -> f64 {
    match &ladder[rung].model {
        RungModel::Linear(model) => model.constant,
        RungModel::Average(members) => members.iter().map(|&(member, share)| share * constant(ladder, member)).sum(),
        RungModel::Physics(model) => model.constant,
        // A network has no constant of its own: what it makes of an input at rest is its zero.
        RungModel::Network(_) => 0.0,
    }
}

fn splits(prepared: &Prepared, partition: &Partition, evidence: Evidence) -> Splits {
    let count = partition.folds();
    let what = match partition.kind() {
        SplitKind::Groups => format!("{count} folds of whole groups of recordings"),
        SplitKind::Recordings => format!("{count} folds of whole recordings"),
        SplitKind::Blocks => {
            format!(
                "{count} blocks of {} recording(s), because whole ones are too few: another recording may be worse",
                prepared.series.len()
            )
        }
    };
    let members = partition.units().iter().enumerate();
    let members = members.map(|(index, unit)| (prepared.series[unit.series].name.clone(), partition.fold_of(index))).collect();
    Splits { kind: partition.kind(), folds: count, units: partition.units().len(), evidence, what, members }
}

impl Outcome {
    /// The model file of a rung that is a sum of columns or a mean of such; `None` for the others, which have formats of their own.
    #[must_use]
    pub fn fitted(&self, index: usize) -> Option<FittedModel> {
        let rung = &self.ladder[index];
        let member = |rung: &LadderRung, share: f64| match &rung.model {
            RungModel::Linear(model) => Some(Member { name: rung.name.clone(), share, model: model.clone() }),
            _ => None,
        };
        let members: Vec<Member> = match &rung.model {
            RungModel::Average(members) => members.iter().map(|&(one, share)| member(&self.ladder[one], share)).collect::<Option<_>>()?,
            _ => vec![member(rung, 1.0)?],
        };
        Some(fitted(&self.prepared, &rung.name, members, self.expected(index), rung.nuisances.clone()))
    }

    /// What a rung promises for the next recording.
    #[must_use]
    pub fn expected(&self, rung: usize) -> Expected {
        let rung = &self.ladder[rung];
        Expected { rmse: rung.cv_rmse, interval: rung.cv_interval, left_out: self.splits.what.clone(), calibrated: rung.calibrated.clone() }
    }
}

/// A model file.
fn fitted(prepared: &Prepared, name: &str, members: Vec<Member>, expected: Expected, nuisances: Vec<Nuisance>) -> FittedModel {
    FittedModel {
        kind: file::KIND.to_owned(),
        format_version: file::FORMAT_VERSION,
        name: name.to_owned(),
        program: format!("catheter {}", env!("CARGO_PKG_VERSION")),
        sample_period_s: prepared.period_s,
        inputs: prepared.inputs.clone(),
        output: prepared.output.clone(),
        expected,
        data: prepared.sources.clone(),
        nuisances,
        members,
    }
}

/// The names of all rungs that a ladder may have.
fn rung_names() -> Vec<&'static str> {
    let sums = physics_rungs().into_iter().map(|rung| rung.name);
    sums.chain(operators::NAMES).chain(networks::RUNGS.map(|(name, ..)| name)).chain(["average"]).collect()
}

pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

#[cfg(test)]
mod tests;
