//! `catheter train`.

use std::path::PathBuf;

use anyhow::{Context, Result, anyhow, bail};

use super::{Common, Data, Outcome};
use crate::recording::Recording;
use crate::train::{CheckpointPlan, Ended, PRESETS, Progress, TrainConfig, TrainReport, train};
use crate::{network, output};

/// Train a network on recordings.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    data: Data,
    /// Starting point of all settings.
    #[arg(long, default_value = "hybrid", value_parser = PRESETS, value_name = "NAME")]
    preset: String,
    /// Where the model goes.
    #[arg(long, value_name = "FILE", value_parser = output::file_argument("safetensors"))]
    out: PathBuf,
    /// CPU time to plan for in s; becomes a fixed number of optimiser steps at a nominal throughput, so that results repeat.
    #[arg(long, value_name = "N", value_parser = positive::<f64>)]
    budget_cpu_s: Option<f64>,
    /// Passes over the training recordings, instead of a CPU budget.
    #[arg(long, value_name = "N", conflicts_with = "budget_cpu_s", value_parser = positive::<f64>)]
    epochs: Option<f64>,
    /// Sequences trained side by side.
    #[arg(long, value_name = "N")]
    batch: Option<usize>,
    /// Peak learning rate.
    #[arg(long, value_name = "RATE", value_parser = positive::<f32>)]
    learning_rate: Option<f32>,
    /// Keep the network certified to forget where it started; costs accuracy. The field `certified_radius` sets the bound.
    #[arg(long)]
    certified: bool,
    /// Train with input and output exchanged: an inverse, for the controller `learned-inverse`.
    #[arg(long)]
    inverse: bool,
    /// How far ahead of the pressure an inverse sees the displacement, ms; about dead time and lags together.
    #[arg(long, value_name = "MS", default_value_t = 120.0, requires = "inverse")]
    look_ahead_ms: f64,
    /// TOML file whose fields replace those of the preset.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Go on from the checkpoint that an interrupted run left beside the model.
    #[arg(long)]
    resume: bool,
    /// Stop after this many optimiser steps and leave a checkpoint.
    #[arg(long, value_name = "N")]
    stop_after_steps: Option<u64>,
}

/// Bound on the spectral radius with `--certified`: a memory of two seconds at 50 Hz.
const CERTIFIED_RADIUS: f64 = 0.99;

#[derive(serde::Serialize)]
struct Written<'a> {
    #[serde(flatten)]
    report: &'a TrainReport,
    /// Central 95 % prediction interval for the error on the next recording, from the validation recordings.
    next_interval: [f64; 2],
    preset: &'a str,
    seed: u64,
    threads: usize,
    model: String,
}

/// The preset with the fields of the file and of the command line put in its place.
fn configuration(arguments: &Arguments) -> Result<TrainConfig> {
    let preset = TrainConfig::preset(&arguments.preset).with_context(|| format!("there is no preset `{}`", arguments.preset))?;
    let mut config = match &arguments.config {
        None => preset,
        Some(path) => {
            let place = || path.display().to_string();
            let text = crate::output::read_text(path).with_context(place)?;
            let changes: toml::Table = toml::from_str(&text).with_context(place)?;
            let mut table = toml::Table::try_from(&preset).context("cannot encode the preset")?;
            for (name, value) in changes {
                match (table.get_mut(&name), value) {
                    (Some(toml::Value::Table(inner)), toml::Value::Table(changes)) if name == "optimizer" => inner.extend(changes),
                    (_, value) => {
                        table.insert(name, value);
                    }
                }
            }
            table.try_into().with_context(place)?
        }
    };
    if let Some(budget) = arguments.budget_cpu_s {
        config.budget_cpu_s = budget;
        config.epochs = None;
    }
    config.epochs = arguments.epochs.or(config.epochs);
    if arguments.certified && config.certified_radius == 0.0 {
        config.certified_radius = CERTIFIED_RADIUS;
    }
    config.lanes = arguments.batch.unwrap_or(config.lanes);
    config.learning_rate = arguments.learning_rate.unwrap_or(config.learning_rate);
    config.validate().map_err(|problem| match &arguments.config {
        None => anyhow!("the settings make no sense: {problem}"),
        Some(path) => anyhow!("{}: the settings make no sense: {problem}", path.display()),
    })?;
    Ok(config)
}

