//! The fixed-point LSTM, step by step as [`model_export::fixed`] specifies it.
//!
//! A [`Kernel`] computes one layer; [`Portable`] is plain Rust and the yardstick that any other kernel must match to the bit.

use model_export::fixed::{CELL_FRACTION, GATE_FRACTION, hidden_fraction};
use model_export::schema::{self, Activation, MAX_LAYERS, MAX_UNITS, MAX_WIDTH};
use model_export::validate::Invalid;

use super::arithmetic::{high, multiply_high_rounded, saturate, saturate_16, sigmoid, tanh};

/// The memory of one layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LayerState {
    /// Hidden state; units beyond the layer's stay zero.
    pub hidden: [i16; MAX_UNITS],
    /// Cell state, Q1.30 of `2^cell_exponent`.
    pub cell: [i32; MAX_UNITS],
}

impl Default for LayerState {
    fn default() -> Self {
        Self { hidden: [0; MAX_UNITS], cell: [0; MAX_UNITS] }
    }
}

/// The memory of a network.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NetworkState {
    layers: [LayerState; MAX_LAYERS],
}

impl NetworkState {
    /// Back to zero.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// The layers' states, first layer first; those beyond the network's stay zero.
    #[must_use]
    pub fn layers(&self) -> &[LayerState; MAX_LAYERS] {
        &self.layers
    }
}

/// A validated layer with the constants of its element-wise part.
#[derive(Clone, Debug)]
pub struct Layer<'a> {
    wire: schema::Layer<'a>,
    activation: Activation,
    inputs: usize,
    units: usize,
}

impl<'a> Layer<'a> {
    /// The layer as in the blob.
    #[must_use]
    pub fn wire(&self) -> &schema::Layer<'a> {
        &self.wire
    }

    /// Width of the input.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Hidden units.
    #[must_use]
    pub fn units(&self) -> usize {
        self.units
    }

    /// Value of one step of the hidden state.
    #[must_use]
    pub fn hidden_step(&self) -> f32 {
        power_of_two(-hidden_fraction(self.activation, self.wire.cell_exponent, self.wire.hidden_shift))
    }

    /// Value of one step of the stored cell state.
    #[must_use]
    pub fn cell_step(&self) -> f32 {
        power_of_two(i32::from(self.wire.cell_exponent) - i32::from(CELL_FRACTION))
    }

    /// Pre-activation of a row in Q15.16.
    #[inline]
    fn pre_activation(&self, row: usize, input: &[i16], hidden: &[i16]) -> i32 {
        let weights = |matrix: &'a [u8], columns: usize| matrix.get(row * columns..(row + 1) * columns).unwrap_or(&[]);
        let from_input = dot(weights(self.wire.input_weights, self.inputs), input);
        let from_hidden = dot(weights(self.wire.recurrent_weights, self.units), hidden);
        let multiplier = |bytes: &[u8]| bytes.as_chunks().0.get(row).map_or(0, |bytes| i64::from(i32::from_le_bytes(*bytes)));
        let bias = self.wire.biases.as_chunks().0.get(row).map_or(0, |bytes| i64::from_le_bytes(*bytes));
        let input_part = i64::from(from_input).wrapping_mul(multiplier(self.wire.input_multipliers));
        let hidden_part = i64::from(from_hidden).wrapping_mul(multiplier(self.wire.recurrent_multipliers));
        high(bias.wrapping_add(input_part).wrapping_add(hidden_part))
    }

    /// The element-wise part of one unit: pre-activations in gate order i, f, g, o and the cell state to the gates and new states.
    #[inline]
    fn update(&self, z: [i32; 4], cell: i32) -> Unit {
        let exponent = self.wire.cell_exponent;
        let limit = self.wire.cell_limit;
        let to_cell = 14 - exponent;
        let [input_z, forget_z, candidate_z, output_z] = z;
        let (input_gate, forget_gate, output_gate) = (sigmoid(input_z), sigmoid(forget_z), sigmoid(output_z));
        let candidate = match self.activation {
            Activation::Tanh => tanh(candidate_z) >> exponent,
            Activation::Hard => saturate::<17>(candidate_z) << to_cell,
            Activation::Relu => candidate_z.max(0).min(limit >> to_cell) << to_cell,
        };
        let sum = multiply_high_rounded(forget_gate, cell).wrapping_add(multiply_high_rounded(input_gate, candidate));
        let half = limit >> 1;
        let bounded = sum.max(-half).min(half - 1);
        let cell = bounded << 1;
        let activated = match self.activation {
            Activation::Tanh => tanh(cell >> to_cell),
            Activation::Hard => {
                let one = 1 << (CELL_FRACTION - exponent);
                cell.max(-one).min(one - 1) << exponent
            }
            Activation::Relu => cell.max(0),
        };
        let shift = self.wire.hidden_shift;
        let wide = multiply_high_rounded(output_gate, activated).wrapping_add(1 << (shift - 1)) >> shift;
        let hidden = saturate_16(wide);
        Unit {
            input_gate,
            forget_gate,
            candidate,
            output_gate,
            cell,
            hidden,
            cell_saturated: bounded != sum,
            hidden_saturated: i32::from(hidden) != wide,
        }
    }
}

/// Exact in any order: the exporter's bound keeps every partial sum below 2^28.
#[inline]
fn dot(weights: &[u8], values: &[i16]) -> i32 {
    weights.iter().zip(values).fold(0, |sum, (weight, value)| {
        let product = i32::from(weight.cast_signed()).wrapping_mul(i32::from(*value));
        sum.wrapping_add(product)
    })
}

