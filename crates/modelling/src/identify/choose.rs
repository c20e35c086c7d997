//! Which of the kinds of physics model suits recordings, by the error on what took no part in the fit.
//!
//! Whole recordings are left out in folds. One or two recordings cannot be: there the model is fitted to the first part of each and judged on
//! the rest, through which it runs on with the memory it has. The simplest kind that is as good as the best is taken.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use identification::choice::{self, Entry};
use identification::{Partition, Series, SplitKind, interval};

use super::config::{Choice, FitConfig, IdentifyError};
use super::fit::fit;
use crate::model::{PhysicsPredictor, Predictor as _};
use crate::parallel::for_each;
use crate::physics::{Kind, PhysicsModel};
use recording::Recording;

/// Share of each recording that is fitted where whole ones cannot be left out.
const FITTED: f64 = 0.6;
/// Samples beyond which one fit of all recordings takes long enough.
const MOST_SAMPLES: usize = 300_000;
/// Errors below this share of the output's range are equal: nobody can use the difference.
const EQUAL: f64 = 1e-6;

/// One kind, judged.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Judged {
    /// What it is, in words.
    pub name: String,
    /// Mean error on what took no part, in the output's unit.
    pub cv_rmse: f64,
    /// Central 95 % prediction interval for the error on the next recording.
    pub cv_interval: [f64; 2],
    /// Its settings.
    #[serde(skip)]
    pub config: FitConfig,
}

/// The kinds that are tried when the user names none: settings of `base` that are not a kind, a dead time or a lag stay.
#[must_use]
pub fn kinds(base: &FitConfig) -> Vec<(String, FitConfig)> {
    let with = |kind, choice| FitConfig { kind, dead_time_s: choice, lag_time_constant_s: choice, ..base.clone() };
    [
        ("Prandtl-Ishlinskii", Kind::PrandtlIshlinskii, Choice::Given(0.0)),
        ("modified Prandtl-Ishlinskii", Kind::ModifiedPrandtlIshlinskii, Choice::Given(0.0)),
        ("Prandtl-Ishlinskii behind dead time and lag", Kind::PrandtlIshlinskii, Choice::Auto),
        ("modified Prandtl-Ishlinskii behind dead time and lag", Kind::ModifiedPrandtlIshlinskii, Choice::Auto),
    ]
    .map(|(name, kind, choice)| (name.to_owned(), with(kind, choice)))
    .to_vec()
}

/// Judges candidates; returns them in order, and the index of the one to take. Empty for more samples than can be fitted several times.
/// `told` hears how many fits are done, and of how many.
///
/// # Errors
/// When the recordings do not go together or a candidate cannot be fitted to all of them.
pub fn judge(
    recordings: &[Recording],
    candidates: &[(String, FitConfig)],
    threads: usize,
    told: &(dyn Fn(usize, usize) + Sync),
) -> Result<(Vec<Judged>, usize), IdentifyError> {
    let samples: usize = recordings.iter().map(Recording::len).sum();
    if samples > MOST_SAMPLES {
        return Ok((Vec::new(), 0));
    }
    // What is wrong with the data is said by a fit of all of them.
    for (_, config) in candidates.first().into_iter().chain(candidates.last()) {
        fit(recordings, config)?;
    }
    let series: Vec<Series> = recordings.iter().map(series).collect();
    let partition = Partition::new(&series);
    let blocks = partition.kind() == SplitKind::Blocks;
    let jobs: Vec<(usize, usize)> =
        (0..candidates.len()).flat_map(|candidate| (0..folds(&partition)).map(move |fold| (candidate, fold))).collect();
    let done = AtomicUsize::new(0);
    told(0, jobs.len());
    let one = |&(candidate, fold): &(usize, usize)| {
        let found = errors(recordings, &partition, fold, &candidates[candidate].1);
        told(done.fetch_add(1, Ordering::Relaxed) + 1, jobs.len());
        Ok(found)
    };
    let found = for_each(&jobs, threads, one).unwrap_or_default();
    let independent = (!blocks).then(|| partition.folds());
    let mut judged = Vec::new();
    let mut entries = Vec::new();
    for (candidate, (name, config)) in candidates.iter().enumerate() {
        let own: Vec<f64> = jobs.iter().zip(&found).filter(|(job, _)| job.0 == candidate).flat_map(|(_, errors)| errors.clone()).collect();
        let cv_rmse = own.iter().sum::<f64>() / own.len().max(1) as f64;
        judged.push(Judged { name: name.clone(), cv_rmse, cv_interval: interval::next(&own, independent), config: config.clone() });
        entries.push(Entry { name: name.clone(), errors: own, predictions: Vec::new(), eligible: true });
    }
    let (low, high) =
        recordings.iter().flat_map(|one| &one.output).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &y| (low.min(y), high.max(y)));
    // Too short to fit a part of them: nothing is known, and nothing is promised.
    if judged.iter().all(|kind| !kind.cv_rmse.is_finite()) {
        return Ok((Vec::new(), 0));
    }
    let chosen = choice::simplest(&entries, EQUAL * (high - low)).unwrap_or(0);
    Ok((judged, chosen))
}

fn folds(partition: &Partition) -> usize {
    if partition.kind() == SplitKind::Blocks { 1 } else { partition.folds() }
}

/// Errors of one fold, one for each recording in it; not a number where the rest cannot be fitted.
fn errors(recordings: &[Recording], partition: &Partition, fold: usize, config: &FitConfig) -> Vec<f64> {
    // As `evaluate` does it: behind a gap the model starts afresh, and what is skipped does not count.
    let rmse = |model: &PhysicsModel, recording: &Recording, from: usize| {
        let predictor = PhysicsPredictor::new(model.clone(), Path::new("identify"));
        let Ok(simulated) = predictor.predict(&recording.input, &recording.gaps) else { return f64::NAN };
        let begin_s = recording.time_s[0] + config.skip_s;
        let from = from.max(recording.time_s.partition_point(|&time_s| time_s < begin_s)).min(recording.len());
        let squares: f64 = simulated[from..].iter().zip(&recording.output[from..]).map(|(one, other)| (one - other).powi(2)).sum();
        (squares / (recording.len() - from).max(1) as f64).sqrt()
    };
    if partition.kind() == SplitKind::Blocks {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a length")]
        let cut = |recording: &Recording| (FITTED * recording.len() as f64) as usize;
        let heads: Vec<Recording> = recordings.iter().filter_map(|recording| recording.until(cut(recording))).collect();
        return match fit(&heads, config) {
            Ok(fit) => recordings.iter().map(|recording| rmse(&fit.model, recording, cut(recording))).collect(),
            Err(_) => vec![f64::NAN; recordings.len()],
        };
    }
    let outer = &partition.outer()[fold];
    let some: Vec<Recording> = outer.training.all.units().iter().map(|&unit| recordings[partition.units()[unit].series].clone()).collect();
    let tested = outer.test.units().iter().map(|&unit| &recordings[partition.units()[unit].series]);
    match fit(&some, config) {
        Ok(fit) => tested.map(|recording| rmse(&fit.model, recording, 0)).collect(),
        Err(_) => tested.map(|_| f64::NAN).collect(),
    }
}

fn series(recording: &Recording) -> Series {
    Series {
        name: String::new(),
        group: recording.group.clone(),
        inputs: vec![recording.input.clone()],
        output: recording.output.clone(),
        gaps: recording.gaps.clone(),
        skip: 0,
    }
}
