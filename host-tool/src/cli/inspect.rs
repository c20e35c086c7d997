//! `catheter inspect`.

use std::path::PathBuf;

use anyhow::{Context, Result};
use firmware::estimator::{Estimator, EstimatorState, step_instructions};
use model_export::blob::{self, Blob};
use model_export::certificate::certificate;
use model_export::fixed::Table;
use model_export::headroom::{Headroom, headroom};
use model_export::schema::{Cell, Channel, Mode, Model, Network};
use serde::Serialize;

use super::{Common, Outcome};
use crate::export::hexadecimal;
use crate::network::described;
use crate::say;

/// Print everything about a model, and check it.
///
/// Of a model of any kind: what it is, what it was made for, what a step costs. Of a blob all it holds: every checksum is verified, the golden vectors are replayed by the firmware's own code, and the cost on the microcontroller is
/// worked out. Exit code 1 when the golden vectors are not met.
#[derive(clap::Args)]
#[command(after_long_help = "\
Examples:
  catheter inspect model.blob
  catheter inspect model.blob --json model.json
  catheter inspect physics.toml")]
pub struct Arguments {
    #[command(flatten)]
    common: Common,
    /// The model: a blob of `catheter export`, a network of `catheter train`, or the physics of `identify`, `fit` or `discover`.
    #[arg(value_name = "MODEL")]
    blob: PathBuf,
}

/// What a step costs on the Cortex-M4.
#[derive(Serialize)]
struct Cost {
    flash_bytes: usize,
    table_bytes: usize,
    ram_bytes: usize,
    multiply_accumulates: usize,
    estimated_instructions: usize,
}

#[derive(Serialize)]
struct GoldenSummary {
    samples: usize,
    worst: f32,
    tolerance: f32,
    same_bits: bool,
    passed: bool,
}

#[derive(Serialize)]
struct HeadroomSummary {
    accumulator: f64,
    scaled: f64,
    dense: f64,
}

#[derive(Serialize)]
struct Summary<'a> {
    schema_version: u16,
    bytes: usize,
    crc32: String,
    content_sha256: String,
    #[serde(flatten)]
    model: &'a Model<'a>,
    activation: Option<&'static str>,
    headroom: Option<HeadroomSummary>,
    /// Absent without a network, with one of other layers than LSTM, or with one that runs over windows.
    stability: Option<StabilitySummary>,
    compensates: bool,
    cost: Cost,
    golden_check: GoldenSummary,
}

#[derive(Serialize)]
struct StabilitySummary {
    /// Whether the sufficient condition holds.
    certified: bool,
    /// Spectral radius of the comparison system, from above.
    radius: f64,
    /// Time after which the correction no longer depends on the start.
    recovery_s: Option<f64>,
}

/// A recovered network's correction is this near to what it would be, in normalised output.
const TOLERANCE: f64 = 0.01;

/// Whether a file is a blob, or was meant to be one.
fn blob_like(path: &std::path::Path, bytes: &[u8]) -> bool {
    bytes.starts_with(&blob::MAGIC) || path.extension().is_some_and(|ending| ending == "blob")
}

/// What is known of a model that is no blob.
fn describe(arguments: &Arguments) -> Result<Outcome> {
    let model = crate::model::load(&arguments.blob)?;
    let description = model.description();
    say!("{}", arguments.blob.display());
    say!("  kind          {}", description.kind);
    say!("  input         {} in {}", description.input.quantity, description.input.unit);
    for signal in &description.more_inputs {
        say!("                {} in {}", signal.quantity, signal.unit);
    }
    say!("  output        {} in {}", description.output.quantity, description.output.unit);
    if let Some((low, high)) = description.input_range {
        say!("  trained on    {low} to {high} {}", description.input.unit);
    }
    match description.sample_period_s {
        Some(period_s) => say!("  sample period {period_s} s"),
        None => say!("  sample period any"),
    }
    say!("  parameters    {}", description.parameters);
    say!("  step          {} multiplications", description.macs_per_step);
    say!("`catheter export` makes a blob of what the microcontroller can run; `inspect` of a blob tells its memory and cost there.");
    arguments.common.results.write("A model", &format!("{}: {}.", arguments.blob.display(), description.kind), &description, |_| {})?;
    Ok(Outcome::Success)
}

