//! What a model says of itself, and how it is run.

use std::path::PathBuf;

use serde::Serialize;

use super::error::ModelError;
use recording::Signal;
use recording::simulation::Context;

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

/// Whether there are as many inputs as a model has.
pub(super) fn enough(model: &Description, inputs: &[&[f64]]) -> Result<(), ModelError> {
    let wanted = 1 + model.more_inputs.len();
    if inputs.len() < wanted {
        let problem = format!("it has {wanted} inputs and was given {}", inputs.len());
        return Err(ModelError::Invalid { path: model.path.clone(), problem });
    }
    Ok(())
}
