//! A trained network with its front end, in `f32`.

use std::path::Path;

use model_export::schema::{FrontEnd, Stages};

use super::error::ModelError;
use super::predictor::{Arithmetic, Description, Predictor, enough};
use crate::network::{self, Activation, Cell, Channel, Mode, TrainedModel, described};
use recording::Signal;

/// A trained model, checked.
pub struct NetworkModel {
    model: TrainedModel,
    description: Description,
}

impl NetworkModel {
    /// Reads and checks a trained model.
    ///
    /// # Errors
    /// When it cannot be read, is damaged, of another version, or out of its domain.
    pub fn load(path: &Path) -> Result<Self, ModelError> {
        Self::new(network::load(path)?, path)
    }

    /// Checks a trained model; `path` is its name.
    ///
    /// # Errors
    /// When its front end is out of its domain.
    pub fn new(model: TrainedModel, path: &Path) -> Result<Self, ModelError> {
        model.runner().map_err(|invalid| ModelError::Invalid { path: path.into(), problem: invalid.to_string() })?;
        let description = describe(&model, path);
        Ok(Self { model, description })
    }

    /// The model itself.
    #[must_use]
    pub fn model(&self) -> &TrainedModel {
        &self.model
    }
}

/// Fitted numbers of a front end: every one of them costs about one multiplication a step.
pub(super) fn front_end_parameters(front_end: &FrontEnd) -> usize {
    // Without plays, creep or readout weight the front end only prepares features and nothing in it was fitted.
    let linear = front_end.play_weights.len() + front_end.creep_weights.len();
    let curve = front_end.curve.as_ref().map_or(0, |curve| 2 + curve.bends.len());
    let stages = front_end.stages.as_ref().map_or(0, stage_parameters);
    if linear == 0 && front_end.input_weight == 0.0 { 0 } else { linear + front_end.play_thresholds.len() + 2 + curve + stages }
}

/// Numbers of the further stages.
fn stage_parameters(stages: &Stages) -> usize {
    let growth = stages.growth.as_ref();
    let flow = stages.flow.iter().flat_map(|flow| [&flow.fill, &flow.vent]);
    let of_operators = growth.into_iter().flat_map(|growth| std::iter::once(&growth.law).chain(&growth.follow));
    let curves = stages.supply.iter().chain(&stages.muscle).chain(flow).chain(of_operators);
    let bends: usize = curves.map(|curve| 2 + 2 * curve.bends.len()).sum();
    bends + 4 * [stages.line, stages.tip].iter().flatten().count() + 8 * usize::from(growth.is_some())
}

/// What a front end with a network of these layers is, in words; `window` is the length of its window, 1 for streaming.
pub(super) fn kind(front_end: &FrontEnd, layers: &[(Cell, usize)], activation: Activation, window: usize) -> String {
    let network = match layers {
        [] => None,
        [(_, first), ..] => {
            let time = if window > 1 { format!("window of {window}") } else { "streaming".to_owned() };
            Some(if layers.iter().all(|(cell, _)| *cell == Cell::Lstm) {
                format!("LSTM {}x{first}, {time}", layers.len())
            } else {
                format!("{}, {time}", described(layers.iter().copied(), activation))
            })
        }
    };
    let operators = front_end.play_thresholds.len();
    let further = if front_end.stages.is_some() { " with further stages" } else { "" };
    let physics = (front_end_parameters(front_end) > 0).then(|| format!("{operators} play operators{further}"));
    match (physics, network) {
        (Some(physics), Some(network)) => format!("hybrid: {physics} and {network}"),
        (Some(physics), None) => format!("{physics}, no network"),
        (None, Some(network)) => network,
        (None, None) => "constant".to_owned(),
    }
}

fn describe(model: &TrainedModel, path: &Path) -> Description {
    let signal = |channel: &Channel| Signal { quantity: channel.quantity.clone(), unit: channel.unit.clone() };
    let front = front_end_parameters(&model.front_end);
    let (weights, macs) = model.network.as_ref().map_or((0, 0), |network| (network.parameters(), network.macs_per_step()));
    let steps = match model.mode {
        Mode::Streaming => 1,
        Mode::Window { length } => length,
    };
    Description {
        path: path.into(),
        kind: kind(
            &model.front_end,
            &model.network.iter().flat_map(|network| &network.layers).map(|layer| (layer.cell, layer.units)).collect::<Vec<_>>(),
            model.network.as_ref().map_or(Activation::Tanh, |network| network.activation),
            steps,
        ),
        arithmetic: Arithmetic::Float,
        input: signal(&model.input),
        more_inputs: model.more_inputs.iter().map(signal).collect(),
        output: signal(&model.output),
        input_range: Some((f64::from(model.input.minimum), f64::from(model.input.maximum))),
        sample_period_s: Some(model.sample_period_s),
        parameters: weights + front,
        macs_per_step: macs * steps + front,
    }
}

impl Predictor for NetworkModel {
    fn description(&self) -> &Description {
        &self.description
    }

    fn predict(&self, input: &[f64], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        self.simulate(&[input], gaps)
    }

    fn simulate(&self, inputs: &[&[f64]], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        enough(&self.description, inputs)?;
        let invalid = |invalid: model_export::validate::Invalid| ModelError::Invalid {
            path: self.description.path.clone(),
            problem: invalid.to_string(),
        };
        self.model.predict(inputs, gaps).map_err(invalid)
    }
}
