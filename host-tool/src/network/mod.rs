//! The f32 LSTM: architecture, forward pass, backpropagation through time, weights on disk.
//!
//! A [`TrainedModel`] is a front end (physics, see [`model_export::schema`]) and, usually, a [`Network`] that corrects it. One layer
//! computes, with `x` its input, `h` its hidden state and `c` its cell state,
//!
//! ```text
//! z   = W_x x + W_h h + b                 rows in gate order i, f, g, o, one row per unit in each
//! i,f,o = sigmoid(z)      g = act(z)
//! c  := clamp(f*c + i*g, -limit, limit)   limit: the state limit
//! h  := o * act(c)
//! y   = w . h_last + b                    after the last layer; added to the front end's linear readout
//! ```
//!
//! `act` is one of [`Activation`]. Everything is normalised: the input by the input channel, the output by the output channel.

mod activation;
mod file;
mod parameters;
pub(crate) mod product;
mod run;
mod sequence;
mod step;

use model_export::schema;
use serde::{Deserialize, Serialize};

pub use file::{FORMAT_VERSION, ModelFileError, from_bytes, load, save, to_bytes};
pub use parameters::{Architecture, LayerLayout, Layout};
pub use run::{Runner, limit_feature, window_sample};
pub use sequence::Sequence;
pub use step::NetworkState;

/// The cell activation, used for the candidate and for the cell output; gates are always sigmoid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// Hyperbolic tangent.
    Tanh,
    /// `clamp(x, 0, state_limit)`: the paper's Table I, clipped because the unclipped form diverges.
    Relu,
    /// `clamp(x, -1, 1)`.
    Hard,
}

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

/// Weights of one LSTM layer; matrices are row-major, rows in gate order i, f, g, o.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Width of the input.
    pub inputs: usize,
    /// Hidden units.
    pub units: usize,
    /// `W_x`, `4 * units` rows of `inputs`.
    pub input_weights: Vec<f32>,
    /// `W_h`, `4 * units` rows of `units`.
    pub recurrent_weights: Vec<f32>,
    /// `b`, `4 * units`.
    pub bias: Vec<f32>,
}

impl Layer {
    /// A layer of zeros.
    #[must_use]
    pub fn zeros(inputs: usize, units: usize) -> Self {
        Self {
            inputs,
            units,
            input_weights: vec![0.0; 4 * units * inputs],
            recurrent_weights: vec![0.0; 4 * units * units],
            bias: vec![0.0; 4 * units],
        }
    }

    /// Number of weights and biases.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.input_weights.len() + self.recurrent_weights.len() + self.bias.len()
    }
}

/// LSTM layers and the dense output.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// Cell activation of every layer.
    pub activation: Activation,
    /// Bound of |c|, and the cap of the relu; positive.
    pub state_limit: f32,
    /// First layer first; the first layer's input is the front end's features.
    pub layers: Vec<Layer>,
    /// Weights of the dense output, one per unit of the last layer.
    pub dense_weights: Vec<f32>,
    /// Bias of the dense output.
    pub dense_bias: f32,
}

impl Network {
    /// A network of zeros with the given layer widths.
    #[must_use]
    pub fn zeros(features: usize, units: &[usize], activation: Activation, state_limit: f32) -> Self {
        let mut inputs = features;
        let mut layers = Vec::with_capacity(units.len());
        for &width in units {
            layers.push(Layer::zeros(inputs, width));
            inputs = width;
        }
        Self { activation, state_limit, layers, dense_weights: vec![0.0; inputs], dense_bias: 0.0 }
    }

    /// Width of the first layer's input.
    #[must_use]
    pub fn features(&self) -> usize {
        self.layers.first().map_or(0, |layer| layer.inputs)
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

#[cfg(test)]
mod tests;