fn positive<T: std::str::FromStr + Into<f64> + Copy>(text: &str) -> Result<T, String> {
    let value = text.parse().ok().filter(|value: &T| (*value).into().is_finite() && (*value).into() > 0.0);
    value.ok_or_else(|| "a positive number is wanted".to_owned())
}

/// What the next recording may bring, by the recordings that validated; one or two recordings validate with their own ends.
fn next_interval(report: &TrainReport, recordings: usize) -> [f64; 2] {
    let errors: Vec<f64> = report.validation.iter().map(|validated| validated.rmse).collect();
    identification::interval::next(&errors, (recordings > 2).then_some(errors.len()))
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let config = configuration(arguments)?;
    let mut recordings = arguments.data.load()?;
    if arguments.inverse {
        let exchange = |recording: &Recording| recording.exchanged(arguments.look_ahead_ms / 1e3);
        recordings = recordings.iter().map(exchange).collect::<Result<_, _>>()?;
    }
    let mut inputs: Vec<PathBuf> = recordings.iter().map(Recording::file).collect();
    inputs.extend(arguments.config.clone());
    let mut outputs = vec![arguments.out.as_path()];
    outputs.extend(arguments.common.results.files());
    output::refuse_overwriting(&inputs, &outputs)?;
    let threads = arguments.common.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    let plan = CheckpointPlan {
        path: Some(arguments.out.with_extension("checkpoint")),
        resume: arguments.resume,
        stop_after: arguments.stop_after_steps,
    };
    // Hours of somebody's computer may be in it.
    if let Some(path) = plan.path.as_ref().filter(|path| path.exists() && !arguments.resume && !output::may_replace()) {
        bail!("{}: an interrupted training left it; say --resume to go on with that, or --force to begin anew", path.display());
    }
    let unit = recordings.first().map_or(String::new(), |recording| recording.output_signal.unit.clone());
    let bar = output::progress(0, "train");
    let mut show = |progress: Progress| {
        bar.set_length(progress.total_steps);
        bar.set_position(progress.steps);
        let validation = progress.validation_rmse.map_or(String::new(), |rmse| format!(" validation {rmse:.5} {unit}"));
        bar.set_message(format!("error {:.5} {unit}{validation}", progress.training_rmse));
    };
    let (model, report) = train(&recordings, &config, arguments.common.seed, threads, &plan, &mut show)?;
    bar.finish_and_clear();
    if report.ended == Ended::Interrupted {
        if let Some(path) = &plan.path {
            crate::say!(
                "stopped after {} of {} steps; go on with --resume ({})",
                report.optimiser_steps,
                report.planned_steps,
                path.display()
            );
        }
    } else {
        if !report.val_rmse.is_finite() {
            bail!("the training diverged: the validation error is not finite; lower --learning-rate");
        }
        network::save(&arguments.out, &model)?;
        crate::say!(
            "{}: {} parameters, {:.1} epochs in {:.1} s ({:.1} CPU s, {:.1} GMAC/s), validation {:.5} {unit} (front end alone {:.5})",
            arguments.out.display(),
            report.parameters,
            report.epochs,
            report.seconds,
            report.cpu_seconds,
            report.train_macs_per_second / 1e9,
            report.val_rmse,
            report.val_rmse_front_end,
        );
        if report.ended == Ended::EarlyStop {
            crate::say!(
                "stopped after {} of {} steps: {} validations without improvement; the best weights are kept",
                report.optimiser_steps,
                report.planned_steps,
                config.patience
            );
        }
        let [low, high] = next_interval(&report, recordings.len());
        crate::say!("expect {:.5} {unit} on the next recording, {low:.5} to {high:.5} with 95 %", report.val_rmse);
        if arguments.inverse {
            // The device shows the inverse the reference as it will be, the recordings what it was on average over a sample.
            let ahead_ms = arguments.look_ahead_ms + 500.0 * model.sample_period_s;
            crate::say!("export it with --compensation, and set control.learned_look_ahead_ms to {ahead_ms:.0}");
        }
    }
    if arguments.common.results.files().next().is_some() {
        let result = Written {
            report: &report,
            next_interval: next_interval(&report, recordings.len()),
            preset: &config.preset,
            seed: arguments.common.seed,
            threads,
            model: arguments.out.display().to_string(),
        };
        let lead = format!("{}: {} parameters, validation {:.5} {unit}.", arguments.out.display(), report.parameters, report.val_rmse);
        arguments
            .common
            .results
            .write("A trained network", &lead, &result, |page| crate::report::training(page, &report.history, &unit))?;
    }
    Ok(Outcome::Success)
}
