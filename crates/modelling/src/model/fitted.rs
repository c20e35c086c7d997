//! A model of `catheter fit`: weighted sums of columns, in `f64`.

use std::path::Path;

use super::error::ModelError;
use super::predictor::{Arithmetic, Description, Predictor};
use crate::physics::{ChannelRange, FittedModel};

/// A fitted model that runs.
pub struct FittedPredictor {
    model: FittedModel,
    description: Description,
}

impl FittedPredictor {
    /// Reads and checks a model file.
    ///
    /// # Errors
    /// As [`FittedModel::read`].
    pub fn load(path: &Path) -> Result<Self, ModelError> {
        Ok(Self::new(FittedModel::read(path)?, path))
    }

    /// Takes a model; `path` is its name.
    #[must_use]
    pub fn new(model: FittedModel, path: &Path) -> Self {
        let description = describe(&model, path);
        Self { model, description }
    }

    /// The model itself.
    #[must_use]
    pub fn model(&self) -> &FittedModel {
        &self.model
    }
}

impl Predictor for FittedPredictor {
    fn description(&self) -> &Description {
        &self.description
    }

    fn predict(&self, input: &[f64], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        self.simulate(&[input], gaps)
    }

    fn simulate(&self, inputs: &[&[f64]], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        let wanted = self.model.inputs.len();
        if inputs.len() < wanted {
            let problem = format!("it has {wanted} inputs and was given {}", inputs.len());
            return Err(ModelError::Invalid { path: self.description.path.clone(), problem });
        }
        Ok(self.model.simulate(inputs, gaps))
    }
}

/// What a fitted model was made for, under a name.
fn describe(model: &FittedModel, path: &Path) -> Description {
    let names: Vec<&str> = model.members.iter().map(|member| member.name.as_str()).collect();
    let kind = if names.len() > 1 { format!("mean of {}", names.join(", ")) } else { names.concat() };
    let first = &model.inputs[0];
    Description {
        path: path.into(),
        kind,
        arithmetic: Arithmetic::Physics,
        input: first.signal(),
        more_inputs: model.inputs[1..].iter().map(ChannelRange::signal).collect(),
        output: model.output.signal(),
        input_range: Some((first.minimum, first.maximum)),
        sample_period_s: Some(model.sample_period_s),
        parameters: model.members.iter().map(|member| member.model.parameters()).sum(),
        macs_per_step: model.members.iter().map(|member| member.model.multiplications()).sum(),
    }
}
