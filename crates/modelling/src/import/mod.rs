//! Networks trained elsewhere: PyTorch and Keras states as safetensors, ONNX graphs.
//!
//! [`read`] finds the LSTM, GRU and dense layers in a file and puts their weights into our gate order; [`Found::model`] joins them
//! with what weights do not tell ([`Options`]) into a [`TrainedModel`]. What the model has no place for is refused by its name; nothing
//! is guessed. [`CheckVectors`] then show whether the model computes what the framework did.

mod assemble;
mod check;
mod error;
mod keras;
mod onnx;
pub mod options;
mod source;
mod tensors;
mod torch;

#[cfg(test)]
mod tests;

use std::path::Path;

pub use check::{CheckVectors, PARITY, Parity};
pub use error::ImportError;
pub use options::Options;
pub use source::SourceNetwork;

use crate::network::TrainedModel;
use tensors::State;

/// Largest file that is read: a hundred times what the largest network that fits takes.
const MOST_BYTES: u64 = 1 << 26;

/// A network that was found, and all that is known about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Layers and output.
    pub network: SourceNetwork,
    /// What was said, on the command line or in the file.
    pub options: Options,
    /// What a reader should know.
    pub notes: Vec<String>,
}

/// Reads the file at `path`; `options` go before what the file says.
///
/// # Errors
/// When it cannot be read, is too large, or as [`from_bytes`].
pub fn read(path: &Path, options: Options) -> Result<Found, ImportError> {
    let open = |error: std::io::Error| ImportError::Open { message: error.to_string() };
    let bytes = std::fs::metadata(path).map_err(open)?.len();
    if bytes > MOST_BYTES {
        return Err(ImportError::TooLarge { bytes, most: MOST_BYTES });
    }
    from_bytes(&output::read(path).map_err(open)?, options)
}

/// Finds the network in the bytes of a file.
///
/// # Errors
/// When they are damaged, or hold what cannot be represented.
pub fn from_bytes(bytes: &[u8], options: Options) -> Result<Found, ImportError> {
    refuse_other_formats(bytes)?;
    // A safetensors file starts with the length of its header and the brace that opens it.
    let (network, options, mut notes) = if bytes.get(8) == Some(&b'{') {
        let state = State::from_safetensors(bytes)?;
        if state.metadata.contains_key("catheter-model") {
            return Err(ImportError::Format { message: "already a model of this tool; `catheter export` takes it as it is".to_owned() });
        }
        let (options, notes) = options.over(Options::from_metadata(&state.metadata)?);
        (from_state(&state, &options)?, options, notes)
    } else {
        let (network, metadata) = onnx::read(bytes)?;
        let (options, notes) = options.over(Options::from_metadata(&metadata)?);
        (network, options, notes)
    };
    notes.extend(network.notes.iter().cloned());
    Ok(Found { network, options, notes })
}

/// Files that people have at hand instead, by how they start.
fn refuse_other_formats(bytes: &[u8]) -> Result<(), ImportError> {
    let known: [(&[u8], &str); 3] = [
        (b"PK\x03\x04", "a ZIP archive, as PyTorch (.pt) and Keras (.keras) write it, which can hold programs"),
        (b"\x89HDF", "an HDF5 file, as Keras (.h5) writes it"),
        (b"\x80", "a Python pickle, which can hold programs"),
    ];
    if bytes.is_empty() {
        return Err(ImportError::Format { message: "the file is empty; save the network again".to_owned() });
    }
    match known.iter().find(|(start, _)| bytes.starts_with(start) && bytes.get(8) != Some(&b'{')) {
        Some((_, what)) => {
            Err(ImportError::Format { message: format!("{what}; save the weights as safetensors, for example with the Python helper") })
        }
        None => Ok(()),
    }
}

fn from_state(state: &State, options: &Options) -> Result<SourceNetwork, ImportError> {
    // A Keras state has no `weight`, and a PyTorch state no `kernel`.
    if keras::is_state(state) {
        return keras::read(state, options);
    }
    if torch::is_state(state) {
        return torch::read(state, options);
    }
    let names: Vec<&str> = state.tensors.keys().map(String::as_str).collect();
    let some = names.iter().take(4).copied().collect::<Vec<_>>().join("`, `");
    Err(ImportError::refuse(
        format!("a state without a layer (its tensors are `{some}`{})", if names.len() > 4 { " and others" } else { "" }),
        "names such as `weight_ih_l0` and `weight` (PyTorch) or `recurrent_kernel` and `kernel` (Keras) are wanted; save the state of the trained network",
    ))
}

impl Found {
    /// The model; ranges that were not given are taken from the check vectors. The notes grow by what was taken from where.
    ///
    /// # Errors
    /// What is not known, or does not fit.
    pub fn model(&mut self, check: Option<&CheckVectors>) -> Result<TrainedModel, ImportError> {
        assemble::assemble(&self.network, &self.options, check, &mut self.notes)
    }
}
