//! What all models have in common: they say what they were made for, and they predict the output from the input alone.
//!
//! Terms. *Free running*: the model sees the input and never the measured output, from the first sample to the last. A prediction
//! starts at the equilibrium of the first sample (paper eq. (2), second line; networks from zero state). A *gap* is a place where
//! samples are missing: what the input did there is unknown, so by default a model starts afresh behind it, as in training
//! ([`Gaps::Reset`]); [`Gaps::Carry`] keeps its memory, which is better when only a sample or two were lost.
//!
//! [`load`] reads physics, fitted and discovered models (TOML), trained networks (safetensors) and blobs, whatever the file is called: it
//! looks at how it begins. A blob runs the microcontroller's code.

#![allow(clippy::result_large_err, reason = "errors with paths and names end the command; nothing is hot here")]

mod blob;
mod discovered;
mod error;
mod physics;
mod trained;

use std::path::{Path, PathBuf};

use serde::Serialize;

pub use blob::BlobModel;
pub use discovered::DiscoveredPredictor;
pub use error::ModelError;
pub use physics::PhysicsPredictor;
pub use recording::simulation::{Context, PERIOD_TOLERANCE};
pub use trained::NetworkModel;

use crate::fit::file::FittedPredictor;
use recording::simulation::{differs, is_even, on_even_clock};
use recording::{Recording, Signal};

/// Which arithmetic a model runs in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Arithmetic {
    /// Physics in `f64`.
    Physics,
    /// Front end and network in `f32`.
    Float,
    /// Front end in `f32`, network in fixed point, by the microcontroller's code.
    FixedPoint,
}

/// What a model was made for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Description {
    /// File, or name of a model that never was a file.
    pub path: PathBuf,
    /// What it is, in words.
    pub kind: String,
    /// How it computes.
    pub arithmetic: Arithmetic,
    /// What goes in.
    pub input: Signal,
    /// Inputs beside the first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub more_inputs: Vec<Signal>,
    /// What comes out.
    pub output: Signal,
    /// Smallest and largest input of the training data, where known.
    pub input_range: Option<(f64, f64)>,
    /// Time between samples in s; absent when the model does not depend on it.
    pub sample_period_s: Option<f64>,
    /// Numbers that were fitted.
    pub parameters: usize,
    /// Multiplications of one step.
    pub macs_per_step: usize,
}

/// What a model does behind a gap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Gaps {
    /// Starts afresh, from the equilibrium of the first sample behind the gap.
    #[default]
    Reset,
    /// Goes on as if nothing were missing.
    Carry,
}

/// How a model meets a recording.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fit {
    /// Interpolate a recording of another sample period instead of refusing it.
    pub resample: bool,
    /// What happens at gaps.
    pub gaps: Gaps,
    /// Seconds at the start of each stretch in which a model may read the measured output, s; it then runs freely.
    pub start_up_s: f64,
}

/// A model that can be run.
pub trait Predictor: Send + Sync {
    /// What it was made for.
    fn description(&self) -> &Description;

    /// The output for every input sample, free running from the start, in the units of the description; every index in `gaps` starts
    /// afresh. The result is as long as `input`.
    ///
    /// # Errors
    /// When the model turns out not to be runnable.
    fn predict(&self, input: &[f64], gaps: &[usize]) -> Result<Vec<f64>, ModelError>;

    /// The same from all inputs of a recording, of which a model of one input takes the first.
    ///
    /// # Errors
    /// As [`Self::predict`], and when the model has more inputs than are given.
    fn simulate(&self, inputs: &[&[f64]], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        self.predict(inputs[0], gaps)
    }

    /// The same, free running behind a start-up stretch, by a model that knows about sessions; for others the context changes nothing.
    ///
    /// # Errors
    /// As [`Self::simulate`].
    fn simulate_in(&self, _context: &Context<'_>, inputs: &[&[f64]], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        self.simulate(inputs, gaps)
    }
}

/// What a model file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// An identified physics model, TOML.
    Physics,
    /// A model that discovery wrote, TOML.
    Discovered,
    /// A model of `catheter fit`, TOML.
    Fitted,
    /// A trained network, safetensors.
    Network,
    /// A blob.
    Blob,
}

/// What a file is, by how it begins and what it says; its name does not matter.
///
/// # Errors
/// When it is a folder, cannot be read, or is none of these.
pub fn format(path: &Path) -> Result<Format, ModelError> {
    match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_dir() => return Err(ModelError::Folder { path: path.into() }),
        Ok(_) => {}
        Err(error) => return Err(ModelError::Open { path: path.into(), problem: error.to_string() }),
    }
    let bytes = output::read(path).map_err(|error| ModelError::Open { path: path.into(), problem: error.to_string() })?;
    if bytes.starts_with(&model_export::blob::MAGIC) {
        return Ok(Format::Blob);
    }
    // safetensors: eight bytes of length, then a JSON object.
    if bytes.get(8) == Some(&b'{') && bytes[..8].contains(&0) {
        return Ok(Format::Network);
    }
    #[derive(serde::Deserialize)]
    struct Head {
        kind: String,
    }
    let head = std::str::from_utf8(&bytes).ok().and_then(|text| toml::from_str::<Head>(text).ok());
    match head {
        Some(head) if head.kind == crate::fit::file::KIND => Ok(Format::Fitted),
        Some(head) if head.kind == crate::discover::file::KIND => Ok(Format::Discovered),
        Some(_) => Ok(Format::Physics),
        None => by_ending(path),
    }
}