/// Runs the command.
///
/// # Errors
/// When the model cannot be read or is refused.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let path = arguments.blob.display();
    let bytes = crate::output::read(&arguments.blob).with_context(|| format!("cannot read {path}"))?;
    if !blob_like(&arguments.blob, &bytes) {
        return describe(arguments);
    }
    let blob = blob::decode(&bytes).with_context(|| format!("{path} is refused"))?;
    anyhow::ensure!(
        blob::content_hash_matches(&bytes),
        "{path} is refused: the content hash in the header is not that of the payload; export the model again"
    );
    let model = &blob.model;
    let estimator = Estimator::new(model).with_context(|| format!("{path} is refused"))?;
    let replay = estimator.replay(&model.golden);
    let golden_check = GoldenSummary {
        samples: replay.samples,
        worst: replay.worst,
        tolerance: model.golden.tolerance,
        same_bits: replay.same_bits,
        passed: replay.passed(),
    };
    let cost = cost(model, bytes.len());
    let room = model.network.as_ref().map(headroom);
    say!("{path}");
    print_header(&blob, bytes.len());
    print_model(model);
    if let (Some(network), Some(room)) = (&model.network, room) {
        print_network(network, room);
    }
    let stability = model.network.as_ref().and_then(|network| certificate(network, TOLERANCE)).map(|certificate| StabilitySummary {
        certified: certificate.holds(),
        radius: certificate.radius,
        recovery_s: certificate.recovery_steps.map(|steps| steps as f64 * f64::from(model.sample_period_s)),
    });
    // A window begins from zero state every time: there is nothing to forget.
    let stability = stability.filter(|_| model.mode == Mode::Streaming);
    if let Some(stability) = &stability {
        print_stability(stability);
    }
    print_controllers(model);
    print_provenance(model);
    say!("cost on the Cortex-M4");
    say!("  flash         {} bytes of blob, {} bytes of tables", cost.flash_bytes, cost.table_bytes);
    say!("  RAM           {} bytes of state", cost.ram_bytes);
    say!(
        "  step          {} multiply-accumulates, about {} instructions (estimate, within 3 % of the emulator's count)",
        cost.multiply_accumulates,
        cost.estimated_instructions
    );
    say!(
        "golden vectors  {}: {} samples, worst {:.3e} of {:.3e} {} allowed, bits {}",
        if golden_check.passed { "passed" } else { "FAILED" },
        golden_check.samples,
        golden_check.worst,
        golden_check.tolerance,
        model.output.unit,
        if golden_check.same_bits { "as exported" } else { "DIFFER from the export" }
    );
    let outcome = if golden_check.passed { Outcome::Success } else { Outcome::CheckFailed };
    if arguments.common.results.files().next().is_some() {
        let summary = Summary {
            schema_version: blob.schema_version,
            bytes: bytes.len(),
            crc32: format!("{:08x}", blob.crc),
            content_sha256: hexadecimal(&blob.content_hash),
            model,
            activation: model.network.as_ref().and_then(|network| network.activation().ok()).map(|activation| activation.name()),
            headroom: room.map(|room| HeadroomSummary { accumulator: room.accumulator, scaled: room.scaled, dense: room.dense }),
            stability,
            compensates: model.extension().is_ok_and(|extension| extension.compensation.is_some()),
            cost,
            golden_check,
        };
        arguments.common.results.write(
            "A blob",
            &format!("{path}: what is in it, and whether it does what it did when it was made."),
            &summary,
            |_| {},
        )?;
    }
    Ok(outcome)
}

