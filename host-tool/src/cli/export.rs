//! `catheter export`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use model_export::blob::{self, Blob};
use model_export::compensation::Compensation;

use super::{Common, Outcome};
use crate::discover::file::DiscoveredModel;
use crate::discover::physics::physics_model;
use crate::export::c::CFiles;
use crate::export::{self, Export, Summary};
use crate::identify::PhysicsModel;
use crate::model::{self, Format};
use crate::network::{self, TrainedModel};
use crate::{output, recording, say};
use modelling::physics::FittedModel;

/// Quantise a trained model into a blob for the microcontroller, or into C source.
///
/// Weights become 8-bit integers with a scale per row, chosen from how the model runs on the calibration recordings; the blob is then
/// run as the firmware runs it and compared with the f32 model. No sum in it can overflow: the headroom printed is the proof.
///
/// With `--c` the model becomes a C source file and its header, for Simulink or another firmware. Their outputs have the bits of the blob's.
#[derive(clap::Args)]
#[group(id = "files", required = true, multiple = true, args = ["out", "c"])]
#[command(after_long_help = "\
Examples:
  catheter export model.safetensors --calibration data/rich/train --out model.blob
  catheter export model.safetensors --calibration run.csv --columns time=t_s,input=voltage_V,output=displacement_um --out model.blob
  catheter export model.safetensors --calibration data/rich/train --c model.c
  catheter export model.blob --c model.c
  catheter inspect model.blob")]
pub struct Arguments {
    #[command(flatten)]
    common: Common,
    /// The trained model, as `catheter train` writes it, or a physics model, as `catheter identify`, `fit` and `discover` do; with `--c` also
    /// a blob.
    #[arg(value_name = "MODEL.safetensors|MODEL.toml|MODEL.blob")]
    model: PathBuf,
    /// Recordings like those the model will meet, for example its training data: CSV files or folders of them. Not for a blob, which
    /// is calibrated already.
    #[arg(long, num_args = 1.., value_name = "PATH")]
    calibration: Vec<PathBuf>,
    #[command(flatten)]
    reading: super::Reading,
    /// A blob of `catheter tune`: what the controllers need of the actuator is copied from it, so that an inverse has something to fall
    /// back to.
    #[arg(long, value_name = "FILE.blob")]
    compensation: Option<PathBuf>,
    /// The blob to write.
    #[arg(long, value_name = "FILE.blob", value_parser = output::file_argument("blob"))]
    out: Option<PathBuf>,
    /// The C source file to write; its header FILE.h goes beside it. What is public in them begins with FILE.
    #[arg(long, value_name = "FILE.c", value_parser = output::file_argument("c"))]
    c: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let c = arguments.c.as_deref().map(|path| CFiles::new(path).with_context(|| format!("--c {}", path.display()))).transpose()?;
    if model::format(&arguments.model)? == Format::Blob {
        return rewrite(arguments, c.as_ref());
    }
    let format = model::format(&arguments.model)?;
    if arguments.calibration.is_empty() {
        bail!("--calibration is missing: recordings like those that {} will meet", arguments.model.display());
    }
    let mut recordings = arguments.reading.load(&arguments.calibration)?;
    let model = load(format, &arguments.model, &recordings)?;
    recordings = export::as_the_model_sees(&model, recordings)?;
    let compensation = match &arguments.compensation {
        Some(path) => Some(compensation(path)?),
        None => None,
    };
    let mut inputs: Vec<PathBuf> = recordings.iter().map(recording::Recording::file).collect();
    inputs.push(arguments.model.clone());
    inputs.extend(arguments.compensation.clone());
    refuse_overwriting(arguments, c.as_ref(), &inputs)?;
    let bar = output::progress(0, "export");
    bar.set_message("calibrating, quantising and comparing");
    let told = |done: u64, all: u64| {
        bar.set_length(all);
        bar.set_position(done);
    };
    let export = export::export_told(&model, &recordings, compensation, &told)
        .with_context(|| format!("cannot export {}", arguments.model.display()))?;
    bar.finish_and_clear();
    if let Some(c) = &c {
        write_c(c, &blob::decode(&export.bytes)?)?;
    }
    if let Some(out) = &arguments.out {
        output::write_atomic(out, &export.bytes)?;
        say!("{}: {} bytes", out.display(), export.bytes.len());
    }
    print(&model, &export, recordings.len());
    let summary = Summary::of(&model, &export, c.map(CFiles::into_paths).unwrap_or_default());
    let lead = format!("{} for the microcontroller: what fixed point changes, and what a step costs.", arguments.model.display());
    arguments.common.results.write("A model in fixed point", &lead, &summary, |_| {})?;
    Ok(Outcome::Success)
}

