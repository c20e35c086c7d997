//! What can be wrong with a model, or between a model and a recording; every message says what to do.

use std::path::PathBuf;

use crate::network::ModelFileError;
use recording::Signal;

/// Why a model cannot be read or run.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what each field is")]
pub enum ModelError {
    /// The ending says nothing.
    #[error("{}: is no model that this program knows; give a file of `catheter fit`, `identify`, `discover`, `train` or `export`", path.display())]
    Ending { path: PathBuf },
    /// A folder was given.
    #[error("{}: is a folder, a model file is wanted; name the file in it", path.display())]
    Folder { path: PathBuf },
    /// The file cannot be read.
    #[error("{}: cannot be read ({problem}); check the path", path.display())]
    Open { path: PathBuf, problem: String },
    /// The physics file is refused.
    #[error(transparent)]
    Physics(#[from] crate::physics::ModelError),
    /// The discovered model is refused.
    #[error(transparent)]
    Discovered(#[from] discovery::file::FileError),
    /// The fitted model is refused.
    #[error(transparent)]
    Fitted(#[from] crate::physics::fitted::FileError),
    /// The trained model is refused.
    #[error(transparent)]
    Network(#[from] ModelFileError),
    /// The blob is refused.
    #[error("{}: is no usable blob: {problem}; make it again with `catheter export`", path.display())]
    Blob { path: PathBuf, problem: String },
    /// A part of the model is out of its domain.
    #[error("{}: cannot be run: {problem}; train or identify the model again", path.display())]
    Invalid { path: PathBuf, problem: String },
    /// Another quantity or unit.
    #[error(
        "{}: the {side} is {} in {}, but the model {} was made for {} in {}; use a model of this rig, or other --columns",
        recording.display(), found.quantity, found.unit, model.display(), wanted.quantity, wanted.unit
    )]
    Signal { recording: PathBuf, model: PathBuf, side: &'static str, wanted: Signal, found: Signal },
    /// Fewer inputs, or others.
    #[error(
        "{}: has {found} input(s), but the model {} has {wanted} and lacks {missing}; say which column it is, with `{role}=` in --columns",
        recording.display(), model.display()
    )]
    Inputs { recording: PathBuf, model: PathBuf, wanted: usize, found: usize, missing: String, role: String },
    /// Another sample period.
    #[error(
        "{}: has a sample every {} ms, but the model {} was made for {} ms; record at the model's rate, train at this rate, or interpolate with --resample",
        recording.display(), milliseconds(*recording_s), model.display(), milliseconds(*model_s)
    )]
    Period { recording: PathBuf, model: PathBuf, model_s: f64, recording_s: f64 },
}

fn milliseconds(period_s: f64) -> f64 {
    (period_s * 1e6).round() / 1e3
}
