//! What a trained model is made of: channels, layers, front end, and where it came from.

use firmware::estimator::FrontEnd;
use model_export::schema::{self, Activation, Cell};
use model_export::validate::Invalid;
use serde::{Deserialize, Serialize};

/// How the network meets time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The state is carried from sample to sample.
    Streaming,
    /// Each output comes from the last `length` samples, from zero state, as in the paper.
    Window {
        /// Samples in the window.
        length: usize,
    },
}

/// One physical channel with its map to the normalised form, `normalised = (value - offset) / scale`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Channel {
    /// Quantity, for example `pressure`.
    pub quantity: String,
    /// Unit, for example `bar`.
    pub unit: String,
    /// Value that maps to zero.
    pub offset: f32,
    /// Span that maps to one; positive.
    pub scale: f32,
    /// Smallest value seen in training.
    pub minimum: f32,
    /// Largest value seen in training.
    pub maximum: f32,
}

impl Channel {
    /// The same channel as the wire type of the blob.
    #[must_use]
    pub fn as_wire(&self) -> schema::Channel<'_> {
        schema::Channel {
            quantity: &self.quantity,
            unit: &self.unit,
            offset: self.offset,
            scale: self.scale,
            minimum: self.minimum,
            maximum: self.maximum,
        }
    }
}

/// Weights of one layer; matrices are row-major, rows in the order of [`Cell::gates`].
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// What it computes.
    pub cell: Cell,
    /// Width of the input.
    pub inputs: usize,
    /// Hidden units.
    pub units: usize,
    /// `W_x`, rows of `inputs`.
    pub input_weights: Vec<f32>,
    /// `W_h`, rows of `units`.
    pub recurrent_weights: Vec<f32>,
    /// `b`, one a gate and unit.
    pub bias: Vec<f32>,
}

impl Layer {
    /// A layer of zeros.
    #[must_use]
    pub fn zeros(cell: Cell, inputs: usize, units: usize) -> Self {
        Self {
            cell,
            inputs,
            units,
            input_weights: vec![0.0; cell.input_rows() * units * inputs],
            recurrent_weights: vec![0.0; cell.recurrent_rows() * units * units],
            bias: vec![0.0; cell.gates().len() * units],
        }
    }

    /// Number of weights and biases.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.input_weights.len() + self.recurrent_weights.len() + self.bias.len()
    }
}

/// Layers and the dense output.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// Activation of every recurrent layer.
    pub activation: Activation,
    /// Bound of |c|, and the cap of the relu in recurrent layers; positive.
    pub state_limit: f32,
    /// First layer first; the first layer's input is the front end's features.
    pub layers: Vec<Layer>,
    /// Weights of the dense output, one per unit of the last layer.
    pub dense_weights: Vec<f32>,
    /// Bias of the dense output.
    pub dense_bias: f32,
}

impl Network {
    /// A network of zeros with LSTM layers of the given widths.
    #[must_use]
    pub fn zeros(features: usize, units: &[usize], activation: Activation, state_limit: f32) -> Self {
        let mut inputs = features;
        let mut layers = Vec::with_capacity(units.len());
        for &width in units {
            layers.push(Layer::zeros(Cell::Lstm, inputs, width));
            inputs = width;
        }
        Self { activation, state_limit, layers, dense_weights: vec![0.0; inputs], dense_bias: 0.0 }
    }

    /// Width of the first layer's input.
    #[must_use]
    pub fn features(&self) -> usize {
        self.layers.first().map_or(0, |layer| layer.inputs)
    }

    /// Whether all layers are LSTM, which is what training and its batched passes know.
    #[must_use]
    pub fn is_lstm(&self) -> bool {
        self.layers.iter().all(|layer| layer.cell == Cell::Lstm)
    }

    /// The layers in words, as [`described`].
    #[must_use]
    pub fn described(&self) -> String {
        described(self.layers.iter().map(|layer| (layer.cell, layer.units)), self.activation)
    }

    /// Number of weights and biases.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.layers.iter().map(Layer::parameters).sum::<usize>() + self.dense_weights.len() + 1
    }

    /// Multiply-accumulates of one forward step: one per weight, biases not counted.
    #[must_use]
    pub fn macs_per_step(&self) -> usize {
        self.layers.iter().map(|layer| layer.input_weights.len() + layer.recurrent_weights.len()).sum::<usize>() + self.dense_weights.len()
    }
}

/// Layers in words: `LSTM of 64 + 64 units (tanh)`, `GRU of 32 units (tanh), dense of 16 units (relu)`.
#[must_use]
pub fn described(layers: impl Iterator<Item = (Cell, usize)>, activation: Activation) -> String {
    let mut groups: Vec<(Cell, Vec<String>)> = Vec::new();
    for (cell, units) in layers {
        match groups.last_mut() {
            Some((last, widths)) if *last == cell => widths.push(units.to_string()),
            _ => groups.push((cell, vec![units.to_string()])),
        }
    }
    let group = |(cell, widths): &(Cell, Vec<String>)| {
        format!("{} of {} units ({})", cell.name(), widths.join(" + "), cell.activation(activation).name())
    };
    groups.iter().map(group).collect::<Vec<_>>().join(", ")
}

/// Where a model came from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Name of the training preset.
    pub preset: String,
    /// Seed of every random choice.
    pub seed: u64,
    /// Version of the tool that trained.
    pub tool_version: String,
    /// SHA-256 of the training samples, lower-case hexadecimal.
    pub training_data_sha256: String,
    /// Recordings trained on.
    pub training_recordings: usize,
    /// Optimiser steps made.
    pub optimiser_steps: u64,
    /// Root mean square error on the validation part, free running, in output units.
    pub validation_rmse: f64,
}

/// A model as trained: front end, network, and what is needed to run them on raw samples.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainedModel {
    /// The input channel.
    pub input: Channel,
    /// The channels of the inputs beside the first.
    pub more_inputs: Vec<Channel>,
    /// The output channel.
    pub output: Channel,
    /// Time between samples in s.
    pub sample_period_s: f64,
    /// Streaming or window.
    pub mode: Mode,
    /// The physics part and the features the network sees.
    pub front_end: schema::FrontEnd,
    /// The correction; absent when physics alone suffices.
    pub network: Option<Network>,
    /// Where the model came from.
    pub provenance: Provenance,
}

impl TrainedModel {
    /// The channels of all inputs.
    pub fn inputs(&self) -> impl Iterator<Item = &Channel> {
        std::iter::once(&self.input).chain(&self.more_inputs)
    }

    /// The front end, ready to run.
    ///
    /// # Errors
    /// When it is out of its domain.
    pub fn built_front_end(&self) -> Result<FrontEnd, Invalid> {
        built(&self.front_end, &self.input, &self.more_inputs)
    }
}

/// A front end between channels, ready to run.
///
/// # Errors
/// When it is out of its domain.
pub fn built(front_end: &schema::FrontEnd, input: &Channel, more_inputs: &[Channel]) -> Result<FrontEnd, Invalid> {
    let more: Vec<_> = more_inputs.iter().map(Channel::as_wire).collect();
    FrontEnd::new(front_end, &input.as_wire(), &more)
}

/// One sample of several inputs as the estimator takes it.
#[must_use]
pub fn narrowed(inputs: &[&[f64]], sample: usize) -> Vec<f32> {
    #[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
    inputs.iter().map(|values| values[sample] as f32).collect()
}