/// What a file that cannot be recognised claims to be: its reader says best what is wrong with it.
fn by_ending(path: &Path) -> Result<Format, ModelError> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match ending.as_str() {
        "toml" => Ok(Format::Physics),
        "safetensors" => Ok(Format::Network),
        "blob" => Ok(Format::Blob),
        _ => Err(ModelError::Ending { path: path.into() }),
    }
}

/// Reads a model of any kind.
///
/// # Errors
/// When the file is no model, or cannot be read, is damaged, of another schema, or makes no sense. The message names the file and what
/// to do.
pub fn load(path: &Path) -> Result<Box<dyn Predictor>, ModelError> {
    Ok(match format(path)? {
        Format::Network => Box::new(NetworkModel::load(path)?),
        Format::Blob => Box::new(BlobModel::load(path)?),
        Format::Discovered => Box::new(DiscoveredPredictor::load(path)?),
        Format::Fitted => Box::new(FittedPredictor::load(path)?),
        Format::Physics => Box::new(PhysicsPredictor::load(path)?),
    })
}

/// Checks that a model was made for the quantities, units and sample period of a recording; with `resample` the period may differ.
///
/// # Errors
/// Naming both sides of the first difference.
pub fn check(model: &Description, recording: &Recording, resample: bool) -> Result<(), ModelError> {
    let sides = [("input", &model.input, &recording.input_signal), ("output", &model.output, &recording.output_signal)];
    for (side, wanted, found) in sides {
        if wanted != found {
            return Err(ModelError::Signal {
                recording: recording.path.clone(),
                model: model.path.clone(),
                side,
                wanted: wanted.clone(),
                found: found.clone(),
            });
        }
    }
    for (index, wanted) in model.more_inputs.iter().enumerate() {
        let found = recording.more_inputs.get(index).map(|channel| channel.signal.clone());
        if found.as_ref() != Some(wanted) {
            return Err(ModelError::Inputs {
                recording: recording.path.clone(),
                model: model.path.clone(),
                wanted: model.more_inputs.len() + 1,
                found: recording.more_inputs.len() + 1,
                missing: wanted.column(),
                role: format!("input{}", index + 2),
            });
        }
    }
    match model.sample_period_s {
        Some(period_s) if !resample && differs(period_s, recording.sample_period_s) => Err(ModelError::Period {
            recording: recording.path.clone(),
            model: model.path.clone(),
            model_s: period_s,
            recording_s: recording.sample_period_s,
        }),
        _ => Ok(()),
    }
}

/// Whether there are as many inputs as a model has.
fn enough(model: &Description, inputs: &[&[f64]]) -> Result<(), ModelError> {
    let wanted = 1 + model.more_inputs.len();
    if inputs.len() < wanted {
        let problem = format!("it has {wanted} inputs and was given {}", inputs.len());
        return Err(ModelError::Invalid { path: model.path.clone(), problem });
    }
    Ok(())
}

/// The output of a model for every sample of a recording, free running; see [`Fit`].
///
/// # Errors
/// As [`check`] and [`Predictor::predict`].
pub fn predict(model: &dyn Predictor, recording: &Recording, fit: Fit) -> Result<Vec<f64>, ModelError> {
    check(model.description(), recording, fit.resample)?;
    let gaps = if fit.gaps == Gaps::Reset { &recording.gaps[..] } else { &[] };
    let predicted = match model.description().sample_period_s {
        Some(period_s) if differs(period_s, recording.sample_period_s) || !is_even(recording) => {
            recording::resample::check(recording, period_s)
                .map_err(|error| ModelError::Invalid { path: model.description().path.clone(), problem: error.to_string() })?;
            on_even_clock(recording, gaps, period_s, fit.start_up_s, |context, inputs, gaps| model.simulate_in(context, inputs, gaps))
        }
        _ => model.simulate_in(&Context::of(recording, fit.start_up_s), &recording.inputs(), gaps),
    }?;
    // Numbers that are finite one by one need not have a sum that is.
    match predicted.iter().position(|value| value.is_nan() || value.abs() > recording::LARGEST) {
        Some(sample) => {
            let problem = format!(
                "its output on {} is {} from {:.3} s on, which no sensor gives; make it again",
                recording.path.display(),
                predicted[sample],
                recording.time_s[sample]
            );
            Err(ModelError::Invalid { path: model.description().path.clone(), problem })
        }
        None => Ok(predicted),
    }
}

#[cfg(test)]
mod tests;
