//! What all models have in common: they say what they were made for, and they predict the output from the input alone.
//!
//! Terms. *Free running*: the model sees the input and never the measured output, from the first sample to the last. A prediction
//! starts at the equilibrium of the first sample (paper eq. (2), second line; networks from zero state). A *gap* is a place where
//! samples are missing: what the input did there is unknown, so by default a model starts afresh behind it, as in training
//! ([`Gaps::Reset`]); [`Gaps::Carry`] keeps its memory, which is better when only a sample or two were lost.
//!
//! [`load`] reads physics (`.toml`), trained networks (`.safetensors`) and blobs (`.blob`); a blob runs the microcontroller's code.

#![allow(clippy::result_large_err, reason = "errors with paths and names end the command; nothing is hot here")]

mod blob;
mod discovered;
mod error;
mod physics;
mod resample;
mod trained;

use std::path::{Path, PathBuf};

use serde::Serialize;

pub use blob::BlobModel;
pub use discovered::DiscoveredPredictor;
pub use error::ModelError;
pub use physics::PhysicsPredictor;
pub(crate) use resample::interpolate;
pub use trained::NetworkModel;

use crate::recording::{Recording, Signal};

/// Sample periods that differ by more than this share are different; the median step of a measured clock strays by less.
pub const PERIOD_TOLERANCE: f64 = 0.05;

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
}

/// Reads a model; the ending says which kind.
///
/// # Errors
/// When the ending is unknown, or the file cannot be read, is damaged, of another schema, or makes no sense. The message names the file
/// and what to do.
pub fn load(path: &Path) -> Result<Box<dyn Predictor>, ModelError> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if !["toml", "safetensors", "blob"].contains(&ending.as_str()) {
        return Err(ModelError::Ending { path: path.into() });
    }
    match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_dir() => return Err(ModelError::Folder { path: path.into() }),
        Ok(_) => {}
        Err(error) => return Err(ModelError::Open { path: path.into(), problem: error.to_string() }),
    }
    Ok(match ending.as_str() {
        "safetensors" => Box::new(NetworkModel::load(path)?),
        "blob" => Box::new(BlobModel::load(path)?),
        _ if is_discovered(path) => Box::new(DiscoveredPredictor::load(path)?),
        _ => Box::new(PhysicsPredictor::load(path)?),
    })
}

/// Whether a TOML file says that `catheter discover` wrote it; what cannot be read is left to the physics model's messages.
fn is_discovered(path: &Path) -> bool {
    #[derive(serde::Deserialize)]
    struct Head {
        kind: String,
    }
    let head = std::fs::read_to_string(path).ok().and_then(|text| toml::from_str::<Head>(&text).ok());
    head.is_some_and(|head| head.kind == crate::discover::file::KIND)
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

fn differs(model_s: f64, recording_s: f64) -> bool {
    // In this order a period that is not a number differs.
    let same = (recording_s - model_s).abs() <= PERIOD_TOLERANCE * model_s;
    !same
}

/// The output of a model for every sample of a recording, free running; see [`Fit`].
///
/// # Errors
/// As [`check`] and [`Predictor::predict`].
pub fn predict(model: &dyn Predictor, recording: &Recording, fit: Fit) -> Result<Vec<f64>, ModelError> {
    check(model.description(), recording, fit.resample)?;
    let gaps = if fit.gaps == Gaps::Reset { &recording.gaps[..] } else { &[] };
    match model.description().sample_period_s {
        Some(period_s) if differs(period_s, recording.sample_period_s) => resample::predict(model, recording, gaps, period_s),
        _ => model.predict(&recording.input, gaps),
    }
}

#[cfg(test)]
mod tests;
