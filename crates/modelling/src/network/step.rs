//! One network step at a time: the plain reading of the equations, for evaluation and as the yardstick of the fast code.

use super::{Activation, Cell, Layer, Network};

/// Hidden and cell state of every layer; the output of one that is dense counts as its hidden state.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkState {
    hidden: Vec<Vec<f32>>,
    cell: Vec<Vec<f32>>,
    gates: Vec<f32>,
}

impl NetworkState {
    /// The zero state of a network.
    #[must_use]
    pub fn new(network: &Network) -> Self {
        let zeros = || network.layers.iter().map(|layer| vec![0.0; layer.units]).collect();
        let widest = network.layers.iter().map(|layer| layer.bias.len()).max().unwrap_or(0);
        Self { hidden: zeros(), cell: zeros(), gates: vec![0.0; widest] }
    }

    /// Back to zero.
    pub fn reset(&mut self) {
        self.hidden.iter_mut().chain(&mut self.cell).for_each(|values| values.fill(0.0));
    }

    /// Hidden state of a layer.
    #[must_use]
    pub fn hidden(&self, layer: usize) -> &[f32] {
        &self.hidden[layer]
    }

    /// Cell state of a layer.
    #[must_use]
    pub fn cell(&self, layer: usize) -> &[f32] {
        &self.cell[layer]
    }
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

impl Network {
    /// One step: features in, normalised output out.
    ///
    /// # Panics
    /// When `features` is not as wide as the first layer's input or `state` belongs to another architecture.
    pub fn step(&self, state: &mut NetworkState, features: &[f32]) -> f32 {
        assert_eq!(features.len(), self.features(), "features of the first layer");
        for (index, layer) in self.layers.iter().enumerate() {
            let gates = &mut state.gates[..layer.bias.len()];
            let (below, here) = state.hidden.split_at_mut(index);
            let input = below.last().map_or(features, Vec::as_slice);
            project(layer, input, &here[0], gates);
            self.update(layer, gates, &mut state.cell[index], &mut here[0]);
        }
        let last = state.hidden.last().map_or(&[][..], Vec::as_slice);
        self.dense_bias + dot(&self.dense_weights, last)
    }

    fn update(&self, layer: &Layer, gates: &[f32], cell: &mut [f32], hidden: &mut [f32]) {
        let cap = if let Cell::Dense(_) = layer.cell { f32::INFINITY } else { self.state_limit };
        let act = |x: f32| match layer.cell.activation(self.activation) {
            Activation::Tanh => x.tanh(),
            Activation::Relu => x.clamp(0.0, cap),
            Activation::Hard => x.clamp(-1.0, 1.0),
        };
        let units = layer.units;
        for unit in 0..units {
            let gate = |number: usize| gates[number * units + unit];
            match layer.cell {
                Cell::Lstm => {
                    let (input_gate, forget_gate, output_gate) = (sigmoid(gate(0)), sigmoid(gate(1)), sigmoid(gate(3)));
                    let candidate = act(gate(2));
                    cell[unit] = (forget_gate * cell[unit] + input_gate * candidate).clamp(-self.state_limit, self.state_limit);
                    hidden[unit] = output_gate * act(cell[unit]);
                }
                Cell::Gru => {
                    let (reset, update) = (sigmoid(gate(0)), sigmoid(gate(1)));
                    let candidate = act(gate(2) + reset * gate(3));
                    hidden[unit] = (1.0 - update) * candidate + update * hidden[unit];
                }
                Cell::Dense(_) => hidden[unit] = act(gate(0)),
            }
        }
    }
}

fn project(layer: &Layer, input: &[f32], hidden: &[f32], gates: &mut [f32]) {
    let rows = gates.chunks_mut(layer.units).zip(layer.bias.chunks(layer.units));
    for (gate, (values, biases)) in layer.cell.gates().iter().zip(rows) {
        for (unit, (value, bias)) in values.iter_mut().zip(biases).enumerate() {
            let part = |of_gate: Option<usize>, weights: &[f32], seen: &[f32]| {
                of_gate.map_or(0.0, |of_gate| dot(&weights[(of_gate * layer.units + unit) * seen.len()..][..seen.len()], seen))
            };
            *value = bias + part(gate.input, &layer.input_weights, input) + part(gate.recurrent, &layer.recurrent_weights, hidden);
        }
    }
}

fn dot(left: &[f32], right: &[f32]) -> f32 {
    // Sixteen independent sums let the compiler use vector registers without reordering what the source says.
    let mut sums = [0.0f32; 16];
    let (left_blocks, left_rest) = left.as_chunks::<16>();
    let (right_blocks, right_rest) = right.as_chunks::<16>();
    for (a, b) in left_blocks.iter().zip(right_blocks) {
        for lane in 0..16 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sums.iter().sum::<f32>() + left_rest.iter().zip(right_rest).map(|(a, b)| a * b).sum::<f32>()
}
