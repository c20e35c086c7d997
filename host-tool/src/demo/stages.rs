//! The stages before evaluation, each by the code of its command, and the clock that announces them.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use indicatif::MultiProgress;
use sha2::{Digest, Sha256};

use super::plan::{DemoConfig, Plan};
use super::results::{Exported, Stage, Trained};
use crate::evaluate::for_each;
use crate::evaluate::ladder::{self, Entry};
use crate::excitation::Limits;
use crate::excitation::sets::SetConfig;
use crate::export;
use crate::identify::{self, FitConfig};
use crate::network::{self, TrainedModel};
use crate::plant::Plant;
use crate::plant::dataset::Dataset;
use crate::recording::Recording;
use crate::train::{CheckpointPlan, Progress, TrainConfig, train as train_model};
use crate::{output, say};

/// Announces stages and measures them.
pub(super) struct Clock {
    stages: Vec<Stage>,
    total: usize,
    begun: Instant,
}

impl Clock {
    pub(super) fn new(total: usize) -> Self {
        Self { stages: Vec::new(), total, begun: Instant::now() }
    }

    pub(super) fn begin(&mut self, name: &str, what: &str) {
        self.end();
        say!("[{}/{}] {name}: {what}", self.stages.len() + 1, self.total);
        self.stages.push(Stage { name: name.to_owned(), what: what.to_owned(), seconds: 0.0 });
        self.begun = Instant::now();
    }

    fn end(&mut self) {
        if let Some(stage) = self.stages.last_mut() {
            stage.seconds = self.begun.elapsed().as_secs_f64();
        }
    }

    pub(super) fn finish(mut self) -> Vec<Stage> {
        self.end();
        self.stages
    }
}

/// The recordings of one rig.
pub(super) struct Data {
    pub(super) plan: &'static Plan,
    pub(super) plant: Plant,
    pub(super) train: Vec<Recording>,
    pub(super) test: Vec<Recording>,
}

/// Of how many recordings one is kept in a quick run: an odd number, so that every kind of the rich set and every frequency of the paper's
/// stays in.
const QUICK: usize = 5;

pub(super) fn simulate(plan: &'static Plan, config: &DemoConfig, folder: &Path) -> Result<Data> {
    let plant = Plant::named(plan.plant)?;
    let set = SetConfig { seed: config.seed, ..SetConfig::default() };
    let mut data = Dataset::simulate(plan.kind, &set, &Limits::default(), &plant, folder)?;
    if config.quick {
        let mut number = 0;
        data.made.retain(|made| {
            number += 1;
            made.part == "test" || number % QUICK == 1
        });
    }
    data.write(folder, &plant)?;
    let part = |part: &str| data.part(part).cloned().collect();
    Ok(Data { plan, plant, train: part("train"), test: part("test") })
}

/// The simple rungs; the Prandtl-Ishlinskii fit is left as a file, as `catheter identify` does.
pub(super) fn identify(data: &Data, folder: &Path) -> Result<Vec<Entry>> {
    let place = folder.join(format!("{}-physics.toml", data.plan.name));
    let fit = identify::fit(&data.train, &FitConfig::default()).with_context(|| format!("identify {}", data.plan.name))?;
    fit.model.write(&place)?;
    ladder::simple_rungs_from(fit.model, &data.train, 0.0)
}

/// A trained model and its run.
pub(super) struct One {
    pub(super) model: TrainedModel,
    pub(super) result: Trained,
}

/// Both networks of a rig.
pub(super) struct TrainedPair {
    pub(super) lstm: One,
    pub(super) hybrid: One,
}

/// Samples that each network is trained on, all passes together: counted, not timed, so that results repeat. One takes about 0.7 us of a
/// core: on two cores the hybrid's training lasts as long as both LSTMs'.
const HYBRID_SAMPLES: f64 = 44e6;
const LSTM_SAMPLES: f64 = 22e6;
const QUICK_SAMPLES: f64 = 0.6e6;

