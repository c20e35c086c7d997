//! The fixed-point network: its layers one after the other, and the dense row behind them.

use model_export::schema::{self, MAX_LAYERS, MAX_UNITS, MAX_WIDTH};
use model_export::validate::Invalid;

use super::kernel::{Kernel, Portable};
use super::layer::{Layer, LayerState, Trace, step_traced};

/// The memory of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NetworkState {
    layers: [LayerState; MAX_LAYERS],
}

impl Default for NetworkState {
    fn default() -> Self {
        Self::new()
    }
}

impl NetworkState {
    /// At the start.
    #[must_use]
    pub const fn new() -> Self {
        Self { layers: [LayerState { cell: [0; MAX_UNITS], hidden: [0; MAX_UNITS] }; MAX_LAYERS] }
    }

    /// Back to zero.
    pub fn reset(&mut self) {
        for layer in &mut self.layers {
            layer.cell.fill(0);
            layer.hidden.fill(0);
        }
    }

    /// The layers' states, first layer first; those beyond the network's stay zero.
    #[must_use]
    pub fn layers(&self) -> &[LayerState; MAX_LAYERS] {
        &self.layers
    }
}

/// Makes the kernel of a network, once, when a model is loaded.
pub trait KernelSource {
    /// What it makes.
    type Kernel: Kernel;

    /// The kernel that computes the layers of `network` and of no other.
    ///
    /// # Errors
    /// When the network is too large for the memory that its weights are packed into.
    ///
    /// # Deadline
    /// Not for the tick: reads every weight.
    fn kernel(self, network: &Network<'_>) -> Result<Self::Kernel, Invalid>;
}

impl KernelSource for Portable {
    type Kernel = Self;

    fn kernel(self, _network: &Network<'_>) -> Result<Self, Invalid> {
        Ok(self)
    }
}

/// A fixed-point network, ready to run.
#[derive(Clone, Debug)]
pub struct Network<'a> {
    layers: heapless::Vec<Layer<'a>, MAX_LAYERS>,
    dense: schema::Dense<'a>,
}

impl<'a> Network<'a> {
    /// Builds a network that takes `features` inputs; its arrays stay where they are.
    ///
    /// # Errors
    /// When a field is out of its domain.
    pub fn new(wire: &schema::Network<'a>, features: usize) -> Result<Self, Invalid> {
        wire.validate(features)?;
        let activation = wire.activation()?;
        let mut layers = heapless::Vec::new();
        for layer in &wire.layers {
            // Both lists have the same capacity.
            let _ = layers.push(Layer::new(layer.clone(), activation));
        }
        Ok(Self { layers, dense: wire.dense.clone() })
    }

    /// The layers, first layer first.
    #[must_use]
    pub fn layers(&self) -> &[Layer<'a>] {
        &self.layers
    }

    /// One step with features in Q1.14; gives the normalised correction.
    ///
    /// # Deadline
    /// Runs in the control tick: one multiply-accumulate per weight and about 60 instructions a unit.
    pub fn step<K: Kernel>(&self, kernel: &K, state: &mut NetworkState, features: &[i16; MAX_WIDTH]) -> f32 {
        let mut input = features;
        for (index, (layer, memory)) in self.layers.iter().zip(&mut state.layers).enumerate() {
            kernel.step(index, layer, input, memory);
            input = &memory.hidden;
        }
        self.output(input)
    }

    /// As [`Self::step`] with the portable kernel, showing every unit to `trace`.
    pub fn step_traced<T: Trace>(&self, state: &mut NetworkState, features: &[i16; MAX_WIDTH], trace: &mut T) -> f32 {
        let mut input = features;
        for (index, (layer, memory)) in self.layers.iter().zip(&mut state.layers).enumerate() {
            step_traced(index, layer, input, memory, trace);
            input = &memory.hidden;
        }
        self.output(input)
    }

    fn output(&self, hidden: &[i16; MAX_WIDTH]) -> f32 {
        let weights = self.dense.weights.as_chunks().0.iter().map(|bytes| i32::from(i16::from_le_bytes(*bytes)));
        let sum = weights.zip(hidden).fold(0i32, |sum, (weight, value)| sum.wrapping_add(weight.wrapping_mul(i32::from(*value))));
        // An integer above 2^24 rounds to the nearest even `f32`, by the same IEEE 754 rule everywhere.
        self.dense.bias + self.dense.scale * sum as f32
    }
}
