//! Batched forward pass and backpropagation through time over a chunk of steps.
//!
//! A *lane* is one sequence of the batch; a *row* is one lane at one step, `row = step * lanes + lane`. The large products (input
//! projections, weight gradients, gradients to the layer below) run over all rows of a chunk at once; only the recurrent product is done
//! step by step. Gates overwrite their pre-activations and gradients overwrite the gates, so one buffer serves all three.

use pulp::Arch;

use super::Activation;
use super::activation::{CellActivation, Hard, Relu, Tanh};
use super::elementwise::{DenseBackward, DenseForward};
use super::layer_buffers::{LayerBuffers, ROW_PADDING, StepBackward, StepForward};
use super::parameters::{Architecture, Layout};
use super::product::{Matrix, multiply};

/// Buffers for a batch of lanes and the passes over them.
pub struct Sequence {
    architecture: Architecture,
    layout: Layout,
    arch: Arch,
    lanes: usize,
    max_steps: usize,
    steps: usize,
    layers: Vec<LayerBuffers>,
    features: Vec<f32>,
    outputs: Vec<f32>,
    output_gradient: Vec<f32>,
}

impl Sequence {
    /// Buffers for `lanes` sequences of up to `max_steps` steps, all states zero.
    #[must_use]
    pub fn new(architecture: &Architecture, lanes: usize, max_steps: usize) -> Self {
        let layout = Layout::new(architecture);
        let rows = lanes * max_steps;
        let layers = layout.layers.iter().enumerate().map(|(index, layer)| {
            let gate_stride = 4 * layer.units + ROW_PADDING;
            let below = if index == 0 { 0 } else { layer.inputs };
            LayerBuffers {
                units: layer.units,
                gates: vec![0.0; rows * gate_stride],
                gate_stride,
                hidden: vec![0.0; (rows + lanes) * layer.units],
                cell: vec![0.0; (rows + lanes) * layer.units],
                activated: vec![0.0; rows * layer.units],
                hidden_gradient: vec![0.0; rows * layer.units],
                carried_hidden: vec![0.0; lanes * layer.units],
                carried_cell: vec![0.0; lanes * layer.units],
                recurrent_rows: vec![0.0; 4 * layer.units * layer.units],
                input_rows: vec![0.0; 4 * layer.units * below],
            }
        });
        Self {
            layers: layers.collect(),
            architecture: architecture.clone(),
            layout,
            arch: Arch::new(),
            lanes,
            max_steps,
            steps: 0,
            features: vec![0.0; rows * architecture.features],
            outputs: vec![0.0; rows],
            output_gradient: vec![0.0; rows],
        }
    }

    /// Sizes and activation of the network.
    #[must_use]
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// Number of lanes.
    #[must_use]
    pub fn lanes(&self) -> usize {
        self.lanes
    }

    /// The features of a chunk of `steps`, to be filled in: one row a step and lane.
    ///
    /// # Panics
    /// When `steps` exceeds the buffers.
    pub fn features_mut(&mut self, steps: usize) -> &mut [f32] {
        assert!(steps <= self.max_steps, "{steps} steps in buffers of {}", self.max_steps);
        self.steps = steps;
        &mut self.features[..steps * self.lanes * self.architecture.features]
    }

    /// Back to the zero state in one lane.
    pub fn reset_lane(&mut self, lane: usize) {
        for layer in &mut self.layers {
            let units = lane * layer.units..(lane + 1) * layer.units;
            layer.hidden[units.clone()].fill(0.0);
            layer.cell[units].fill(0.0);
        }
    }

    /// Hidden and cell state before the next chunk, layer by layer: what a checkpoint needs.
    #[must_use]
    pub fn carried_state(&self) -> Vec<f32> {
        let mut state = Vec::new();
        for layer in &self.layers {
            state.extend_from_slice(&layer.hidden[..self.lanes * layer.units]);
            state.extend_from_slice(&layer.cell[..self.lanes * layer.units]);
        }
        state
    }