/// Trains both networks of every rig, several at a time, each on one thread.
pub(super) fn train(data: &[Data], config: &DemoConfig) -> Result<Vec<TrainedPair>> {
    let bars = MultiProgress::new();
    let jobs: Vec<(&Data, &str)> = data.iter().flat_map(|data| [(data, "hybrid"), (data, "stream-1x32")]).collect();
    // The longest first, so that no core idles at the end: the hybrid of the paper's rig needs no network and is done at once.
    let mut order: Vec<usize> = (0..jobs.len()).collect();
    order.sort_by_key(|&index| (jobs[index].1 != "hybrid", index));
    let done = for_each(&order, config.threads, |&index| {
        let (data, preset) = jobs[index];
        let one = train_one(data, preset, config, &bars).with_context(|| format!("train {preset} on {}", data.plan.name))?;
        Ok((index, one))
    })?;
    let mut done: Vec<(usize, One)> = done.into_iter().collect();
    done.sort_by_key(|(index, _)| *index);
    let mut models = done.into_iter().map(|(_, one)| one);
    let mut pairs = Vec::new();
    while let (Some(hybrid), Some(lstm)) = (models.next(), models.next()) {
        pairs.push(TrainedPair { lstm, hybrid });
    }
    Ok(pairs)
}

fn train_one(data: &Data, preset: &str, config: &DemoConfig, bars: &MultiProgress) -> Result<One> {
    let mut settings = TrainConfig::preset(preset).with_context(|| format!("there is no preset `{preset}`"))?;
    let (short, planned) = if preset == "hybrid" { ("hybrid", HYBRID_SAMPLES) } else { ("lstm", LSTM_SAMPLES) };
    let recorded: usize = data.train.iter().map(Recording::len).sum();
    settings.epochs = Some(if config.quick { QUICK_SAMPLES } else { planned } / recorded as f64);
    // The ladder's LSTM learns from the recordings alone, without help from identified physics.
    settings.synthetic = 0;
    let label = format!("{} {short}", data.plan.name);
    let bar = bars.add(output::progress(0, &label));
    let mut show = |progress: Progress| {
        bar.set_length(progress.total_steps);
        bar.set_position(progress.steps);
        bar.set_message(format!("error {:.4} mm", progress.training_rmse));
    };
    let (model, report) = train_model(&data.train, &settings, config.seed, 1, &CheckpointPlan::default(), &mut show)?;
    bar.finish_and_clear();
    let file = format!("{}-{short}.safetensors", data.plan.name);
    network::save(&config.folder.join(&file), &model)?;
    let has_network = model.network.is_some();
    let made = if has_network { format!("{} parameters", report.parameters) } else { "physics is exact, no network".to_owned() };
    say!("      {label}: {made}, validation RMSE {:.5} mm, {:.0} s", report.val_rmse, report.seconds);
    Ok(One { model, result: Trained { file, preset: preset.to_owned(), has_network, report } })
}

/// A written blob.
pub(super) struct Quantised {
    pub(super) path: PathBuf,
    pub(super) result: Exported,
}

pub(super) fn quantise(data: &Data, trained: &TrainedPair, folder: &Path) -> Result<Quantised> {
    let export = export::export(&trained.hybrid.model, &data.train).with_context(|| format!("quantise {}", data.plan.name))?;
    let file = format!("{}-hybrid.blob", data.plan.name);
    let path = folder.join(&file);
    output::write_atomic(&path, &export.bytes)?;
    let sha256 = Sha256::digest(&export.bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    let result = Exported {
        file,
        bytes: export.bytes.len(),
        sha256,
        accumulator_headroom: export.headroom.is_finite().then_some(export.headroom),
        rounding: export.rounding.to_owned(),
        comparison: export.comparison,
    };
    Ok(Quantised { path, result })
}
