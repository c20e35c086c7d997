//! The training loop: from recordings to a trained model.

use std::time::Instant;

use cpu_time::ProcessTime;
use rand::{Rng as _, RngExt as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::augment;
use super::blocks::{Block, shares};
use super::checkpoint::{Checkpoint, CheckpointPlan};
use super::config::{FrontEndKind, TrainConfig};
use super::front_end::{self, Channels};
use super::optimizer::Method;
use super::quantised;
use super::split::split;
use super::stability;
use super::team::Team;
use super::tracks::{Purpose, Track, Walk, Windows, beyond, stream, tracks as prepare};
use super::validation::Validation;
use crate::network::{Architecture, Layout, Mode, Network, Provenance, TrainedModel};
use model_export::schema::MAX_INPUTS;
use recording::{Recording, Signal};

/// Why training did not happen.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A setting is out of its domain.
    #[error("setting {0}")]
    Config(String),
    /// The recordings cannot be trained on.
    #[error("{0}")]
    Data(String),
    /// The front end cannot be built.
    #[error("front end: {0}")]
    FrontEnd(#[from] model_export::validate::Invalid),
    /// A checkpoint cannot be written, read or used.
    #[error("{0}")]
    Checkpoint(String),
}

/// What a run reports while it goes.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Optimiser steps made.
    pub steps: u64,
    /// Optimiser steps planned.
    pub total_steps: u64,
    /// Root mean square training error of the last steps, in output units.
    pub training_rmse: f64,
    /// Last root mean square validation error in output units, if there was a validation.
    pub validation_rmse: Option<f64>,
}

/// What a run cost and reached; the keys other programs rely on, and a few more.
#[derive(Clone, Debug, Serialize)]
pub struct TrainReport {
    /// Weights and biases of the network.
    pub parameters: usize,
    /// Multiply-accumulates of one forward step.
    pub macs_per_step: usize,
    /// Passes over the training samples.
    pub epochs: f64,
    /// Wall time in s.
    pub seconds: f64,
    /// CPU time of the process in s.
    pub cpu_seconds: f64,
    /// Multiply-accumulates a second, three per weight and trained sample, over the wall time of the optimiser steps.
    pub train_macs_per_second: f64,
    /// Free-running error on the validation part in output units.
    pub val_rmse: f64,
    /// The front end's readout alone, on the same samples.
    pub val_rmse_front_end: f64,
    /// Optimiser steps made.
    pub optimiser_steps: u64,
    /// Optimiser steps planned.
    pub planned_steps: u64,
    /// Why the run ended.
    pub ended: Ended,
    /// Training recordings, and recordings in all.
    pub training_recordings: usize,
    /// Synthetic recordings among what was trained on.
    pub synthetic_recordings: usize,
    /// Errors along the way.
    pub history: Vec<Milestone>,
    /// Error on each recording with a validation part.
    pub validation: Vec<Validated>,
}

/// Errors at one validation, in output units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Milestone {
    /// Optimiser steps made.
    pub steps: u64,
    /// Running root mean square over the last batches.
    pub training_rmse: f64,
    /// Free running over the validation part.
    pub validation_rmse: f64,
}

/// How well one recording is predicted, free running.
#[derive(Clone, Debug, Serialize)]
pub struct Validated {
    /// The file.
    pub path: String,
    /// Root mean square error on its validation samples, in output units.
    pub rmse: f64,
}

/// Why a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ended {
    /// All planned steps were made.
    Complete,
    /// The front end's readout is exact: no network was trained.
    PhysicsSuffices,
    /// Validation stopped improving.
    EarlyStop,
    /// The clock ran far past the budget: this machine is much slower than the nominal one.
    OverBudget,
    /// Stopped on request; the checkpoint can be resumed.
    Interrupted,
}

