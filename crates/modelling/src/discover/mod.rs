//! Discovery in the command's terms. The method itself is the crate `discovery`, which is here under this name; beside it stand what writes
//! its results to files, what takes a found model to the microcontroller, the plan of the next experiment and the corpus of hidden cases.

pub mod corpus;
pub mod folder;
pub mod physics;
pub mod plan;

pub use discovery::*;

use crate::model::{self, Predictor};
use recording::Recording;

/// Lets a simulation model that somebody already has predict every recording, to start from it; `discovered` is that model when discovery
/// wrote it.
///
/// # Errors
/// When the model was not made for the recordings or cannot be run.
pub fn start_from(
    model: &dyn Predictor,
    discovered: Option<file::DiscoveredModel>,
    recordings: &[Recording],
    kept: &[Recording],
) -> anyhow::Result<Start> {
    let mut predictions = Vec::new();
    for recording in recordings.iter().chain(kept) {
        predictions.push(model::predict(model, recording, model::Fit::default())?);
    }
    Ok(Start { predictions, discovered })
}

#[cfg(test)]
mod tests;