/// Writes a blob as C: nothing is calibrated again.
fn rewrite(arguments: &Arguments, c: Option<&CFiles>) -> Result<Outcome> {
    let path = &arguments.model;
    let bytes = crate::output::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let blob = blob::decode(&bytes).with_context(|| path.display().to_string())?;
    let Some(c) = c else {
        bail!("{}: already a blob; `catheter inspect` shows what is in it, and --c FILE.c writes it as C", path.display());
    };
    if arguments.out.is_some()
        || !arguments.calibration.is_empty()
        || arguments.reading.columns.is_some()
        || arguments.compensation.is_some()
    {
        bail!("{}: a blob is written as it is; leave --out, --calibration, --columns and --compensation away", path.display());
    }
    refuse_overwriting(arguments, Some(c), std::slice::from_ref(path))?;
    write_c(c, &blob).with_context(|| format!("cannot export {}", path.display()))?;
    let summary = Summary::of_blob(&bytes, &blob, vec![c.source.clone(), c.header.clone()]);
    arguments.common.results.write("A model as C", &format!("{} as C.", path.display()), &summary, |_| {})?;
    Ok(Outcome::Success)
}

/// Writes the C files and says what is in them.
fn write_c(files: &CFiles, blob: &Blob<'_>) -> Result<()> {
    files.write(blob)?;
    let name = files.identifier();
    say!("{} and {}: {name}_reset, {name}_step, {name}_self_test", files.source.display(), files.header.display());
    say!("compile with -ffp-contract=off and without -ffast-math; the outputs have the bits of the firmware's");
    Ok(())
}

fn refuse_overwriting(arguments: &Arguments, c: Option<&CFiles>, inputs: &[PathBuf]) -> Result<()> {
    let mut outputs: Vec<&Path> = arguments.out.as_deref().into_iter().chain(arguments.common.results.files()).collect();
    outputs.extend(c.iter().flat_map(|c| [c.source.as_path(), c.header.as_path()]));
    // The option names the source alone.
    c.map_or(Ok(()), |c| output::refuse_any(&c.header))?;
    output::refuse_overwriting(inputs, &outputs)
}

/// The compensation part of a blob.
fn compensation(path: &Path) -> Result<Compensation> {
    let bytes = crate::output::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let blob = blob::decode(&bytes).with_context(|| path.display().to_string())?;
    let extension = blob.model.extension().with_context(|| path.display().to_string())?;
    extension.compensation.with_context(|| format!("{}: has no compensation part; give the blob of `catheter tune`", path.display()))
}

/// The model in the exporter's form; a discovered one is checked on the recordings.
fn load(format: Format, path: &Path, recordings: &[recording::Recording]) -> Result<TrainedModel> {
    let refused = || format!("cannot export {}", path.display());
    match format {
        Format::Physics => export::from_physics(&PhysicsModel::read(path)?).with_context(refused),
        Format::Fitted => export::from_fitted(&FittedModel::read(path)?).with_context(|| path.display().to_string()),
        Format::Discovered => {
            let physics = physics_model(&DiscoveredModel::read(path)?, recordings).map_err(|why| {
                anyhow!("{}: no form for the microcontroller: {why}; `catheter fit` finds a model that has one", path.display())
            })?;
            export::from_physics(&physics).with_context(refused)
        }
        Format::Network | Format::Blob => Ok(network::load(path)?),
    }
}

fn print(model: &TrainedModel, export: &Export, given: usize) {
    let comparison = &export.comparison;
    let unit = &model.output.unit;
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
