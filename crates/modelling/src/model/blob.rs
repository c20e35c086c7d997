//! The model as it lies in flash, run by the microcontroller's own code.

use std::path::Path;

use firmware::estimator::{Estimator, EstimatorState, GoldenReplay};
use model_export::blob;
use model_export::schema::{Activation, Cell, Mode, Model};

use super::error::ModelError;
use super::predictor::{Arithmetic, Description, Predictor, enough};
use crate::network::narrowed;
use recording::Signal;

/// A blob, checked.
pub struct BlobModel {
    bytes: Vec<u8>,
    description: Description,
}

impl BlobModel {
    /// Reads and checks a blob.
    ///
    /// # Errors
    /// When it cannot be read, is damaged or of another schema.
    pub fn load(path: &Path) -> Result<Self, ModelError> {
        let bytes = output::read(path).map_err(|error| ModelError::Open { path: path.into(), problem: error.to_string() })?;
        Self::new(bytes, path)
    }

    /// Checks the bytes of a blob; `path` is its name.
    ///
    /// # Errors
    /// When they are damaged or of another schema.
    pub fn new(bytes: Vec<u8>, path: &Path) -> Result<Self, ModelError> {
        let description = with(&bytes, path, |model, _| describe(model, path))?;
        Ok(Self { bytes, description })
    }

    /// The bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Replays the golden vectors that the blob carries, as the microcontroller does before it trusts the model.
    ///
    /// # Errors
    /// Never for a blob that was checked.
    pub fn replay(&self) -> Result<GoldenReplay, ModelError> {
        with(&self.bytes, &self.description.path, |model, estimator| estimator.replay(&model.golden))
    }
}

/// Reading a blob copies nothing, so it is read again for each use instead of holding a reference to ourselves.
fn with<T>(bytes: &[u8], path: &Path, work: impl FnOnce(&Model<'_>, &Estimator<'_>) -> T) -> Result<T, ModelError> {
    let refused = |problem: String| ModelError::Blob { path: path.into(), problem };
    let model = blob::decode(bytes).map_err(|error| refused(error.to_string()))?.model;
    let estimator = Estimator::new(&model).map_err(|invalid| refused(invalid.to_string()))?;
    Ok(work(&model, &estimator))
}

fn describe(model: &Model<'_>, path: &Path) -> Description {
    let signal = |channel: &model_export::schema::Channel<'_>| Signal { quantity: channel.quantity.into(), unit: channel.unit.into() };
    let layers = model.network.as_ref().map(|network| &network.layers[..]).unwrap_or_default();
    let (mut macs, mut biases) = (0, 0);
    for layer in layers {
        macs += layer.input_weights.len() + layer.recurrent_weights.len();
        biases += layer.biases.len() / 8;
    }
    if let Some(last) = layers.last() {
        macs += usize::from(last.units);
        biases += 1;
    }
    let front = super::trained::front_end_parameters(&model.front_end);
    let cells: Vec<(Cell, usize)> = layers.iter().map(|layer| (layer.cell, usize::from(layer.units))).collect();
    let activation = model.network.as_ref().and_then(|network| network.activation().ok()).unwrap_or(Activation::Tanh);
    let window = match model.mode {
        Mode::Streaming => 1,
        Mode::Window { length } => usize::from(length),
    };
    Description {
        path: path.into(),
        kind: format!("{}, fixed point", super::trained::kind(&model.front_end, &cells, activation, window)),
        arithmetic: Arithmetic::FixedPoint,
        input: signal(&model.input),
        more_inputs: model.more_inputs.iter().map(signal).collect(),
        output: signal(&model.output),
        input_range: Some((f64::from(model.input.minimum), f64::from(model.input.maximum))),
        sample_period_s: Some(f64::from(model.sample_period_s)),
        parameters: macs + biases + front,
        macs_per_step: macs * window + front,
    }
}

impl Predictor for BlobModel {
    fn description(&self) -> &Description {
        &self.description
    }

    fn predict(&self, input: &[f64], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        self.simulate(&[input], gaps)
    }

    fn simulate(&self, inputs: &[&[f64]], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        enough(&self.description, inputs)?;
        with(&self.bytes, &self.description.path, |_, estimator| {
            let mut state = EstimatorState::default();
            let mut gaps = gaps.iter().peekable();
            let step = |index| {
                if gaps.next_if(|&&gap| gap == index).is_some() {
                    state.reset();
                }
                f64::from(estimator.step_all(&mut state, &narrowed(inputs, index)).value)
            };
            (0..inputs[0].len()).map(step).collect()
        })
    }
}
