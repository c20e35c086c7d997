//! The ladder climbed: physics searched and judged, networks trained where they may pay, one rung chosen.

use std::path::Path;
use std::time::Instant;

use anyhow::{Result, ensure};
use identification::choice::{self, Entry, Evidence};
use identification::search::{RungResult, Search};
use identification::{Nuisances, Partition, Series, SplitKind, physics_rungs};

use super::judging::{self, Judging};
use super::ladder::{AT_REPEATABILITY, INSTRUCTIONS, LadderRung, Outcome, Progress, RungModel, Settings, Splits, fitted};
use super::prepare::{self, Prepared};
use super::{networks, nuisance, operators};
use crate::model::{NetworkModel, PhysicsPredictor, Predictor as _};
use crate::physics::Expected;
use crate::physics::fitted::Member;
use recording::{Recording, repeatability};

/// Errors below this share of the output's range are equal.
const EQUAL: f64 = 1e-6;

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
        on_chip: judging.prepared.on_chip(&result.model).is_some(),
        eligible,
        seconds,
        ..LadderRung::new(result.name, result.what, judging, result.predictions, RungModel::Linear(result.model))
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
