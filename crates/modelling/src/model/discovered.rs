//! A model that discovery wrote: play operators and named effects, in `f64`.

use std::path::Path;

use super::error::ModelError;
use super::predictor::{Arithmetic, Description, Predictor};
use discovery::file::DiscoveredModel;
use recording::simulation::Context;

/// A discovered model, checked.
pub struct DiscoveredPredictor {
    model: DiscoveredModel,
    description: Description,
}

impl DiscoveredPredictor {
    /// Reads and checks a discovered model.
    ///
    /// # Errors
    /// When it cannot be read or makes no sense.
    pub fn load(path: &Path) -> Result<Self, ModelError> {
        let model = DiscoveredModel::read(path)?;
        let invalid = |problem: String| ModelError::Invalid { path: path.into(), problem };
        let values = toml::Value::try_from(&model).map_err(|error| invalid(error.to_string()))?;
        match not_finite(&values) {
            Some(key) => Err(invalid(format!("`{key}` is not finite; make it again with `catheter discover`"))),
            None => Ok(Self::new(model, path)),
        }
    }

    /// A model as it is, under a name.
    #[must_use]
    pub fn new(model: DiscoveredModel, path: &Path) -> Self {
        let effects: Vec<&str> = model.effects.iter().map(|effect| effect.name.as_str()).collect();
        let kind = format!(
            "Prandtl-Ishlinskii, {} operators{}",
            model.thresholds.len(),
            effects.iter().map(|name| format!(" + {name}")).collect::<String>()
        );
        let description = Description {
            path: path.into(),
            kind,
            arithmetic: Arithmetic::Physics,
            input: model.input.clone(),
            more_inputs: model.others.iter().map(|other| other.signal.clone()).collect(),
            output: model.output.clone(),
            input_range: None,
            sample_period_s: (!model.effects.is_empty()).then_some(model.sample_period_s),
            parameters: model.parameters(),
            macs_per_step: model.parameters(),
        };
        Self { model, description }
    }

    /// The model itself.
    #[must_use]
    pub fn model(&self) -> &DiscoveredModel {
        &self.model
    }
}

/// The key of a number that is none or infinite. Intervals are for people and may be open.
fn not_finite(value: &toml::Value) -> Option<String> {
    match value {
        toml::Value::Float(number) => (!number.is_finite()).then(String::new),
        toml::Value::Array(values) => values.iter().find_map(not_finite),
        toml::Value::Table(table) => (table.iter().filter(|(key, _)| *key != "intervals"))
            .find_map(|(key, value)| not_finite(value).map(|inner| if inner.is_empty() { key.clone() } else { format!("{key}.{inner}") })),
        _ => None,
    }
}

impl Predictor for DiscoveredPredictor {
    fn description(&self) -> &Description {
        &self.description
    }

    fn predict(&self, input: &[f64], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        let bounds: Vec<usize> = std::iter::once(0).chain(gaps.iter().copied()).chain(std::iter::once(input.len())).collect();
        let stretches = bounds.windows(2).map(|bound| self.model.simulate(&input[bound[0]..bound[1]]));
        Ok(stretches.collect::<Result<Vec<_>, _>>().map_err(|problem| self.invalid(problem))?.concat())
    }

    fn simulate(&self, inputs: &[&[f64]], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        if inputs.len() > 1 { self.simulate_in(&Context::default(), inputs, gaps) } else { self.predict(inputs[0], gaps) }
    }

    fn simulate_in(&self, context: &Context<'_>, inputs: &[&[f64]], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        self.model.simulate_stretches(context, inputs, gaps).map_err(|problem| self.invalid(problem))
    }
}

impl DiscoveredPredictor {
    fn invalid(&self, problem: String) -> ModelError {
        ModelError::Invalid { path: self.description.path.clone(), problem }
    }
}