fn cost(model: &Model<'_>, bytes: usize) -> Cost {
    let runs = if let Mode::Window { length } = model.mode { usize::from(length) } else { 1 };
    let network = model.network.as_ref().map_or(0, |network| {
        let layers = network.layers.iter().map(|layer| layer.input_weights.len() + layer.recurrent_weights.len());
        layers.sum::<usize>() + network.dense.weights.len() / 2
    });
    Cost {
        flash_bytes: bytes,
        table_bytes: 2 * size_of::<Table>(),
        ram_bytes: size_of::<EstimatorState>(),
        multiply_accumulates: runs * network,
        estimated_instructions: step_instructions(model),
    }
}

fn print_header(blob: &Blob<'_>, bytes: usize) {
    say!("  schema        {}", blob.schema_version);
    say!("  length        {bytes} bytes");
    say!("  CRC-32        {:08x}", blob.crc);
    say!("  content hash  {}", hexadecimal(&blob.content_hash));
}

fn print_channel(role: &str, channel: &Channel<'_>) {
    say!(
        "  {role:<13} {} in {}, {} to {} in training, normalised as (value - {}) / {}",
        channel.quantity,
        channel.unit,
        channel.minimum,
        channel.maximum,
        channel.offset,
        channel.scale
    );
}

fn print_model(model: &Model<'_>) {
    let front_end = &model.front_end;
    say!("model");
    print_channel("input", &model.input);
    model.more_inputs.iter().enumerate().for_each(|(index, channel)| print_channel(&format!("input {}", index + 2), channel));
    print_channel("output", &model.output);
    say!("  sample period {} s", model.sample_period_s);
    match model.mode {
        Mode::Streaming => say!("  mode          streaming"),
        Mode::Window { length } => say!("  mode          window of {length} samples"),
    }
    say!(
        "  trained on    {} to {} {}, at up to {:.3} {}/s",
        model.envelope.minimum,
        model.envelope.maximum,
        model.input.unit,
        model.envelope.maximum_rate,
        model.input.unit
    );
    say!("front end (f32)");
    say!("  input path    dead time {} samples, lag coefficient {}", front_end.dead_time_samples, front_end.lag_coefficient);
    say!("  readout       bias {}, input weight {}", front_end.bias, front_end.input_weight);
    for (threshold, weight) in front_end.play_thresholds.iter().zip(&front_end.play_weights) {
        say!("  play          threshold {threshold}, weight {weight}");
    }
    for (coefficient, weight) in front_end.creep_coefficients.iter().zip(&front_end.creep_weights) {
        say!("  creep         coefficient {coefficient}, weight {weight}");
    }
    if let Some(curve) = &front_end.curve {
        say!("  curve         offset {}, slope {} below the first bend", curve.offset, curve.slope);
        for (point, bend) in curve.bend_points.iter().zip(&curve.bends) {
            say!("  bend          at {point}, slope changes by {bend}");
        }
    }
    for feature in &front_end.features {
        say!("  feature       {:?}, (signal - {}) x {}", feature.source, feature.offset, feature.gain);
    }
}

fn span(bytes: &[u8], fraction: i32) -> (f64, f64) {
    let step = 2f64.powi(fraction - 48);
    let scales = bytes.as_chunks::<4>().0.iter().map(|bytes| f64::from(i32::from_le_bytes(*bytes)) * step);
    scales.fold((f64::INFINITY, 0.0), |(least, most), scale| (scale.min(least), scale.max(most)))
}

