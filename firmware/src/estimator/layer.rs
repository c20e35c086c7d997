//! One layer in fixed point, unit by unit as [`model_export::fixed`] specifies it.

use model_export::fixed::{CELL_FRACTION, GATE_FRACTION, hidden_fraction};
use model_export::schema::{self, Activation, Cell, MAX_UNITS, MAX_WIDTH};

use super::arithmetic::{high, multiply_high_rounded, saturate, saturate_16, sigmoid, tanh};

#[cfg(test)]
mod tests;

/// The memory of one layer; in this order, because the fast kernel reaches both from one address.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LayerState {
    /// Cell state of an LSTM, hidden state of a GRU: Q1.30 of `2^cell_exponent`. Zero for dense layers.
    pub cell: [i32; MAX_UNITS],
    /// Hidden state, or a dense layer's output; units beyond the layer's stay zero.
    pub hidden: [i16; MAX_UNITS],
}

impl Default for LayerState {
    fn default() -> Self {
        Self { hidden: [0; MAX_UNITS], cell: [0; MAX_UNITS] }
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
    /// A layer that was validated, of a network with this activation.
    pub(super) fn new(wire: schema::Layer<'a>, of_network: Activation) -> Self {
        let activation = wire.cell.activation(of_network);
        let (inputs, units) = (usize::from(wire.inputs), usize::from(wire.units));
        Self { wire, activation, inputs, units }
    }

    /// The layer as in the blob.
    #[must_use]
    pub fn wire(&self) -> &schema::Layer<'a> {
        &self.wire
    }

    /// What it computes.
    #[must_use]
    pub fn cell(&self) -> Cell {
        self.wire.cell
    }

    /// Its activation.
    #[must_use]
    pub fn activation(&self) -> Activation {
        self.activation
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
        power_of_two(-hidden_fraction(self.wire.cell, self.activation, self.wire.cell_exponent, self.wire.hidden_shift))
    }

    /// Value of one step of the stored cell state.
    #[must_use]
    pub fn cell_step(&self) -> f32 {
        power_of_two(i32::from(self.wire.cell_exponent) - i32::from(CELL_FRACTION))
    }

    /// Pre-activation of a row that has the same number in both matrices and among the biases, in Q15.16.
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

    /// Pre-activations of a unit in Q15.16, in the order of [`Cell::gates`].
    #[inline]
    fn pre_activations(&self, unit: usize, input: &[i16], hidden: &[i16]) -> [i32; 4] {
        match self.wire.cell {
            Cell::Lstm => [0, 1, 2, 3].map(|gate| self.pre_activation(gate * self.units + unit, input, hidden)),
            Cell::Gru | Cell::Dense(_) => self.pre_activations_of_gates(unit, input, hidden),
        }
    }

    /// The same for any cell. Apart, so that an LSTM's loop stays short.
    #[inline(never)]
    fn pre_activations_of_gates(&self, unit: usize, input: &[i16], hidden: &[i16]) -> [i32; 4] {
        let wire = &self.wire;
        let mut pre_activations = [0; 4];
        for ((number, gate), z) in wire.cell.gates().iter().enumerate().zip(&mut pre_activations) {
            let part = |of_gate: Option<usize>, matrix: &[u8], multipliers: &[u8], values: &[i16], columns: usize| {
                let Some(of_gate) = of_gate else { return 0 };
                let row = of_gate * self.units + unit;
                let weights = matrix.get(row * columns..(row + 1) * columns).unwrap_or(&[]);
                let multiplier = multipliers.as_chunks().0.get(row).map_or(0, |bytes| i64::from(i32::from_le_bytes(*bytes)));
                i64::from(dot(weights, values)).wrapping_mul(multiplier)
            };
            let from_input = part(gate.input, wire.input_weights, wire.input_multipliers, input, self.inputs);
            let from_hidden = part(gate.recurrent, wire.recurrent_weights, wire.recurrent_multipliers, hidden, self.units);
            let bias = wire.biases.as_chunks().0.get(number * self.units + unit).map_or(0, |bytes| i64::from_le_bytes(*bytes));
            *z = high(bias.wrapping_add(from_input).wrapping_add(from_hidden));
        }
        pre_activations
    }

    /// New state and output of one unit from its pre-activations in the order of [`Cell::gates`].
    #[cfg(not(target_os = "none"))]
    pub(super) fn next(&self, z: [i32; 4], state: i32) -> (i32, i16) {
        let unit = self.update(z, state);
        (unit.cell, unit.hidden)
    }

    /// The activation of a candidate or a dense layer, in Q1.30 of `2^cell_exponent`.
    #[inline]
    fn activate(&self, z: i32) -> i32 {
        let (exponent, limit) = (self.wire.cell_exponent, self.wire.cell_limit);
        let to_cell = 14 - exponent;
        match self.activation {
            Activation::Tanh => tanh(z) >> exponent,
            Activation::Hard => saturate::<17>(z) << to_cell,
            Activation::Relu => z.max(0).min(limit >> to_cell) << to_cell,
        }
    }

