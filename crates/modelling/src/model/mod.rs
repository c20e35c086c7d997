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
mod file;
mod fitted;
mod physics;
mod predictor;
mod run;
mod trained;

pub use blob::BlobModel;
pub use discovered::DiscoveredPredictor;
pub use error::ModelError;
pub use file::{Format, format, load};
pub use fitted::FittedPredictor;
pub use physics::PhysicsPredictor;
pub use predictor::{Arithmetic, Description, Predictor};
pub use recording::simulation::{Context, PERIOD_TOLERANCE};
pub use run::{Fit, Gaps, check, predict};
pub use trained::NetworkModel;

#[cfg(test)]
mod tests;
