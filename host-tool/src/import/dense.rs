//! What is refused of dense layers, in the same words for every framework.

use super::ImportError;

/// Two dense layers: what lies between them is not in the weights.
#[must_use]
pub fn two_dense(first: &str, second: &str) -> ImportError {
    ImportError::refuse(
        format!("a network with the two dense layers `{first}` and `{second}`"),
        "one dense output after the LSTM layers fits; train without the others",
    )
}

/// Checks that a dense layer has one output.
///
/// # Errors
/// For any number of outputs but one.
pub fn one_output(name: &str, outputs: usize) -> Result<(), ImportError> {
    if outputs == 1 {
        return Ok(());
    }
    Err(ImportError::refuse(
        format!("`{name}`, a dense layer of {outputs} outputs,"),
        "the model has one output; train one network for each, or one with a single output",
    ))
}

/// A network of dense layers only.
#[must_use]
pub fn no_memory(names: &[&str]) -> ImportError {
    ImportError::refuse(
        format!("a network of dense layers only (`{}`)", names.join("`, `")),
        "it has no memory of its own, or gets it from a window of past samples, which the firmware does not feed to dense layers; \
         train an LSTM, or use `catheter identify` for a curve without memory",
    )
}