    /// A state and its 16 bits, as a GRU and a dense layer give them on.
    #[inline]
    fn narrowed(&self, state: i32) -> (i16, bool) {
        let shift = self.wire.hidden_shift;
        let wide = state.wrapping_add(1 << shift) >> (shift + 1);
        let hidden = saturate_16(wide);
        (hidden, i32::from(hidden) != wide)
    }

    /// Half the sum of a state and a candidate, each times its gate, within the bound; and whether the bound was met.
    #[inline]
    fn mixed(&self, [keep, take]: [i32; 2], state: i32, candidate: i32) -> (i32, bool) {
        let sum = multiply_high_rounded(keep, state).wrapping_add(multiply_high_rounded(take, candidate));
        let half = self.wire.cell_limit >> 1;
        let bounded = sum.max(-half).min(half - 1);
        (bounded << 1, bounded != sum)
    }

    /// The element-wise part of one unit: pre-activations in the order of [`Cell::gates`] and the state to the gates and new states.
    #[inline]
    fn update(&self, z: [i32; 4], state: i32) -> Unit {
        match self.wire.cell {
            Cell::Lstm => self.update_lstm(z, state),
            Cell::Gru => self.update_gru(z, state),
            Cell::Dense(_) => self.update_dense(z),
        }
    }

    #[inline(never)]
    fn update_dense(&self, [z, ..]: [i32; 4]) -> Unit {
        let candidate = self.activate(z);
        let (hidden, hidden_saturated) = self.narrowed(candidate);
        Unit { gates: [0; 3], candidate, cell: 0, hidden, cell_saturated: false, hidden_saturated }
    }

    #[inline(never)]
    fn update_gru(&self, [reset_z, update_z, input_z, hidden_z]: [i32; 4], state: i32) -> Unit {
        let (reset, update) = (sigmoid(reset_z), sigmoid(update_z));
        let product = multiply_high_rounded(reset, hidden_z);
        let candidate = self.activate(input_z.saturating_add(product.saturating_add(product)));
        let (cell, cell_saturated) = self.mixed([update, i32::MAX - update], state, candidate);
        let (hidden, hidden_saturated) = self.narrowed(cell);
        Unit { gates: [reset, update, 0], candidate, cell, hidden, cell_saturated, hidden_saturated }
    }

    #[inline]
    fn update_lstm(&self, [input_z, forget_z, candidate_z, output_z]: [i32; 4], cell: i32) -> Unit {
        let exponent = self.wire.cell_exponent;
        let to_cell = 14 - exponent;
        let (input_gate, forget_gate, output_gate) = (sigmoid(input_z), sigmoid(forget_z), sigmoid(output_z));
        let candidate = self.activate(candidate_z);
        let (cell, cell_saturated) = self.mixed([forget_gate, input_gate], cell, candidate);
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
        let hidden_saturated = i32::from(hidden) != wide;
        Unit { gates: [input_gate, forget_gate, output_gate], candidate, cell, hidden, cell_saturated, hidden_saturated }
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
    gates: [i32; 3],
    candidate: i32,
    cell: i32,
    hidden: i16,
    cell_saturated: bool,
    hidden_saturated: bool,
}

/// What happened inside one unit in one step, as real numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitTrace {
    /// Pre-activations in the order of [`Cell::gates`]; zero beyond.
    pub pre_activations: [f32; 4],
    /// Gates i, f, o of an LSTM, r, u of a GRU; zero beyond.
    pub gates: [f32; 3],
    /// Candidate g or n, or a dense layer's output before it is rounded to 16 bits.
    pub candidate: f32,
    /// New cell state c; a GRU's hidden state before it is rounded to 16 bits.
    pub cell: f32,
    /// New hidden state h, or a dense layer's output.
    pub hidden: f32,
    /// The state met its limit.
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
            gates: self.gates.map(gate),
            candidate: self.candidate as f32 * cell_step,
            cell: self.cell as f32 * cell_step,
            hidden: f32::from(self.hidden) * layer.hidden_step(),
            cell_saturated: self.cell_saturated,
            hidden_saturated: self.hidden_saturated,
        }
    }
}

/// One step of a layer in plain Rust, showing every unit to `trace`.
#[inline]
pub(super) fn step_traced<T: Trace>(index: usize, layer: &Layer<'_>, input: &[i16; MAX_WIDTH], state: &mut LayerState, trace: &mut T) {
    let units = layer.units;
    let mut next = [0; MAX_UNITS];
    let input = input.get(..layer.inputs).unwrap_or(input);
    let LayerState { hidden, cell } = state;
    let last = hidden.get(..units).unwrap_or(hidden);
    for (unit, (new, cell)) in next.iter_mut().zip(cell.iter_mut()).take(units).enumerate() {
        let z = layer.pre_activations(unit, input, last);
        let values = layer.update(z, *cell);
        *cell = values.cell;
        *new = values.hidden;
        if T::WANTED {
            trace.unit(index, unit, &values.trace(layer, z));
        }
    }
    *hidden = next;
}