    /// Takes the state of [`Self::carried_state`] back.
    ///
    /// # Panics
    /// When `state` belongs to another shape.
    pub fn restore_state(&mut self, state: &[f32]) {
        let mut rest = state;
        for layer in &mut self.layers {
            for target in [&mut layer.hidden, &mut layer.cell] {
                let (values, tail) = rest.split_at(self.lanes * layer.units);
                target[..values.len()].copy_from_slice(values);
                rest = tail;
            }
        }
        assert!(rest.is_empty(), "state of another shape");
    }

    /// Takes what one unit did in one step of a forward pass made elsewhere (by the fixed-point code), so that [`Self::backward`] can
    /// go back through it: gates i, f, g, o, new cell state and new hidden state.
    #[expect(clippy::too_many_arguments, reason = "three indices and three values that belong together nowhere else")]
    pub fn inject(&mut self, layer: usize, lane: usize, step: usize, unit: usize, gates: [f32; 4], cell: f32, hidden: f32) {
        let limit = self.architecture.state_limit;
        let lanes = self.lanes;
        let buffers = &mut self.layers[layer];
        let row = step * lanes + lane;
        for (gate, value) in gates.into_iter().enumerate() {
            buffers.gates[row * buffers.gate_stride + gate * buffers.units + unit] = value;
        }
        let at = row * buffers.units + unit;
        buffers.cell[at + lanes * buffers.units] = cell;
        buffers.hidden[at + lanes * buffers.units] = hidden;
        buffers.activated[at] = match self.architecture.activation {
            Activation::Tanh => Tanh::value(cell, limit),
            Activation::Relu => Relu::value(cell, limit),
            Activation::Hard => Hard::value(cell, limit),
        };
    }

    /// The output of a forward pass made elsewhere.
    pub fn inject_output(&mut self, lane: usize, step: usize, output: f32) {
        self.outputs[step * self.lanes + lane] = output;
    }

    /// The features of one lane and step of the chunk.
    #[must_use]
    pub fn lane_features(&self, lane: usize, step: usize) -> &[f32] {
        let width = self.architecture.features;
        &self.features[(step * self.lanes + lane) * width..][..width]
    }

    /// Raises each layer's entry to the largest magnitude of its hidden state in the last chunk.
    pub fn raise_to_largest_hidden(&self, largest: &mut [f64]) {
        for (layer, largest) in self.layers.iter().zip(largest) {
            let hidden = &layer.hidden[..(self.steps + 1) * self.lanes * layer.units];
            *largest = hidden.iter().fold(*largest, |largest, value| largest.max(f64::from(value.abs())));
        }
    }

    /// Makes the state after the chunk the state before the next one.
    pub fn carry(&mut self) {
        for layer in &mut self.layers {
            let width = self.lanes * layer.units;
            let last = self.steps * width;
            layer.hidden.copy_within(last..last + width, 0);
            layer.cell.copy_within(last..last + width, 0);
        }
    }

    /// Forward pass over the chunk whose features were filled in; gives one output a row.
    pub fn forward(&mut self, parameters: &[f32]) -> &[f32] {
        let rows = self.steps * self.lanes;
        for index in 0..self.layers.len() {
            let (below, here) = self.layers.split_at_mut(index);
            let layer = &mut here[0];
            let place = &self.layout.layers[index];
            let input = match below.last() {
                Some(below) => &below.hidden[self.lanes * below.units..],
                None => self.features.as_slice(),
            };
            layer.project(place, parameters, input, rows);
            let step = StepForward { layer, place, lanes: self.lanes, limit: self.architecture.state_limit, arch: self.arch };
            match self.architecture.activation {
                Activation::Tanh => step.run::<Tanh>(parameters, self.steps),
                Activation::Relu => step.run::<Relu>(parameters, self.steps),
                Activation::Hard => step.run::<Hard>(parameters, self.steps),
            }
        }
        if let Some(last) = self.layers.last() {
            let weights = &parameters[self.layout.dense_weights.clone()];
            let bias = parameters[self.layout.dense_bias];
            let hidden = &last.hidden[self.lanes * last.units..][..rows * last.units];
            let outputs = &mut self.outputs[..rows];
            self.arch.dispatch(DenseForward { hidden, weights, bias, outputs });
        }
        &self.outputs[..rows]
    }

