//! From recordings to a trained model: data prepared, network started, trained and judged.

use std::time::Instant;

use cpu_time::ProcessTime;
use sha2::{Digest as _, Sha256};

use super::augment;
use super::budget::planned_steps;
use super::checkpoint::CheckpointPlan;
use super::config::{FrontEndKind, TrainConfig};
use super::front_end::{self, Channels};
use super::report::{Ended, Progress, TrainError, TrainReport, Validated};
use super::run::{Feed, Finished, Run};
use super::split::split;
use super::start::starting_network;
use super::team::Team;
use super::tracks::{Track, beyond, tracks as prepare};
use super::validation::Validation;
use crate::network::{Architecture, Mode, Network, Provenance, TrainedModel};
use model_export::schema::MAX_INPUTS;
use recording::{Recording, Signal};

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
        let finished = run.go(steps, plan, &fingerprint, progress)?;
        let mut network = Network::from_flat(&architecture, &finished.best);
        network.dense_weights.iter_mut().for_each(|weight| *weight *= residual);
        network.dense_bias *= residual;
        model.network = Some(network);
        finished
    };
    model.provenance.optimiser_steps = finished.steps;
    let (mut val_rmse, mut validation) = validation_rmse(&model, recordings, parts)?;
    let mut ended = finished.ended;
    // A hybrid whose network does not help is its physics.
    let is_whole = !matches!(ended, Ended::PhysicsSuffices | Ended::Interrupted);
    if config.front_end == FrontEndKind::Hybrid
        && config.sufficient > 0.0
        && is_whole
        && (val_rmse >= val_rmse_front_end || val_rmse.is_nan())
    {
        model.network = None;
        ended = Ended::PhysicsSuffices;
        (val_rmse, validation) = validation_rmse(&model, recordings, parts)?;
    }
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
        ended,
        training_recordings: model.provenance.training_recordings,
        synthetic_recordings: synthetic.len(),
        history: finished.history,
        validation,
    };
    Ok((model, report))
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
