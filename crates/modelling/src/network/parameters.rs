//! The weights of a network of LSTM layers as one flat vector, laid out for training.
//!
//! Order: for each layer `W_x` transposed (`inputs` rows of `4 * units`), `W_h` transposed (`units` rows of `4 * units`), `b`; then the
//! dense weights and the dense bias. Transposed, the forward products read and the weight gradients write whole rows.

use std::ops::Range;

use super::{Activation, Network};

/// Sizes and activation of a network.
#[derive(Clone, Debug, PartialEq)]
pub struct Architecture {
    /// Width of the first layer's input.
    pub features: usize,
    /// Units of each layer.
    pub units: Vec<usize>,
    /// Cell activation.
    pub activation: Activation,
    /// Bound of |c|.
    pub state_limit: f32,
}

/// Where one layer's parameters lie in the flat vector.
#[derive(Clone, Debug)]
pub struct LayerLayout {
    /// Width of the input.
    pub inputs: usize,
    /// Hidden units.
    pub units: usize,
    /// `W_x` transposed.
    pub input_weights: Range<usize>,
    /// `W_h` transposed.
    pub recurrent_weights: Range<usize>,
    /// `b`.
    pub bias: Range<usize>,
}

/// Where everything lies in the flat vector.
#[derive(Clone, Debug)]
pub struct Layout {
    /// First layer first.
    pub layers: Vec<LayerLayout>,
    /// Dense weights.
    pub dense_weights: Range<usize>,
    /// Index of the dense bias, the last parameter.
    pub dense_bias: usize,
}

impl Layout {
    /// The layout of an architecture.
    #[must_use]
    pub fn new(architecture: &Architecture) -> Self {
        let mut next = 0;
        let mut take = |length: usize| {
            let range = next..next + length;
            next += length;
            range
        };
        let mut inputs = architecture.features;
        let mut layers = Vec::with_capacity(architecture.units.len());
        for &units in &architecture.units {
            layers.push(LayerLayout {
                inputs,
                units,
                input_weights: take(4 * units * inputs),
                recurrent_weights: take(4 * units * units),
                bias: take(4 * units),
            });
            inputs = units;
        }
        let dense_weights = take(inputs);
        Self { layers, dense_bias: dense_weights.end, dense_weights }
    }

    /// Number of parameters.
    #[must_use]
    pub fn len(&self) -> usize {
        self.dense_bias + 1
    }

    /// Never true: there is always a dense bias.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        false
    }
}

fn transpose(rows: usize, columns: usize, source: &[f32], target: &mut [f32]) {
    for row in 0..rows {
        for column in 0..columns {
            target[column * rows + row] = source[row * columns + column];
        }
    }
}

impl Network {
    /// Sizes and activation.
    #[must_use]
    pub fn architecture(&self) -> Architecture {
        Architecture {
            features: self.features(),
            units: self.layers.iter().map(|layer| layer.units).collect(),
            activation: self.activation,
            state_limit: self.state_limit,
        }
    }

    /// All parameters in the order of [`Layout`].
    #[must_use]
    pub fn to_flat(&self) -> Vec<f32> {
        let layout = Layout::new(&self.architecture());
        let mut flat = vec![0.0; layout.len()];
        for (layer, place) in self.layers.iter().zip(&layout.layers) {
            let rows = 4 * layer.units;
            transpose(rows, layer.inputs, &layer.input_weights, &mut flat[place.input_weights.clone()]);
            transpose(rows, layer.units, &layer.recurrent_weights, &mut flat[place.recurrent_weights.clone()]);
            flat[place.bias.clone()].copy_from_slice(&layer.bias);
        }
        flat[layout.dense_weights].copy_from_slice(&self.dense_weights);
        flat[layout.dense_bias] = self.dense_bias;
        flat
    }

    /// A network from its parameters in the order of [`Layout`].
    ///
    /// # Panics
    /// When `flat` has another length than the architecture asks for.
    #[must_use]
    pub fn from_flat(architecture: &Architecture, flat: &[f32]) -> Self {
        let layout = Layout::new(architecture);
        assert_eq!(flat.len(), layout.len(), "parameters of the architecture");
        let mut network = Self::zeros(architecture.features, &architecture.units, architecture.activation, architecture.state_limit);
        for (layer, place) in network.layers.iter_mut().zip(&layout.layers) {
            let rows = 4 * layer.units;
            transpose(layer.inputs, rows, &flat[place.input_weights.clone()], &mut layer.input_weights);
            transpose(layer.units, rows, &flat[place.recurrent_weights.clone()], &mut layer.recurrent_weights);
            layer.bias.copy_from_slice(&flat[place.bias.clone()]);
        }
        network.dense_weights.copy_from_slice(&flat[layout.dense_weights]);
        network.dense_bias = flat[layout.dense_bias];
        network
    }
}