/// Multiply-accumulates a CPU second that the budget counts on. Nominal, so that equal budgets mean equal steps on every machine:
/// measured on one core of an AMD EPYC 9004 (AVX-512) with the element-wise work counted apart.
const NOMINAL_MACS_PER_CPU_S: f64 = 45e9;
/// CPU time of the element-wise work of one LSTM unit, forward and backward, in s; same conditions.
const NOMINAL_UNIT_S: f64 = 5e-9;
/// CPU time that each sample costs whatever the network, in s; same conditions.
const NOMINAL_SAMPLE_S: f64 = 60e-9;
/// Multiply-accumulates a CPU second of SOAP's products, which are smaller; same conditions.
const NOMINAL_SOAP_MACS_PER_CPU_S: f64 = 22e9;
/// The run is cut off when it used this many times its budget.
const OVER_BUDGET: f64 = 2.0;
/// CPU time of one multiply-accumulate of the fixed-point forward pass in s, and of the element-wise work of a unit; same conditions.
const NOMINAL_FIXED_MAC_S: f64 = 0.25e-9;
const NOMINAL_FIXED_UNIT_S: f64 = 60e-9;
/// Validations of the quantised phase.
const QUANTISED_VALIDATIONS: u64 = 5;
/// Changes the seed for the quantised phase, whose visits are others.
const QUANTISED_SEED: u64 = 0x5155_414e;
/// Optimiser steps from one projection onto certified weights to the next.
const PROJECTION_INTERVAL: u64 = 32;
/// Share of the budget that optimiser steps may plan with; the rest is validation and preparation.
const STEP_SHARE: f64 = 0.9;

/// CPU time of one optimiser step on the nominal machine in s; `quantised` with the fixed-point forward pass.
#[must_use]
pub fn nominal_step_s(architecture: &Architecture, config: &TrainConfig, quantised: bool) -> f64 {
    let macs = Network::zeros(architecture.features, &architecture.units, architecture.activation, architecture.state_limit).macs_per_step()
        as f64;
    let units = architecture.units.iter().sum::<usize>() as f64;
    let forward_and_backward = 3.0 * macs / NOMINAL_MACS_PER_CPU_S + units * NOMINAL_UNIT_S + NOMINAL_SAMPLE_S;
    let fixed = if quantised { macs * NOMINAL_FIXED_MAC_S + units * NOMINAL_FIXED_UNIT_S } else { 0.0 };
    // Adam passes over all parameters once a step.
    let update = Layout::new(architecture).len() as f64 * 1e-9 + soap_macs_per_step(architecture, config) / NOMINAL_SOAP_MACS_PER_CPU_S;
    (forward_and_backward + fixed) * (config.lanes * config.chunk) as f64 + update
}

/// Multiply-accumulates of SOAP's products and factorisations in one optimiser step; none for Adam.
fn soap_macs_per_step(architecture: &Architecture, config: &TrainConfig) -> f64 {
    if config.optimizer.method == Method::Adam {
        return 0.0;
    }
    let blocks = shares(&Layout::new(architecture), Method::Soap, 1);
    let one = |block: &Block| {
        let (rows, columns) = (block.rows as f64, block.columns as f64);
        // Each step: two moments and a rotation there and back. Each turn: on either side one product, and a factorisation that makes two
        // and two thirds as many operations.
        let step = 3.0 * rows * columns * (rows + columns);
        let turn = 11.0 / 3.0 * (rows.powi(3) + columns.powi(3));
        step + turn / config.optimizer.basis_interval as f64
    };
    blocks.iter().flatten().map(one).sum()
}

/// Starting weights: input weights uniform (Glorot), recurrent weights orthogonal, forget gates open, dense small, so that training
/// starts close to the front end's readout.
#[must_use]
pub fn starting_network(architecture: &Architecture, forget_bias: f32, seed: u64) -> Network {
    let mut random = stream(seed, Purpose::Weights, 0);
    let mut network = Network::zeros(architecture.features, &architecture.units, architecture.activation, architecture.state_limit);
    for layer in &mut network.layers {
        #[expect(clippy::cast_precision_loss, reason = "layer widths are small")]
        let bound = (6.0 / (layer.inputs + layer.units) as f32).sqrt();
        layer.input_weights.iter_mut().for_each(|weight| *weight = random.random_range(-bound..bound));
        for gate in layer.recurrent_weights.chunks_exact_mut(layer.units * layer.units) {
            orthogonal(layer.units, &mut random, gate);
        }
        layer.bias[layer.units..2 * layer.units].fill(forget_bias);
    }
    let last = network.dense_weights.len();
    #[expect(clippy::cast_precision_loss, reason = "layer widths are small")]
    let bound = 0.1 / (last.max(1) as f32).sqrt();
    network.dense_weights.iter_mut().for_each(|weight| *weight = random.random_range(-bound..bound));
    network
}

