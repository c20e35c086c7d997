//! An identified physics model, in `f64`.

use std::path::Path;

use super::error::ModelError;
use super::predictor::{Arithmetic, Description, Predictor};
use crate::physics::{Kind, PhysicsModel};
use recording::Signal;

/// A physics model, checked.
pub struct PhysicsPredictor {
    model: PhysicsModel,
    description: Description,
}

impl PhysicsPredictor {
    /// Reads and checks a physics model.
    ///
    /// # Errors
    /// When it cannot be read, is of another version or contradicts itself.
    pub fn load(path: &Path) -> Result<Self, ModelError> {
        Ok(Self::new(PhysicsModel::read(path)?, path))
    }

    /// Takes an identified model; `path` is its name.
    #[must_use]
    pub fn new(model: PhysicsModel, path: &Path) -> Self {
        let description = describe(&model, path);
        Self { model, description }
    }

    /// The model itself.
    #[must_use]
    pub fn model(&self) -> &PhysicsModel {
        &self.model
    }
}

fn describe(model: &PhysicsModel, path: &Path) -> Description {
    let path_terms = usize::from(model.input_path.dead_time_s > 0.0) + usize::from(model.input_path.lag_time_constant_s > 0.0);
    let creep = model.creep.gains.len();
    let curve = model.curve.as_ref().map_or(0, |curve| curve.slopes.len());
    let input = usize::from(model.input_gain != 0.0);
    // Play operators alone answer to the path of the input and not to its speed: they are the same at any rate.
    let depends_on_rate = path_terms + creep > 0 || model.stages.depend_on_rate();
    Description {
        path: path.into(),
        kind: format!(
            "{}, {} operators{}",
            match model.kind {
                Kind::PrandtlIshlinskii => "Prandtl-Ishlinskii",
                Kind::ModifiedPrandtlIshlinskii => "modified Prandtl-Ishlinskii",
            },
            model.thresholds.len(),
            match (path_terms > 0, model.stages.is_empty()) {
                (false, true) => "",
                (true, true) => " behind dead time and lag",
                (_, false) => " with further stages",
            }
        ),
        arithmetic: Arithmetic::Physics,
        input: Signal { quantity: model.input.quantity.clone(), unit: model.input.unit.clone() },
        more_inputs: Vec::new(),
        output: Signal { quantity: model.output.quantity.clone(), unit: model.output.unit.clone() },
        input_range: Some((model.input.minimum, model.input.maximum)),
        sample_period_s: depends_on_rate.then_some(model.sample_period_s),
        parameters: 2 * model.thresholds.len() + input + 1 + path_terms + 2 * creep + curve + model.stages.parameters(),
        macs_per_step: model.thresholds.len() + input + path_terms + 2 * creep + usize::from(curve > 0),
    }
}

impl Predictor for PhysicsPredictor {
    fn description(&self) -> &Description {
        &self.description
    }

    fn predict(&self, input: &[f64], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        let bounds: Vec<usize> = std::iter::once(0).chain(gaps.iter().copied()).chain(std::iter::once(input.len())).collect();
        Ok(bounds.windows(2).flat_map(|bound| self.model.simulate(&input[bound[0]..bound[1]])).collect())
    }
}