/// `2^exponent` for exponents of the `f32` range, without a library.
fn power_of_two(exponent: i32) -> f32 {
    f32::from_bits((exponent + 127).clamp(1, 254).cast_unsigned() << 23)
}

#[derive(Clone, Copy)]
struct Unit {
    input_gate: i32,
    forget_gate: i32,
    candidate: i32,
    output_gate: i32,
    cell: i32,
    hidden: i16,
    cell_saturated: bool,
    hidden_saturated: bool,
}

/// What happened inside one unit in one step, as real numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitTrace {
    /// Pre-activations in gate order i, f, g, o.
    pub pre_activations: [f32; 4],
    /// Input gate i.
    pub input_gate: f32,
    /// Forget gate f.
    pub forget_gate: f32,
    /// Candidate g.
    pub candidate: f32,
    /// Output gate o.
    pub output_gate: f32,
    /// New cell state c.
    pub cell: f32,
    /// New hidden state h.
    pub hidden: f32,
    /// The cell state met its limit.
    pub cell_saturated: bool,
    /// The hidden state met the end of its 16 bits.
    pub hidden_saturated: bool,
}

/// Looks into a step: training with the quantiser in the loop and the error report need the inner values.
pub trait Trace {
    /// Whether the values are wanted; without, nothing is computed for the trace.
    const WANTED: bool = true;

    /// Called for every unit of every layer, in order.
    fn unit(&mut self, layer: usize, unit: usize, values: &UnitTrace);
}

/// Looks at nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoTrace;

impl Trace for NoTrace {
    const WANTED: bool = false;

    fn unit(&mut self, _layer: usize, _unit: usize, _values: &UnitTrace) {}
}

impl Unit {
    fn trace(&self, layer: &Layer<'_>, z: [i32; 4]) -> UnitTrace {
        // Integers of more than 24 bits round to the nearest `f32` here; the trace is for looking, not for computing on.
        let gate = |value: i32| value as f32 * power_of_two(-i32::from(GATE_FRACTION));
        let cell_step = layer.cell_step();
        UnitTrace {
            pre_activations: z.map(|value| value as f32 * power_of_two(-16)),
            input_gate: gate(self.input_gate),
            forget_gate: gate(self.forget_gate),
            candidate: self.candidate as f32 * cell_step,
            output_gate: gate(self.output_gate),
            cell: self.cell as f32 * cell_step,
            hidden: f32::from(self.hidden) * layer.hidden_step(),
            cell_saturated: self.cell_saturated,
            hidden_saturated: self.hidden_saturated,
        }
    }
}

/// Computes layers; the place where the target's fast kernel comes in, which packs the weights its own way when it is made.
pub trait Kernel {
    /// One step of layer number `index`: reads `input` (the layer's width is used) and moves `state` on.
    ///
    /// # Deadline
    /// Runs in the control tick.
    fn step(&self, index: usize, layer: &Layer<'_>, input: &[i16; MAX_WIDTH], state: &mut LayerState);
}

/// Plain Rust, the same on every machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct Portable;

impl Kernel for Portable {
    fn step(&self, index: usize, layer: &Layer<'_>, input: &[i16; MAX_WIDTH], state: &mut LayerState) {
        step_traced(index, layer, input, state, &mut NoTrace);
    }
}

fn step_traced<T: Trace>(index: usize, layer: &Layer<'_>, input: &[i16; MAX_WIDTH], state: &mut LayerState, trace: &mut T) {
    let units = layer.units;
    let mut next = [0; MAX_UNITS];
    let input = input.get(..layer.inputs).unwrap_or(input);
    let LayerState { hidden, cell } = state;
    let last = hidden.get(..units).unwrap_or(hidden);
    for (unit, (new, cell)) in next.iter_mut().zip(cell.iter_mut()).take(units).enumerate() {
        let z = [0, 1, 2, 3].map(|gate| layer.pre_activation(gate * units + unit, input, last));
        let values = layer.update(z, *cell);
        *cell = values.cell;
        *new = values.hidden;
        if T::WANTED {
            trace.unit(index, unit, &values.trace(layer, z));
        }
    }
    *hidden = next;
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
            let (inputs, units) = (usize::from(layer.inputs), usize::from(layer.units));
            // Both lists have the same capacity.
            let _ = layers.push(Layer { wire: layer.clone(), activation, inputs, units });
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
        let mut input = *features;
        for (index, (layer, memory)) in self.layers.iter().zip(&mut state.layers).enumerate() {
            kernel.step(index, layer, &input, memory);
            input = memory.hidden;
        }
        self.output(&input)
    }

    /// As [`Self::step`] with the portable kernel, showing every unit to `trace`.
    pub fn step_traced<T: Trace>(&self, state: &mut NetworkState, features: &[i16; MAX_WIDTH], trace: &mut T) -> f32 {
        let mut input = *features;
        for (index, (layer, memory)) in self.layers.iter().zip(&mut state.layers).enumerate() {
            step_traced(index, layer, &input, memory, trace);
            input = memory.hidden;
        }
        self.output(&input)
    }

    fn output(&self, hidden: &[i16; MAX_WIDTH]) -> f32 {
        let weights = self.dense.weights.as_chunks().0.iter().map(|bytes| i32::from(i16::from_le_bytes(*bytes)));
        let sum = weights.zip(hidden).fold(0i32, |sum, (weight, value)| sum.wrapping_add(weight.wrapping_mul(i32::from(*value))));
        // An integer above 2^24 rounds to the nearest even `f32`, by the same IEEE 754 rule everywhere.
        self.dense.bias + self.dense.scale * sum as f32
    }
}