fn print_network(network: &Network<'_>, room: Headroom) {
    let Ok(activation) = network.activation() else { return };
    let layers = network.layers.iter().map(|layer| (layer.cell, usize::from(layer.units)));
    say!("network (fixed point, {})", described(layers, activation));
    let mut input_fraction = i32::from(model_export::fixed::FEATURE_FRACTION);
    for (index, layer) in network.layers.iter().enumerate() {
        let own = layer.cell.activation(activation);
        let hidden_fraction = model_export::fixed::hidden_fraction(layer.cell, own, layer.cell_exponent, layer.hidden_shift);
        let (input, recurrent) = (span(layer.input_multipliers, input_fraction), span(layer.recurrent_multipliers, hidden_fraction));
        let limit = f64::from(layer.cell_limit) * 2f64.powi(i32::from(layer.cell_exponent) - 30);
        say!(
            "  layer {index}       {}, {} inputs, {} units; {} limit {limit:.4}, hidden state in steps of 2^-{hidden_fraction}",
            layer.cell.name(),
            layer.inputs,
            layer.units,
            if layer.cell == Cell::Lstm { "cell" } else { "output" }
        );
        if layer.recurrent_multipliers.is_empty() {
            say!("    row scales  input {:.3e} to {:.3e}", input.0, input.1);
        } else {
            say!("    row scales  input {:.3e} to {:.3e}, recurrent {:.3e} to {:.3e}", input.0, input.1, recurrent.0, recurrent.1);
        }
        input_fraction = hidden_fraction;
    }
    say!("  dense         {} weights, bias {}", network.dense.weights.len() / 2, network.dense.bias);
    say!(
        "  headroom      accumulators {:.1}, scaled sums {:.1}, dense {:.3} times the largest possible sum",
        room.accumulator,
        room.scaled,
        room.dense
    );
}

fn print_stability(stability: &StabilitySummary) {
    if !stability.certified {
        say!(
            "  stability     not certified: the sufficient condition gives {:.3}, below 1 is needed; the state limits hold all the same",
            stability.radius
        );
        return;
    }
    let recovery = stability.recovery_s.map_or_else(|| "in more than ten minutes".to_owned(), |time_s| format!("within {time_s:.2} s"));
    say!(
        "  stability     certified: forgets any state that inputs can bring it to (radius {:.4}); its correction agrees to {} % of the output scale {recovery}",
        stability.radius,
        100.0 * TOLERANCE
    );
}

fn print_controllers(model: &Model<'_>) {
    let Ok(extension) = model.extension() else { return };
    say!("controllers");
    match &extension.compensation {
        Some(part) => say!(
            "  compensation  dead time {} s, lags {} s filling, {} s venting and {} s, threshold {} bar, {} play operators; 95 % of its errors below {} mm",
            part.dead_time_s,
            part.fill_time_constant_s,
            part.vent_time_constant_s,
            part.second_time_constant_s,
            part.touch_bar,
            part.plays.len(),
            part.error_mm
        ),
        None => say!("  compensation  none: for estimation only; `catheter tune` makes a model with it"),
    }
    match extension.domain {
        Some(domain) => say!("  domain        at most {} nested reversals deeper than {}", domain.nested_reversals, domain.reversal_depth),
        None => say!("  domain        pressures and rates only"),
    }
}

fn print_provenance(model: &Model<'_>) {
    let provenance = &model.provenance;
    let metrics = &model.metrics;
    let unit = model.output.unit;
    say!("provenance");
    say!("  preset        {}, seed {}, tool {}", provenance.preset, provenance.seed, provenance.tool_version);
    // Every model of ours was fitted to a recording; an imported network does not say to what.
    if provenance.training_recordings == 0 {
        say!("  training data unknown, and so is the validation error: the network was trained elsewhere");
    } else {
        say!(
            "  training data {} recordings, {} optimiser steps, SHA-256 {}",
            provenance.training_recordings,
            provenance.optimiser_steps,
            if provenance.training_data_sha256.is_empty() { "unknown" } else { provenance.training_data_sha256 }
        );
        say!("  validation    RMSE {:.3e} {unit}", metrics.validation_rmse);
    }
    say!(
        "  fixed point   RMSE {:.3e} {unit} against f32, largest {:.3e} {unit}, over {} samples",
        metrics.rmse_f32_vs_fixed,
        metrics.max_abs_f32_vs_fixed,
        metrics.calibration_samples
    );
}
