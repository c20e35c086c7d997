//! The rungs of [`crate::identify`]: play or stop operators with free thresholds, and the modified model whose sum is bent.

use std::path::Path;
use std::time::Instant;

use identification::choice::Evidence;
use identification::search::errors;
use identification::{Partition, SplitKind};

use super::prepare::Prepared;
use super::{LadderRung, RungModel, mean};
use crate::evaluate::for_each;
use crate::identify::{self, Choice, FitConfig, Kind, PhysicsModel};
use crate::model::{PhysicsPredictor, Predictor};
use crate::recording::Recording;

/// The names of the rungs, without and with dynamics.
pub(super) const NAMES: [&str; 4] = ["PI, free thresholds", "modified PI", "PI, free thresholds + dynamics", "modified PI + dynamics"];
/// Samples beyond which free thresholds are not searched: a grid is as good, and the search would take minutes.
const MOST_SAMPLES: usize = 200_000;

/// The two rungs, without dead time and lag or with those that each outer fold, and last all data, found for themselves (in s). Only whole recordings can be left out of these fits, so there
/// are none where the partition is one of blocks, and none for several inputs.
pub(super) fn rungs(
    prepared: &Prepared,
    partition: &Partition,
    dynamics: bool,
    paths: &[(f64, f64)],
    evidence: Evidence,
    threads: usize,
    next: impl Fn(&[f64]) -> [f64; 2],
) -> Vec<LadderRung> {
    let samples: usize = prepared.series.iter().map(identification::Series::len).sum();
    let delayed = paths.iter().any(|path| path.0 > 0.0 || path.1 > 0.0);
    if partition.kind() == SplitKind::Blocks || prepared.inputs.len() > 1 || samples > MOST_SAMPLES || (dynamics && !delayed) {
        return Vec::new();
    }
    let names = if dynamics { &NAMES[2..] } else { &NAMES[..2] };
    let kinds = [Kind::PrandtlIshlinskii, Kind::ModifiedPrandtlIshlinskii];
    let whats = ["operators whose thresholds are found too", "the sum of the operators bent by a monotone curve"];
    let none = vec![(0.0, 0.0); paths.len()];
    let given = if dynamics { paths } else { &none };
    let one = |index: usize| rung(prepared, partition, names[index], whats[index], kinds[index], given, evidence, threads, &next);
    (0..2).filter_map(one).collect()
}

#[expect(clippy::too_many_arguments, reason = "what a rung is and what it is judged on")]
fn rung(
    prepared: &Prepared,
    partition: &Partition,
    name: &str,
    what: &str,
    kind: Kind,
    paths: &[(f64, f64)],
    evidence: Evidence,
    threads: usize,
    next: &impl Fn(&[f64]) -> [f64; 2],
) -> Option<LadderRung> {
    let clock = Instant::now();
    let fit = |units: &[usize], (dead_time_s, lag_s): (f64, f64)| -> Option<PhysicsModel> {
        let config =
            FitConfig { kind, dead_time_s: Choice::Given(dead_time_s), lag_time_constant_s: Choice::Given(lag_s), ..FitConfig::default() };
        let some: Vec<Recording> = units.iter().map(|&unit| prepared.recordings[partition.units()[unit].series].clone()).collect();
        identify::fit(&some, &config).ok().map(|fit| fit.model)
    };
    let outer = partition.outer();
    // The last is all data.
    let units = outer.iter().map(|fold| fold.training.all.units().to_vec()).chain([partition.training().all.units().to_vec()]);
    let jobs: Vec<(Vec<usize>, (f64, f64))> = units.zip(paths.iter().copied()).collect();
    let mut models = for_each(&jobs, threads, |(units, path)| Ok(fit(units, *path))).ok()?;
    let model = models.pop()??;
    let mut predictions: Vec<Vec<f64>> = prepared.series.iter().map(|one| vec![f64::NAN; one.len()]).collect();
    for (fold, model) in outer.iter().zip(models) {
        let predictor = PhysicsPredictor::new(model?, Path::new(name));
        for &unit in fold.test.units() {
            let series = partition.units()[unit].series;
            let one = &prepared.series[series];
            predictions[series] = predictor.predict(&one.inputs[0], &one.gaps).ok()?;
        }
    }
    let errors = errors(&predictions, &prepared.series, partition);
    let predictor = PhysicsPredictor::new(model.clone(), Path::new(name));
    let description = predictor.description();
    let zero = |unit: &identification::Unit| {
        let one = &prepared.series[unit.series];
        let predicted = predictor.predict(&one.inputs[0], &one.gaps).unwrap_or_default();
        let differences: Vec<f64> = one.output.iter().zip(&predicted).map(|(measured, predicted)| measured - predicted).collect();
        model.constant + mean(&differences)
    };
    Some(LadderRung {
        name: name.to_owned(),
        what: what.to_owned(),
        cv_rmse: mean(&errors),
        cv_interval: next(&errors),
        parameters: description.parameters,
        step_instructions: super::INSTRUCTIONS * description.macs_per_step,
        on_chip: model.front_end().is_ok(),
        eligible: evidence == Evidence::Recordings,
        seconds: clock.elapsed().as_secs_f64(),
        zeros: partition.units().iter().map(zero).collect(),
        errors,
        predictions,
        model: RungModel::Physics(Box::new(model)),
    })
}
