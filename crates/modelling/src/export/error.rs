//! What can be wrong with a model or its data.

use model_export::blob::BlobError;
use model_export::quantise::QuantiseError;

use crate::physics;

/// Why a model cannot be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// No sample to calibrate with.
    #[error("the calibration data hold no samples; give recordings like those the model was trained on")]
    NoData,
    /// A recording of other quantities than the model's.
    #[error(
        "{path}: the {channel} is {found}, the model's is {expected}; give recordings of the model's quantities, with --columns if need be"
    )]
    Signal {
        /// The recording.
        path: String,
        /// `input` or `output`.
        channel: &'static str,
        /// What the recording has.
        found: String,
        /// What the model has.
        expected: String,
    },
    /// A recording with fewer inputs than the model has.
    #[error("{path}: has {found} input(s), the model has {expected}; name the others with `input2=`, `input3=` in --columns")]
    Inputs {
        /// The recording.
        path: String,
        /// Inputs of the recording.
        found: usize,
        /// Inputs of the model.
        expected: usize,
    },
    /// A recording at another rate than the model's.
    #[error("{path}: sample period {found} s, the model's is {expected} s; resample the recording")]
    SamplePeriod {
        /// The recording.
        path: String,
        /// The recording's.
        found: f64,
        /// The model's.
        expected: f64,
    },
    /// The network has no fixed-point form.
    #[error("the network cannot be quantised: {0}")]
    Quantise(#[from] QuantiseError),
    /// The model does not fit the schema.
    #[error("the model cannot be written as a blob: {0}")]
    Blob(#[from] BlobError),
    /// A fitted model with parts that the front end lacks.
    #[error(
        "the microcontroller has no form for `{name}`; take the `model.blob` beside it, or a rung that has one. Play operators that start elsewhere in each recording have none: record from rest"
    )]
    NoForm {
        /// The rung.
        name: String,
    },
    /// A physics model that the front end cannot represent.
    #[error(transparent)]
    Physics(#[from] physics::ModelError),
    /// A window longer than the schema's counter.
    #[error("a window of {length} samples is too long for a blob; train with a shorter one")]
    Window {
        /// Samples in the window.
        length: usize,
    },
}
