//! The fixed-point network, step by step as [`model_export::fixed`] specifies it.
//!
//! A [`Kernel`] computes one layer; [`Portable`] is plain Rust and the yardstick that any other kernel must match to the bit.

use model_export::fixed::{CELL_FRACTION, GATE_FRACTION, hidden_fraction};
use model_export::schema::{self, Activation, Cell, MAX_LAYERS, MAX_UNITS, MAX_WIDTH};
use model_export::validate::Invalid;

use super::arithmetic::{high, multiply_high_rounded, saturate, saturate_16, sigmoid, tanh};

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

/// Computes layers; the place where the target's fast kernel comes in.
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

impl KernelSource for Portable {
    type Kernel = Self;

    fn kernel(self, _network: &Network<'_>) -> Result<Self, Invalid> {
        Ok(self)
    }
}

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
            let _ = layers.push(Layer { wire: layer.clone(), activation: layer.cell.activation(activation), inputs, units });
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

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use model_export::fixed::{SIGMOID, TANH};
    use proptest::prelude::*;

    use super::*;

    /// The specification again, in wide integers and floor division, without a line of the code under test.
    mod specification {
        use super::*;

        fn floor_shift(value: i128, bits: u32) -> i128 {
            value.div_euclid(1 << bits)
        }

        fn smmulr(a: i128, b: i128) -> i128 {
            floor_shift(a * b + (1 << 31), 32)
        }

        fn table(entries: &[[i32; 2]], z: i128, bits: u32, step_bits: u32) -> i128 {
            let q = z.clamp(-(1 << (bits - 1)), (1 << (bits - 1)) - 1);
            let n = floor_shift(q, step_bits) + 256;
            let [base, slope] = entries[usize::try_from(n).unwrap()].map(i128::from);
            base + floor_shift(slope * q.rem_euclid(1 << step_bits), 16)
        }

        fn act(activation: Activation, layer: &schema::Layer<'_>, z: i128) -> i128 {
            let (k, limit) = (u32::from(layer.cell_exponent), i128::from(layer.cell_limit));
            match activation {
                Activation::Tanh => floor_shift(table(&TANH, z, 20, 11), k),
                Activation::Hard => z.clamp(-65_536, 65_535) << (14 - k),
                Activation::Relu => z.clamp(0, floor_shift(limit, 14 - k)) << (14 - k),
            }
        }

        fn narrowed(layer: &schema::Layer<'_>, state: i128) -> i128 {
            let s = u32::from(layer.hidden_shift);
            floor_shift(state + (1 << s), s + 1).clamp(-32_768, 32_767)
        }

        /// New state and hidden state of one unit of a GRU.
        pub fn gru(activation: Activation, layer: &schema::Layer<'_>, [r, u, n, m]: [i128; 4], c: i128) -> (i128, i128) {
            let sigmoid = |z| table(&SIGMOID, z, 21, 12);
            let saturated = |x: i128| x.clamp(i128::from(i32::MIN), i128::from(i32::MAX));
            let q = saturated(n + saturated(2 * smmulr(sigmoid(r), m)));
            let limit = i128::from(layer.cell_limit);
            let t = smmulr(sigmoid(u), c) + smmulr((1 << 31) - 1 - sigmoid(u), act(activation, layer, q));
            let c = t.clamp(-limit / 2, limit / 2 - 1) * 2;
            (c, narrowed(layer, c))
        }

        /// Output of one unit of a dense layer.
        pub fn dense(activation: Activation, layer: &schema::Layer<'_>, z: i128) -> i128 {
            narrowed(layer, act(activation, layer, z))
        }

        /// New cell and hidden state of one unit of an LSTM.
        pub fn unit(activation: Activation, layer: &schema::Layer<'_>, z: [i128; 4], c: i128) -> (i128, i128) {
            let (k, limit) = (u32::from(layer.cell_exponent), i128::from(layer.cell_limit));
            let sigmoid = |z| table(&SIGMOID, z, 21, 12);
            let tanh = |z| table(&TANH, z, 20, 11);
            let [i, f, o] = [z[0], z[1], z[3]].map(sigmoid);
            let g = act(activation, layer, z[2]);
            let c = (smmulr(f, c) + smmulr(i, g)).clamp(-limit / 2, limit / 2 - 1) * 2;
            let a = match activation {
                Activation::Tanh => tanh(floor_shift(c, 14 - k)),
                Activation::Hard => c.clamp(-(1 << (30 - k)), (1 << (30 - k)) - 1) << k,
                Activation::Relu => c.max(0),
            };
            let s = u32::from(layer.hidden_shift);
            (c, floor_shift(smmulr(o, a) + (1 << (s - 1)), s).clamp(-32_768, 32_767))
        }

        /// With the rows of both matrices and the bias, where there are such.
        pub fn pre_activation(layer: &schema::Layer<'_>, rows: (Option<usize>, Option<usize>, usize), x: &[i16], h: &[i16]) -> i128 {
            let dot = |weights: &[u8], values: &[i16]| -> i128 {
                weights.iter().zip(values).map(|(w, v)| i128::from(w.cast_signed()) * i128::from(*v)).sum()
            };
            let word = |bytes: &[u8], row: usize| i128::from(i32::from_le_bytes(bytes[4 * row..4 * row + 4].try_into().unwrap()));
            let (input, recurrent, bias) = rows;
            let bias = i128::from(i64::from_le_bytes(layer.biases[8 * bias..8 * bias + 8].try_into().unwrap()));
            let from_x =
                input.map_or(0, |row| dot(&layer.input_weights[row * x.len()..][..x.len()], x) * word(layer.input_multipliers, row));
            let from_h = recurrent
                .map_or(0, |row| dot(&layer.recurrent_weights[row * h.len()..][..h.len()], h) * word(layer.recurrent_multipliers, row));
            floor_shift(bias + from_x + from_h, 32)
        }
    }

    fn bytes(length: usize) -> impl Strategy<Value = Vec<u8>> {
        prop::collection::vec(any::<u8>(), length)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1200))]

        #[test]
        fn a_step_is_the_specification_to_the_bit(
            (inputs, units, matrices, recurrent) in (1usize..=64, 1usize..=6).prop_flat_map(|(inputs, units)| {
                (Just(inputs), Just(units), bytes(4 * units * inputs), bytes(4 * units * units))
            }),
            words in bytes(4 * 24 * 2),
            biases in prop::collection::vec(-(1i64 << 52)..(1 << 52), 24),
            damping in 0u32..14,
            (code, kind) in (0u8..3, 0u8..3),
            (cell_exponent, hidden_shift, half_limit) in (0u8..=7, 1u8..=14, 1i32..=(1 << 29)),
            steps in prop::collection::vec(prop::collection::vec(any::<i16>(), 64), 4),
        ) {
            let activation = Activation::from_code(code).unwrap();
            let cell = [Cell::Lstm, Cell::Gru, Cell::Dense(activation)][usize::from(kind)];
            let (input_rows, recurrent_rows) = (cell.input_rows() * units, cell.recurrent_rows() * units);
            // Multipliers of every size, so that pre-activations fall inside the tables as well as far outside.
            let scaled = |words: &[u8]| -> Vec<u8> {
                words.as_chunks::<4>().0.iter().flat_map(|word| (i32::from_le_bytes(*word) >> damping).to_le_bytes()).collect()
            };
            let biases: Vec<u8> = biases.iter().flat_map(|bias| bias.to_le_bytes()).collect();
            let (input_multipliers, recurrent_multipliers) = (scaled(&words[..4 * input_rows]), scaled(&words[96..96 + 4 * recurrent_rows]));
            let wire = schema::Layer {
                cell,
                inputs: u16::try_from(inputs).unwrap(),
                units: u16::try_from(units).unwrap(),
                input_weights: &matrices[..input_rows * inputs],
                recurrent_weights: &recurrent[..recurrent_rows * units],
                input_multipliers: &input_multipliers,
                recurrent_multipliers: &recurrent_multipliers,
                biases: &biases[..8 * units * cell.gates().len()],
                cell_exponent,
                cell_limit: 2 * half_limit,
                hidden_shift,
            };
            let layer = Layer { wire: wire.clone(), activation, inputs, units };
            let mut state = LayerState::default();
            let (mut h, mut c) = (std::vec![0i16; units], std::vec![0i128; units]);
            for input in steps {
                let input: [i16; 64] = input.try_into().unwrap();
                Portable.step(0, &layer, &input, &mut state);
                let mut next = Vec::new();
                for (unit, memory) in c.iter_mut().enumerate() {
                    let row = |gate: usize| Some(gate * units + unit);
                    let z = |input_gate: Option<usize>, recurrent_gate: Option<usize>, bias: usize| {
                        let rows = (input_gate.and_then(row), recurrent_gate.and_then(row), bias * units + unit);
                        specification::pre_activation(&wire, rows, &input[..inputs], &h)
                    };
                    let (state, hidden) = match cell {
                        Cell::Lstm => {
                            specification::unit(activation, &wire, [0, 1, 2, 3].map(|gate| z(Some(gate), Some(gate), gate)), *memory)
                        }
                        Cell::Gru => {
                            let z = [z(Some(0), Some(0), 0), z(Some(1), Some(1), 1), z(Some(2), None, 2), z(None, Some(2), 3)];
                            specification::gru(activation, &wire, z, *memory)
                        }
                        Cell::Dense(_) => (0, specification::dense(activation, &wire, z(Some(0), None, 0))),
                    };
                    *memory = state;
                    next.push(i16::try_from(hidden).unwrap());
                }
                h = next;
                prop_assert_eq!(&state.hidden[..units], &h[..]);
                prop_assert!(state.cell[..units].iter().map(|cell| i128::from(*cell)).eq(c.iter().copied()));
                prop_assert!(state.hidden[units..].iter().all(|hidden| *hidden == 0));
            }
        }
    }
}