    /// The gradient of the loss with respect to each output of the chunk, to be filled in before [`Self::backward`].
    pub fn output_gradient_mut(&mut self) -> &mut [f32] {
        &mut self.output_gradient[..self.steps * self.lanes]
    }

    /// Outputs of the last forward pass, one a row.
    #[must_use]
    pub fn outputs(&self) -> &[f32] {
        &self.outputs[..self.steps * self.lanes]
    }

    /// Outputs of the last forward pass and their gradients, one a row.
    pub fn outputs_and_gradient_mut(&mut self) -> (&[f32], &mut [f32]) {
        let rows = self.steps * self.lanes;
        (&self.outputs[..rows], &mut self.output_gradient[..rows])
    }

    /// Backpropagation through the chunk of the last forward pass: writes the gradient with respect to every parameter into `gradient`.
    /// The state before the chunk counts as a constant (truncated backpropagation). Consumes the stored gates.
    ///
    /// # Panics
    /// When `parameters` or `gradient` have another length than the architecture asks for.
    pub fn backward(&mut self, parameters: &[f32], gradient: &mut [f32]) {
        assert!(parameters.len() == self.layout.len() && gradient.len() == self.layout.len(), "parameters of the architecture");
        let rows = self.steps * self.lanes;
        gradient.fill(0.0);
        if let Some(last) = self.layers.last_mut() {
            let (weight_gradient, bias_gradient) = gradient[self.layout.dense_weights.start..].split_at_mut(last.units);
            let hidden = &last.hidden[self.lanes * last.units..][..rows * last.units];
            let weights = &parameters[self.layout.dense_weights.clone()];
            let from_above = &self.output_gradient[..rows];
            let hidden_gradient = &mut last.hidden_gradient[..rows * last.units];
            self.arch.dispatch(DenseBackward { hidden, weights, from_above, hidden_gradient, weight_gradient });
            bias_gradient[0] = from_above.iter().sum();
        }
        for index in (0..self.layers.len()).rev() {
            let (below, here) = self.layers.split_at_mut(index);
            let layer = &mut here[0];
            let place = &self.layout.layers[index];
            layer.refresh_rows(place, parameters, index > 0);
            let step = StepBackward { layer, lanes: self.lanes, limit: self.architecture.state_limit, arch: self.arch };
            let bias_gradient = &mut gradient[place.bias.clone()];
            match self.architecture.activation {
                Activation::Tanh => step.run::<Tanh>(self.steps, bias_gradient),
                Activation::Relu => step.run::<Relu>(self.steps, bias_gradient),
                Activation::Hard => step.run::<Hard>(self.steps, bias_gradient),
            }
            let layer = &here[0];
            let deltas = Matrix::rows(&layer.gates, layer.gate_stride);
            let width = 4 * layer.units;
            let before = Matrix::rows(&layer.hidden, layer.units).transposed();
            multiply((layer.units, width, rows), before, deltas, &mut gradient[place.recurrent_weights.clone()], width, false);
            let input = match below.last() {
                Some(below) => &below.hidden[self.lanes * below.units..],
                None => self.features.as_slice(),
            };
            let input = Matrix::rows(input, place.inputs).transposed();
            multiply((place.inputs, width, rows), input, deltas, &mut gradient[place.input_weights.clone()], width, false);
            if let Some(below) = below.last_mut() {
                let weights = Matrix::rows(&layer.input_rows, place.inputs);
                multiply((rows, place.inputs, width), deltas, weights, &mut below.hidden_gradient, place.inputs, false);
            }
        }
    }
}
