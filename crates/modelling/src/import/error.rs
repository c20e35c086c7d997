//! Why a network was not imported; every message says what it met and what to do.

/// Why a network was not imported.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what each field is")]
pub enum ImportError {
    /// The file cannot be read.
    #[error("cannot be read ({message}); check the path and its permissions")]
    Open { message: String },
    /// The file is far larger than any network that fits.
    #[error(
        "{bytes} bytes, at most {most} are read: a network that fits the microcontroller has less than one million; save only the weights"
    )]
    TooLarge { bytes: u64, most: u64 },
    /// Neither safetensors nor ONNX.
    #[error("{message}")]
    Format { message: String },
    /// A part of the network that our model has no place for.
    #[error("{what} cannot be represented: {remedy}")]
    NotRepresentable { what: String, remedy: String },
    /// A tensor that is missing, of a wrong type or of a wrong shape.
    #[error("tensor `{tensor}`: {problem}")]
    Tensor { tensor: String, problem: String },
    /// Something that weights do not tell and nobody said.
    #[error("{what} is not known; give {option}, or save the network with the Python helper, which writes it into the file")]
    Unknown { what: &'static str, option: &'static str },
    /// An option or a metadata entry that makes no sense.
    #[error("{name}: {problem}")]
    Value { name: String, problem: String },
    /// The check vectors cannot be used.
    #[error("check vectors: {problem}")]
    Check { problem: String },
}

impl ImportError {
    /// [`ImportError::NotRepresentable`].
    pub fn refuse(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::NotRepresentable { what: what.into(), remedy: remedy.into() }
    }

    /// [`ImportError::Tensor`].
    pub fn tensor(tensor: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Tensor { tensor: tensor.into(), problem: problem.into() }
    }
}
