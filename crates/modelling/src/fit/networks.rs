//! The network rungs: a hybrid of physics and LSTM, and an LSTM alone, judged on recordings that took no part in their training.

use std::path::Path;
use std::time::Instant;

use anyhow::Result;
use identification::SplitKind;
use model_export::schema::MAX_INPUTS;

use super::judging::Judging;
use super::ladder::{AT_REPEATABILITY, LadderRung, Progress, RungModel, Settings};
use super::nuisance;
use crate::model::{NetworkModel, Predictor};
use crate::network::TrainedModel;
use crate::train::{CheckpointPlan, TrainConfig, train};
use recording::Recording;
use recording::repeatability::Repeatability;

/// Trainings that leave recordings out.
const FOLDS: usize = 3;
/// What each of them costs, as a share of the training of the model that is shipped.
const OF_BUDGET: f64 = 0.5;
/// Below this physics is exact, as a share of the output's range.
const EXACT: f64 = 1e-4;
/// Samples and seconds of data below which a network learns the recordings by heart.
const FEWEST_SAMPLES: usize = 5_000;
const FEWEST_S: f64 = 120.0;
/// Instructions of ten multiply-accumulates of the fixed-point network: 54,586 for 49,472, counted in QEMU (see Results).
const PER_TEN_MACS: usize = 11;
/// The network rungs: name, preset, and what it is.
pub(super) const RUNGS: [(&str, &str, &str); 2] = [
    ("hybrid", "hybrid", "identified physics, and a small LSTM that sees its signals and corrects it"),
    ("LSTM", "stream-1x32", "an LSTM on the input alone, state carried"),
];

/// Why no network is worth training on these data, in words; `None` when one is.
fn reason_against(ladder: &[LadderRung], judging: &Judging, repeatability: &Repeatability) -> Option<String> {
    let (prepared, partition) = (judging.prepared, judging.partition);
    let samples: usize = prepared.series.iter().map(identification::Series::len).sum();
    let range = prepared.output.maximum - prepared.output.minimum;
    let physics = ladder.iter().filter(|rung| rung.eligible).map(|rung| rung.shape_rmse).fold(f64::INFINITY, f64::min);
    if prepared.inputs.len() > MAX_INPUTS {
        return Some(format!("the networks take at most {MAX_INPUTS} inputs; the sums of columns take more"));
    }
    if partition.kind() == SplitKind::Blocks {
        return Some("fewer than three recordings: a network could only be judged on copies of what it learned".to_owned());
    }
    if samples < FEWEST_SAMPLES || prepared.duration_s < FEWEST_S {
        return Some(format!("{:.0} s of data are too little for a network", prepared.duration_s));
    }
    if physics < EXACT * range {
        return Some("physics is exact here".to_owned());
    }
    let repeats = repeatability.repeatability?;
    // Physics that is clearly better than what the rig repeats proves the estimate wrong.
    (physics <= AT_REPEATABILITY * repeats && physics >= repeats / AT_REPEATABILITY)
        .then(|| format!("physics is at what the rig itself repeats ({repeats:.3} {})", prepared.output.unit))
}

/// Trains and judges the network rungs where that can help.
///
/// # Errors
/// When a training fails for a reason other than the data.
pub(super) fn add(
    ladder: &mut Vec<LadderRung>,
    judging: &Judging,
    repeatability: &Repeatability,
    settings: &Settings,
    tell: &(dyn Fn(Progress) + Sync),
    notes: &mut Vec<String>,
) -> Result<()> {
    let (prepared, partition) = (judging.prepared, judging.partition);
    let Some(budget_cpu_s) = settings.network_budget_cpu_s else { return Ok(()) };
    if let Some(reason) = reason_against(ladder, judging, repeatability) {
        let note = format!("no network was trained: {reason}");
        tell(Progress::Note(note.clone()));
        notes.push(note);
        return Ok(());
    }
    // Outer folds in as many parts as there are trainings.
    let count = partition.folds().min(FOLDS);
    let part = |fold: usize| fold * count / partition.folds();
    let fold_of: Vec<usize> = (0..partition.units().len()).map(|unit| part(partition.fold_of(unit))).collect();
    let mut trainings =
        Trainings { number: 0, of: RUNGS.len() * (count + 1), done: 0.0, all: RUNGS.len() as f64 * (OF_BUDGET * count as f64 + 1.0), tell };
    for (name, preset, what) in RUNGS {
        let clock = Instant::now();
        let mut train = |recordings: &[Recording], part: f64| trainings.next(recordings, (name, preset), part, budget_cpu_s, settings);
        let mut predictions: Vec<Vec<f64>> = prepared.series.iter().map(|one| vec![f64::NAN; one.len()]).collect();
        let mut refused = None;
        for fold in 0..count {
            let left_out: Vec<usize> = (0..partition.folds()).filter(|other| part(*other) == fold).collect();
            let training = nuisance::cleaned(prepared, partition, judging.search, &left_out);
            match train(&training, OF_BUDGET) {
                Ok(model) => {
                    let model = NetworkModel::new(model, Path::new(name))?;
                    for (index, _) in fold_of.iter().enumerate().filter(|(_, other)| **other == fold) {
                        let one = &prepared.series[index];
                        let inputs: Vec<&[f64]> = one.inputs.iter().map(Vec::as_slice).collect();
                        predictions[index] = model.simulate(&inputs, &one.gaps)?;
                    }
                }
                Err(problem) => refused = Some(problem),
            }
        }
        let model = train(&nuisance::cleaned(prepared, partition, judging.search, &[]), 1.0);
        let model = match (model, refused) {
            (Ok(model), None) => model,
            (Err(problem), _) | (_, Some(problem)) => {
                notes.push(format!("{name}: {problem:#}"));
                continue;
            }
        };
        let described = NetworkModel::new(model.clone(), Path::new(name))?;
        let description = described.description();
        let rung = LadderRung {
            parameters: description.parameters,
            step_instructions: description.macs_per_step * PER_TEN_MACS / 10,
            on_chip: prepared.inputs.len() == 1,
            seconds: clock.elapsed().as_secs_f64(),
            ..LadderRung::new(name, what, judging, predictions, RungModel::Network(Box::new(model)))
        };
        ladder.push(LadderRung { eligible: rung.errors.iter().all(|error| error.is_finite()), ..rung });
    }
    Ok(())
}

/// Trainings one after the other, and how far they are in all.
struct Trainings<'a> {
    number: usize,
    of: usize,
    /// Those that are done and all, in trainings of the model that is shipped.
    done: f64,
    all: f64,
    tell: &'a (dyn Fn(Progress) + Sync),
}

impl Trainings<'_> {
    /// The next training, which takes a part of the budget.
    fn next(
        &mut self,
        recordings: &[Recording],
        (name, preset): (&'static str, &str),
        part: f64,
        budget_cpu_s: f64,
        settings: &Settings,
    ) -> Result<TrainedModel> {
        let Some(config) = TrainConfig::preset(preset) else { anyhow::bail!("there is no preset `{preset}`") };
        let config = TrainConfig { budget_cpu_s: part * budget_cpu_s, ..config };
        let plan = CheckpointPlan { path: None, resume: false, stop_after: None };
        self.number += 1;
        (self.tell)(Progress::Network { number: self.number, of: self.of, name });
        let mut along = |progress: crate::train::Progress| {
            let within = progress.steps as f64 / progress.total_steps.max(1) as f64;
            (self.tell)(Progress::Trained((self.done + part * within) / self.all));
        };
        let trained = train(recordings, &config, settings.seed, settings.threads, &plan, &mut along);
        self.done += part;
        Ok(trained?.0)
    }
}
