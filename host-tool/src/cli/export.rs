//! `catheter export`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use model_export::blob;
use model_export::compensation::Compensation;
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::{Common, Outcome};
use crate::export::{self, Comparison, Export};
use crate::identify::PhysicsModel;
use crate::network::{self, TrainedModel};
use crate::{output, recording, say};

/// Quantise a trained model into a blob for the microcontroller.
///
/// Weights become 8-bit integers with a scale per row, chosen from how the model runs on the calibration recordings; the blob is then
/// run as the firmware runs it and compared with the f32 model. No sum in it can overflow: the headroom printed is the proof.
#[derive(clap::Args)]
#[command(after_long_help = "\
Examples:
  catheter export model.safetensors --calibration data/rich/train --out model.blob
  catheter export model.safetensors --calibration run.csv --columns time=t_s,input=voltage_V,output=displacement_um --out model.blob
  catheter inspect model.blob")]
pub struct Arguments {
    #[command(flatten)]
    common: Common,
    /// The trained model, as `catheter train` writes it, or a physics model, as `catheter identify` does.
    #[arg(value_name = "MODEL.safetensors|MODEL.toml")]
    model: PathBuf,
    /// Recordings like those the model will meet, for example its training data: CSV files or folders of them.
    #[arg(long, required = true, num_args = 1.., value_name = "PATH")]
    calibration: Vec<PathBuf>,
    /// Column names of foreign files, for example `time=t_s,input=voltage_V,output=displacement_um`.
    #[arg(long, value_name = "MAP")]
    columns: Option<String>,
    /// Sampling rate of calibration files without a time column.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// A blob of `catheter tune`: what the controllers need of the actuator is copied from it, so that an inverse has something to fall
    /// back to.
    #[arg(long, value_name = "FILE.blob")]
    compensation: Option<PathBuf>,
    /// The blob to write.
    #[arg(long, value_name = "FILE.blob", value_parser = output::file_argument("blob"))]
    out: PathBuf,
}

/// The result as JSON; the first five keys are a contract.
#[derive(Serialize)]
struct Summary<'a> {
    bytes: usize,
    sha256: String,
    rmse_f32_vs_fixed: f64,
    max_abs_f32_vs_fixed: f64,
    /// Absent without a network: there is no accumulator.
    accumulator_headroom: Option<f64>,
    rmse_f32_vs_fixed_normalised: f64,
    output_unit: &'a str,
    rounding: &'a str,
    recordings: usize,
    report: &'a Comparison,
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let model = load(&arguments.model)?;
    let options = recording::ReadOptions { columns: arguments.columns.clone(), rate_hz: arguments.rate_hz };
    let mut recordings = recording::load_with(&arguments.calibration, &options)?;
    // An inverse is calibrated on the recordings it was trained on; their ranges do not depend on how far it looks ahead.
    if (model.input.unit.as_str(), model.output.unit.as_str()) == ("mm", "bar") {
        recordings = recordings.iter().map(|recording| recording.exchanged(0.0)).collect::<Result<_, _>>()?;
    }
    let compensation = match &arguments.compensation {
        Some(path) => Some(compensation(path)?),
        None => None,
    };
    let mut inputs: Vec<PathBuf> = recordings.iter().map(recording::Recording::file).collect();
    inputs.push(arguments.model.clone());
    inputs.extend(arguments.compensation.clone());
    let mut outputs = vec![arguments.out.as_path()];
    outputs.extend(arguments.common.json.as_deref());
    output::refuse_overwriting(&inputs, &outputs)?;
    let export =
        export::export_with(&model, &recordings, compensation).with_context(|| format!("cannot export {}", arguments.model.display()))?;
    output::write_atomic(&arguments.out, &export.bytes)?;
    print(&arguments.out, &model, &export, recordings.len());
    if let Some(path) = &arguments.common.json {
        let summary = Summary {
            bytes: export.bytes.len(),
            sha256: hexadecimal(&Sha256::digest(&export.bytes)),
            rmse_f32_vs_fixed: export.comparison.rmse,
            max_abs_f32_vs_fixed: export.comparison.max_abs,
            accumulator_headroom: export.headroom.is_finite().then_some(export.headroom),
            rmse_f32_vs_fixed_normalised: export.comparison.rmse_normalised,
            output_unit: &model.output.unit,
            rounding: export.rounding,
            recordings: export.recordings,
            report: &export.comparison,
        };
        output::write_json(path, &summary)?;
    }
    Ok(Outcome::Success)
}

/// The compensation part of a blob.
fn compensation(path: &Path) -> Result<Compensation> {
    let bytes = std::fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let blob = blob::decode(&bytes).with_context(|| path.display().to_string())?;
    let extension = blob.model.extension().with_context(|| path.display().to_string())?;
    extension.compensation.with_context(|| format!("{}: has no compensation part; give the blob of `catheter tune`", path.display()))
}

fn load(path: &Path) -> Result<TrainedModel> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("blob") => bail!("{}: already a blob; `catheter inspect` shows what is in it", path.display()),
        Some("toml") => {
            let physics = PhysicsModel::read(path)?;
            Ok(export::from_physics(&physics).with_context(|| format!("cannot export {}", path.display()))?)
        }
        _ => Ok(network::load(path)?),
    }
}

fn print(out: &Path, model: &TrainedModel, export: &Export, given: usize) {
    let comparison = &export.comparison;
    let unit = &model.output.unit;
    say!("{}: {} bytes", out.display(), export.bytes.len());
    say!("calibrated on {} of {given} recordings, {} samples; rounding: {}", export.recordings, comparison.samples, export.rounding);
    say!(
        "fixed point against f32, free running: RMSE {:.3e} {unit} ({:.3e} of the output scale), largest {:.3e} {unit}",
        comparison.rmse,
        comparison.rmse_normalised,
        comparison.max_abs
    );
    if export.headroom.is_finite() {
        say!("no sum can overflow: the tightest has {:.1} times the room it needs", export.headroom);
    }
    if comparison.feature_saturations > 0 {
        say!("{} feature values met the end of their 16 bits", comparison.feature_saturations);
    }
    for (index, layer) in comparison.layers.iter().enumerate() {
        say!("layer {index}: signal to quantisation noise in dB, and its growth from the first to the last tenth of the recordings");
        for signal in &layer.signals {
            let ratio = signal.signal_to_noise_db.map_or("exact".to_owned(), |ratio| format!("{ratio:.1} dB"));
            let first = signal.rms_over_time.first().copied().unwrap_or(0.0);
            let last = signal.rms_over_time.last().copied().unwrap_or(0.0);
            say!("  {:<12} {ratio:>9}   largest {:>8.3}   noise {first:.1e} to {last:.1e}", signal.name, signal.largest);
        }
        say!(
            "  largest pre-activation {:.2}; saturated: cell {}, hidden {}",
            layer.largest_pre_activation,
            layer.cell_saturations,
            layer.hidden_saturations
        );
    }
}

/// Lower-case hexadecimal.
pub(super) fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
