//! The rungs of [`crate::identify`]: play or stop operators with free thresholds, and the modified model whose sum is bent.

use std::path::Path;
use std::time::Instant;

use identification::SplitKind;
use identification::choice::Evidence;

use super::judging::Judging;
use super::ladder::{INSTRUCTIONS, LadderRung, RungModel};
use super::nuisance;
use crate::identify::{self, Choice, FitConfig};
use crate::model::{PhysicsPredictor, Predictor};
use crate::parallel::for_each;
use crate::physics::{Kind, PhysicsModel};

/// The names of the rungs, without and with dynamics.
pub(super) const NAMES: [&str; 4] = ["PI, free thresholds", "modified PI", "PI, free thresholds + dynamics", "modified PI + dynamics"];
/// Samples beyond which free thresholds are not searched: a grid is as good, and the search would take minutes.
const MOST_SAMPLES: usize = 200_000;

/// The two rungs, without dead time and lag or with those that each outer fold, and last all data, found for themselves (in s). Only whole recordings can be left out of these fits, so there
/// are none where the partition is one of blocks, and none for several inputs.
pub(super) fn rungs(judging: &Judging, dynamics: bool, paths: &[(f64, f64)], evidence: Evidence, threads: usize) -> Vec<LadderRung> {
    let (prepared, partition) = (judging.prepared, judging.partition);
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
    let one = |index: usize| rung(judging, names[index], whats[index], kinds[index], given, evidence, threads);
    (0..2).filter_map(one).collect()
}

fn rung(
    judging: &Judging,
    name: &str,
    what: &str,
    kind: Kind,
    paths: &[(f64, f64)],
    evidence: Evidence,
    threads: usize,
) -> Option<LadderRung> {
    let (prepared, partition) = (judging.prepared, judging.partition);
    let clock = Instant::now();
    let fit = |left_out: &[usize], (dead_time_s, lag_s): (f64, f64)| -> Option<PhysicsModel> {
        let config =
            FitConfig { kind, dead_time_s: Choice::Given(dead_time_s), lag_time_constant_s: Choice::Given(lag_s), ..FitConfig::default() };
        // These fits know of no nuisance.
        let some = nuisance::cleaned(prepared, partition, judging.search, left_out);
        identify::fit(&some, &config).ok().map(|fit| fit.model)
    };
    let outer = partition.outer();
    // The last is all data.
    let left_out = (0..partition.folds()).map(|fold| vec![fold]).chain([Vec::new()]);
    let jobs: Vec<(Vec<usize>, (f64, f64))> = left_out.zip(paths.iter().copied()).collect();
    let mut models = for_each(&jobs, threads, |(left_out, path)| Ok(fit(left_out, *path))).ok()?;
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
    let predictor = PhysicsPredictor::new(model.clone(), Path::new(name));
    let description = predictor.description();
    let on_chip = model.front_end().is_ok();
    Some(LadderRung {
        eligible: evidence == Evidence::Recordings,
        seconds: clock.elapsed().as_secs_f64(),
        on_chip,
        parameters: description.parameters,
        step_instructions: INSTRUCTIONS * description.macs_per_step,
        ..LadderRung::new(name, what, judging, predictions, RungModel::Physics(Box::new(model)))
    })
}