/// A random orthogonal matrix: Gram-Schmidt on normal vectors.
fn orthogonal(size: usize, random: &mut ChaCha8Rng, target: &mut [f32]) {
    let mut rows: Vec<Vec<f64>> = Vec::with_capacity(size);
    while rows.len() < size {
        let mut row: Vec<f64> = (0..size).map(|_| normal(random)).collect();
        for other in &rows {
            let along: f64 = row.iter().zip(other).map(|(a, b)| a * b).sum();
            row.iter_mut().zip(other).for_each(|(a, b)| *a -= along * b);
        }
        let length = row.iter().map(|value| value * value).sum::<f64>().sqrt();
        // A vector that lies almost in the span of the others would be noise after scaling; draw another.
        if length > 1e-3 {
            row.iter_mut().for_each(|value| *value /= length);
            rows.push(row);
        }
    }
    #[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
    target.iter_mut().zip(rows.iter().flatten()).for_each(|(target, &value)| *target = value as f32);
}

/// A standard normal number (Box and Muller, 1958).
fn normal(random: &mut ChaCha8Rng) -> f64 {
    let unit = |bits: u64| ((bits >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
    let (first, second) = (unit(random.next_u64()), unit(random.next_u64()));
    (-2.0 * first.ln()).sqrt() * (std::f64::consts::TAU * second).cos()
}

/// SHA-256 over the samples of the recordings.
fn data_hash(recordings: &[Recording]) -> String {
    let mut hash = Sha256::new();
    for recording in recordings {
        hash.update((recording.len() as u64).to_le_bytes());
        for values in std::iter::once(&recording.time_s[..]).chain(recording.inputs()).chain([&recording.output[..]]) {
            values.iter().for_each(|value| hash.update(value.to_le_bytes()));
        }
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

fn check(recordings: &[Recording]) -> Result<f64, TrainError> {
    let Some(first) = recordings.first() else {
        return Err(TrainError::Data("there is no recording to train on; give --data a CSV file or a folder of them".to_owned()));
    };
    for recording in recordings {
        let path = recording.path.display();
        if recording.inputs().len() > MAX_INPUTS {
            return Err(TrainError::Data(format!("{path}: has {} inputs, a network takes {MAX_INPUTS}", recording.inputs().len())));
        }
        let signals = |one: &Recording| {
            let more: Vec<Signal> = one.more_inputs.iter().map(|channel| channel.signal.clone()).collect();
            (one.input_signal.clone(), more, one.output_signal.clone())
        };
        if signals(recording) != signals(first) {
            return Err(TrainError::Data(format!(
                "{path}: its channels are not those of {}; train on recordings of one rig",
                first.path.display()
            )));
        }
        if (recording.sample_period_s / first.sample_period_s - 1.0).abs() > 0.01 {
            return Err(TrainError::Data(format!(
                "{path}: sampled every {} s, {} every {} s; train on recordings of one sample period",
                recording.sample_period_s,
                first.path.display(),
                first.sample_period_s
            )));
        }
    }
    Ok(first.sample_period_s)
}

/// Fills batches one way or the other.
enum Feed {
    Walk(Walk),
    Windows(Windows),
}

/// A run that is set up: data prepared, network started.
struct Run<'a> {
    config: &'a TrainConfig,
    tracks: Vec<Track>,
    output_scale: f64,
    target_scale: f32,
    team: Team,
    feed: Feed,
    seed: u64,
    validation: Validation,
}

/// Trains a model on recordings.
///
/// Equal recordings, configuration, seed and thread count give equal bits, whether the run was interrupted and resumed or not.
///
/// # Errors
/// When a setting or a recording cannot be used, or a checkpoint does not fit.
pub fn train(
    recordings: &[Recording],
    config: &TrainConfig,
    seed: u64,
    threads: usize,
    plan: &CheckpointPlan,
    progress: &mut dyn FnMut(Progress),
) -> Result<(TrainedModel, TrainReport), TrainError> {
    config.validate().map_err(TrainError::Config)?;
    check(recordings)?;
    let parts = split(recordings, config.validation_fraction, seed);
    train_split(recordings, &parts, config, seed, threads, plan, progress)
}

/// Trains a model on the samples of `recordings` that `parts` says are for training; the others validate. Both have one entry a
/// recording, and `parts` one flag a sample, as [`split`] gives them.
///
/// # Errors
/// As [`train`]; also where the shapes differ, or all samples are on one side.
pub fn train_split(
    recordings: &[Recording],
    parts: &[Vec<bool>],
    config: &TrainConfig,
    seed: u64,
    threads: usize,
    plan: &CheckpointPlan,
    progress: &mut dyn FnMut(Progress),
) -> Result<(TrainedModel, TrainReport), TrainError> {
    let wall = Instant::now();
    let cpu = ProcessTime::now();
    config.validate().map_err(TrainError::Config)?;
    let sample_period_s = check(recordings)?;
    if !recordings.iter().map(Recording::len).eq(parts.iter().map(Vec::len)) {
        return Err(TrainError::Config("the split is not one flag for every sample of every recording".to_owned()));
    }
    if [true, false].iter().any(|side| !parts.iter().flatten().any(|flag| flag == side)) {
        return Err(TrainError::Config("the split has no sample on one of its sides: training, validation".to_owned()));
    }
    let channels = front_end::channels(recordings, parts);
    let mut front_end = match config.front_end {
        FrontEndKind::Input => front_end::plain(false, channels.inputs()),
        FrontEndKind::InputAndDifference => front_end::plain(true, channels.inputs()),
        FrontEndKind::Hybrid => super::hybrid::front_end(recordings, parts, &channels, sample_period_s, config.stick_band)?,
    };
    front_end::scale_features(&mut front_end, &channels, recordings, parts)?;
    let synthetic = augment::synthetic(recordings, parts, config.synthetic.saturating_sub(recordings.len()), config.synthetic_limit, seed);
    let synthetic_parts: Vec<Vec<bool>> = synthetic.iter().map(|recording| vec![true; recording.len()]).collect();
    let mut tracks = prepare(recordings, parts, &front_end, &channels)?;
    tracks.extend(prepare(&synthetic, &synthetic_parts, &front_end, &channels)?);

    let samples = tracks.iter().flat_map(|track| &track.training).filter(|&&training| training).count();
    let residual = residual_scale(&tracks);
    let Channels { input, more_inputs, output } = channels;
    let mut model = TrainedModel {
        input,
        more_inputs,
        output,
        sample_period_s,
        mode: config.mode,
        front_end,
        network: None,
        provenance: Provenance {
            preset: config.preset.clone(),
            seed,
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            training_data_sha256: data_hash(recordings),
            training_recordings: parts.iter().filter(|part| part.contains(&true)).count(),
            optimiser_steps: 0,
            validation_rmse: 0.0,
        },
    };
    let (val_rmse_front_end, _) = validation_rmse(&model, recordings, parts)?;
    let samples_a_step = match config.mode {
        Mode::Streaming => config.lanes * config.chunk,
        Mode::Window { .. } => config.lanes,
    };
    let finished = if residual < config.sufficient {
        Finished::without_network()
    } else {
        let architecture = Architecture {
            features: model.front_end.features.len(),
            units: config.units.clone(),
            activation: config.activation,
            state_limit: config.state_limit,
        };
        let steps = planned_steps(config, &architecture, samples as f64 / samples_a_step as f64);
        let fingerprint = fingerprint(&model.provenance.training_data_sha256, config, seed, threads);
        let mut run = Run {
            config,
            output_scale: f64::from(model.output.scale),
            target_scale: residual,
            team: {
                let start = starting_network(&architecture, config.forget_bias, seed).to_flat();
                Team::new(&architecture, &start, config.optimizer, config.lanes, config.chunk, threads)
            },
            feed: Feed::new(&tracks, config, seed),
            seed,
            validation: Validation::new(&architecture, &tracks, config.mode),
            tracks,
        };
        let finished = run.go(steps, plan, &fingerprint, cpu, progress)?;
        let mut network = Network::from_flat(&architecture, &finished.best);
        network.dense_weights.iter_mut().for_each(|weight| *weight *= residual);
        network.dense_bias *= residual;
        model.network = Some(network);
        finished
    };
    model.provenance.optimiser_steps = finished.steps;
    let (val_rmse, validation) = validation_rmse(&model, recordings, parts)?;
    model.provenance.validation_rmse = val_rmse;
    let macs_per_step = model.network.as_ref().map_or(0, Network::macs_per_step);
    let trained = 3.0 * macs_per_step as f64 * (config.lanes * config.chunk) as f64 * finished.steps_here as f64;
    let report = TrainReport {
        parameters: model.network.as_ref().map_or(0, Network::parameters),
        macs_per_step,
        epochs: finished.steps as f64 * samples_a_step as f64 / samples.max(1) as f64,
        seconds: wall.elapsed().as_secs_f64(),
        cpu_seconds: cpu.elapsed().as_secs_f64(),
        train_macs_per_second: trained / finished.step_seconds.max(f64::MIN_POSITIVE),
        val_rmse,
        val_rmse_front_end,
        optimiser_steps: finished.steps,
        planned_steps: finished.planned_steps,
        ended: finished.ended,
        training_recordings: model.provenance.training_recordings,
        synthetic_recordings: synthetic.len(),
        history: finished.history,
        validation,
    };
    Ok((model, report))
}

impl Feed {
    fn new(tracks: &[Track], config: &TrainConfig, seed: u64) -> Self {
        match config.mode {
            Mode::Streaming => Self::Walk(Walk::new(tracks, config, seed)),
            Mode::Window { length } => Self::Windows(Windows::new(tracks, length, config.lanes, seed)),
        }
    }

    fn skip(&mut self, batches: u64) {
        match self {
            Self::Walk(walk) => walk.skip(batches),
            Self::Windows(windows) => windows.skip(batches),
        }
    }
}

fn planned_steps(config: &TrainConfig, architecture: &Architecture, steps_an_epoch: f64) -> Plan {
    let share = f64::from(config.quantised);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a positive count far below 2^63")]
    let whole = |steps: f64| steps.ceil() as u64;
    let (float, quantised) = match config.epochs {
        Some(epochs) => ((1.0 - share) * epochs * steps_an_epoch, share * epochs * steps_an_epoch),
        None => {
            let seconds = STEP_SHARE * config.budget_cpu_s;
            let steps = |share: f64, quantised: bool| share * seconds / nominal_step_s(architecture, config, quantised);
            (steps(1.0 - share, false), steps(share, true))
        }
    };
    Plan { float_steps: whole(float).max(1), quantised_steps: whole(quantised) }
}

/// Root mean square of what the front end leaves over, so that the network learns something of order one.
fn residual_scale(tracks: &[Track]) -> f32 {
    let (mut sum, mut count) = (0.0, 0u64);
    for track in tracks {
        for sample in (0..track.len()).filter(|&sample| track.training[sample]) {
            let left = f64::from(track.output[sample] - track.front_end[sample]);
            sum += beyond(left, f64::from(track.slack[sample])).powi(2);
            count += 1;
        }
    }
    #[expect(clippy::cast_possible_truncation, reason = "the network works in f32")]
    let scale = (sum / count.max(1) as f64).sqrt() as f32;
    scale.max(f32::MIN_POSITIVE)
}

/// What a checkpoint must agree with to be resumed.
fn fingerprint(data_sha256: &str, config: &TrainConfig, seed: u64, threads: usize) -> String {
    let settings = serde_json::to_string(config).unwrap_or_default();
    format!("{settings} seed {seed} threads {threads} data {data_sha256}")
}

/// Free-running root mean square error of the model on the validation samples, in output units: of all, and of each recording.
fn validation_rmse(model: &TrainedModel, recordings: &[Recording], parts: &[Vec<bool>]) -> Result<(f64, Vec<Validated>), TrainError> {
    let (mut total, mut samples) = (0.0, 0u64);
    let mut each = Vec::new();
    for (recording, part) in recordings.iter().zip(parts).filter(|(_, part)| part.contains(&false)) {
        let predicted = model.predict(&recording.inputs(), &recording.gaps)?;
        let (mut sum, mut count) = (0.0, 0u64);
        for ((predicted, measured), _) in predicted.iter().zip(&recording.output).zip(part).filter(|(_, training)| !**training) {
            sum += (predicted - measured).powi(2);
            count += 1;
        }
        each.push(Validated { path: recording.path.display().to_string(), rmse: (sum / count.max(1) as f64).sqrt() });
        total += sum;
        samples += count;
    }
    Ok(((total / samples.max(1) as f64).sqrt(), each))
}

/// What a finished loop leaves.
struct Finished {
    best: Vec<f32>,
    steps: u64,
    planned_steps: u64,
    history: Vec<Milestone>,
    ended: Ended,
    steps_here: u64,
    step_seconds: f64,
}

impl Finished {
    fn without_network() -> Self {
        Self {
            best: Vec::new(),
            steps: 0,
            planned_steps: 0,
            history: Vec::new(),
            ended: Ended::PhysicsSuffices,
            steps_here: 0,
            step_seconds: 0.0,
        }
    }
}

/// What a run has found so far.
#[derive(Default)]
struct Found {
    best: Vec<f32>,
    best_square: f64,
    since_best: u64,
    history: Vec<Milestone>,
    training_square: f64,
    /// Largest magnitude of each layer's hidden state, once known.
    largest_hidden: Vec<f64>,
}

/// The optimiser steps of a run: in f32, then with the fixed-point code in the forward pass.
#[derive(Clone, Copy, Debug)]
struct Plan {
    float_steps: u64,
    quantised_steps: u64,
}

impl Run<'_> {
    /// Error of the output, in its unit, for a mean square of the network's own target.
    fn training_rmse(&self, mean_square: f64) -> f64 {
        mean_square.sqrt() * f64::from(self.target_scale) * self.output_scale
    }

    fn go(
        &mut self,
        steps: Plan,
        plan: &CheckpointPlan,
        fingerprint: &str,
        cpu: ProcessTime,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Finished, TrainError> {
        let mut found = Found { best_square: f64::INFINITY, ..Found::default() };
        if let Some(saved) = plan.load(fingerprint)? {
            if let Some(problem) = saved.problem(&self.team.state(), steps.float_steps + steps.quantised_steps) {
                return Err(plan.refused(problem));
            }
            self.team.restore(&saved.team);
            self.feed.skip(saved.team.steps_made);
            found = Found {
                best: saved.best,
                best_square: saved.best_square,
                since_best: saved.since_best,
                history: saved.history,
                training_square: saved.training_square,
                largest_hidden: Vec::new(),
            };
        }
        let first_step = self.team.steps_made();
        let total_steps = steps.float_steps + steps.quantised_steps;
        let mut step_seconds = 0.0;
        let mut ended = Ended::Complete;
        let mut report = |run: &Self, found: &Found| {
            progress(Progress {
                steps: run.team.steps_made(),
                total_steps,
                training_rmse: run.training_rmse(found.training_square),
                validation_rmse: found.history.last().map(|milestone| milestone.validation_rmse),
            });
        };

        let interval = (steps.float_steps / self.config.validations).max(1);
        while self.team.steps_made() < steps.float_steps {
            if self.config.patience > 0 && found.since_best >= self.config.patience {
                ended = Ended::EarlyStop;
                break;
            }
            let done = self.team.steps_made() + 1;
            step_seconds += self.step(self.config.learning_rate_at(done - 1, steps.float_steps), &mut found);
            let validate = done.is_multiple_of(interval) || done == steps.float_steps;
            if validate {
                let parameters = self.result();
                self.validate(parameters, &mut found);
            }
            if validate || done.is_multiple_of(16) {
                report(self, &found);
            }
            let interrupted = plan.stop_after.is_some_and(|stop| done >= stop) && done < total_steps;
            if validate || interrupted {
                plan.save(fingerprint, &self.checkpoint(&found))?;
            }
            ended = self.cut_off(interrupted, cpu);
            if ended != Ended::Complete {
                break;
            }
        }
        if found.best.is_empty() {
            found.best = self.result();
        }

        if steps.quantised_steps > 0 && matches!(ended, Ended::Complete | Ended::EarlyStop) {
            let float_ended = ended;
            self.begin_quantised(&mut found)?;
            let interval = (steps.quantised_steps / QUANTISED_VALIDATIONS).max(1);
            for done in 1..=steps.quantised_steps {
                let rate = self.config.quantised_learning_rate * self.config.learning_rate_at(done - 1, steps.quantised_steps);
                step_seconds += self.step(rate, &mut found);
                let validate = done.is_multiple_of(interval) || done == steps.quantised_steps;
                if validate {
                    let parameters = self.rounded(&self.result(), &found)?;
                    self.validate(parameters, &mut found);
                }
                if validate || done.is_multiple_of(16) {
                    report(self, &found);
                }
                // No checkpoint here: resumed, the phase starts anew from the last one and comes out the same.
                let interrupted = plan.stop_after.is_some_and(|stop| self.team.steps_made() >= stop) && done < steps.quantised_steps;
                ended = self.cut_off(interrupted, cpu);
                if ended != Ended::Complete {
                    break;
                }
            }
            if ended == Ended::Complete {
                ended = float_ended;
            }
        }
        if ended != Ended::Interrupted {
            plan.remove();
        }
        let made = self.team.steps_made();
        Ok(Finished {
            best: found.best,
            steps: made,
            planned_steps: total_steps,
            history: found.history,
            ended,
            steps_here: made - first_step,
            step_seconds,
        })
    }

    /// One batch, one optimiser step; gives the wall time it took in s.
    fn step(&mut self, learning_rate: f32, found: &mut Found) -> f64 {
        let clock = Instant::now();
        let first = self.team.steps_made() == 0;
        match &mut self.feed {
            Feed::Walk(walk) => walk.fill(&self.tracks, self.target_scale, &mut self.team.batch()),
            Feed::Windows(windows) => windows.fill(&self.tracks, self.target_scale, &mut self.team.batch()),
        }
        let loss = self.team.step(learning_rate);
        if self.config.certified_radius > 0.0 && self.team.steps_made().is_multiple_of(PROJECTION_INTERVAL) {
            let mut state = self.team.state();
            state.values = self.certified(state.values);
            self.team.restore(&state);
        }
        found.training_square = if first { loss } else { 0.98 * found.training_square + 0.02 * loss };
        clock.elapsed().as_secs_f64()
    }

    /// The parameters that would be kept now.
    fn result(&self) -> Vec<f32> {
        self.certified(match self.config.optimizer.average_decay > 0.0 {
            true => self.team.averaged_parameters(),
            false => self.team.parameters(),
        })
    }

    /// The parameters, brought to where the certificate holds if that is wanted.
    fn certified(&self, parameters: Vec<f32>) -> Vec<f32> {
        if self.config.certified_radius == 0.0 {
            return parameters;
        }
        let mut network = Network::from_flat(self.team.architecture(), &parameters);
        stability::project(&mut network, self.config.certified_radius);
        network.to_flat()
    }

    fn validate(&mut self, parameters: Vec<f32>, found: &mut Found) {
        let square = self.validation.mean_square(&parameters, &self.tracks, self.target_scale);
        found.history.push(Milestone {
            steps: self.team.steps_made(),
            training_rmse: self.training_rmse(found.training_square),
            validation_rmse: square.sqrt() * self.output_scale,
        });
        if square < found.best_square {
            (found.best, found.best_square, found.since_best) = (parameters, square, 0);
        } else {
            found.since_best += 1;
        }
    }

    /// The parameters that the integers stand for.
    fn rounded(&self, parameters: &[f32], found: &Found) -> Result<Vec<f32>, TrainError> {
        let rounded = quantised::rounded(self.team.architecture(), parameters, &found.largest_hidden);
        rounded.map(|(_, flat)| flat).map_err(|error| TrainError::Data(format!("the network does not fit fixed point: {error}")))
    }

    /// Goes over to the fixed-point forward pass, from the best parameters, on visits that start anew. The best so far becomes that of
    /// the rounded weights: what counts is what the microcontroller runs.
    fn begin_quantised(&mut self, found: &mut Found) -> Result<(), TrainError> {
        found.largest_hidden = self.validation.largest_hidden(&found.best, &self.tracks);
        self.team.quantise(found.largest_hidden.clone());
        let mut state = self.team.state();
        state.values.clone_from(&found.best);
        state.average.clone_from(&found.best);
        state.carried.iter_mut().for_each(|carried| carried.fill(0.0));
        self.team.restore(&state);
        self.feed = Feed::new(&self.tracks, self.config, self.seed ^ QUANTISED_SEED);
        let parameters = self.rounded(&found.best, found)?;
        (found.best_square, found.since_best) = (f64::INFINITY, 0);
        self.validate(parameters, found);
        Ok(())
    }

    fn checkpoint(&self, found: &Found) -> Checkpoint {
        Checkpoint {
            team: self.team.state(),
            best: found.best.clone(),
            best_square: found.best_square,
            since_best: found.since_best,
            history: found.history.clone(),
            training_square: found.training_square,
        }
    }

    fn cut_off(&self, interrupted: bool, cpu: ProcessTime) -> Ended {
        if interrupted {
            Ended::Interrupted
        } else if self.config.epochs.is_none() && cpu.elapsed().as_secs_f64() > OVER_BUDGET * self.config.budget_cpu_s {
            Ended::OverBudget
        } else {
            Ended::Complete
        }
    }
}
