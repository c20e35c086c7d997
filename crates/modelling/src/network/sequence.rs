//! Batched forward pass and backpropagation through time over a chunk of steps.
//!
//! A *lane* is one sequence of the batch; a *row* is one lane at one step, `row = step * lanes + lane`. The large products (input
//! projections, weight gradients, gradients to the layer below) run over all rows of a chunk at once; only the recurrent product is done
//! step by step. Gates overwrite their pre-activations and gradients overwrite the gates, so one buffer serves all three.

use std::marker::PhantomData;

use pulp::{Arch, Simd, WithSimd};

use super::Activation;
use super::activation::{CellActivation, Hard, Relu, Tanh, bound, sigmoid};
use super::parameters::{Architecture, LayerLayout, Layout};
use super::product::{Matrix, multiply};

/// Extra elements between gate rows: rows a power of two apart would all fall into the same few cache sets.
const ROW_PADDING: usize = 16;
/// Elements that the element-wise loops take at a time.
const BLOCK: usize = 16;

/// What one layer keeps from the forward pass for the backward pass.
struct LayerBuffers {
    units: usize,
    /// Rows of gates i, f, g, o, `gate_stride` apart.
    gates: Vec<f32>,
    gate_stride: usize,
    /// Hidden state, one row a step plus the state before the chunk as the first rows.
    hidden: Vec<f32>,
    /// Cell state, laid out as `hidden`.
    cell: Vec<f32>,
    /// `act(c)`, one row a step.
    activated: Vec<f32>,
    /// Gradient with respect to the hidden state from above, one row a step.
    hidden_gradient: Vec<f32>,
    /// Gradient carried back from the next step to the hidden state, one row a lane.
    carried_hidden: Vec<f32>,
    /// The same for the cell state.
    carried_cell: Vec<f32>,
    /// `W_h`, `4 * units` rows of `units`: what the backward pass multiplies with.
    recurrent_rows: Vec<f32>,
    /// `W_x`, `4 * units` rows of `inputs`; empty for the first layer.
    input_rows: Vec<f32>,
}

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

impl LayerBuffers {
    /// `gates = b + x W_x` for all rows of the chunk.
    fn project(&mut self, place: &LayerLayout, parameters: &[f32], input: &[f32], rows: usize) {
        let width = 4 * self.units;
        let bias = &parameters[place.bias.clone()];
        for row in self.gates.chunks_exact_mut(self.gate_stride).take(rows) {
            row[..width].copy_from_slice(bias);
        }
        let weights = Matrix::rows(&parameters[place.input_weights.clone()], width);
        multiply((rows, width, place.inputs), Matrix::rows(input, place.inputs), weights, &mut self.gates, self.gate_stride, true);
    }

    /// Turns the transposed weights round for the backward pass.
    fn refresh_rows(&mut self, place: &LayerLayout, parameters: &[f32], with_input: bool) {
        let width = 4 * self.units;
        let turn = |source: &[f32], rows: usize, target: &mut [f32]| {
            // Blocks of 16 rows: each cache line of the source is read once.
            for first in (0..rows).step_by(BLOCK) {
                for column in 0..width {
                    for row in first..rows.min(first + BLOCK) {
                        target[column * rows + row] = source[row * width + column];
                    }
                }
            }
        };
        turn(&parameters[place.recurrent_weights.clone()], self.units, &mut self.recurrent_rows);
        if with_input {
            turn(&parameters[place.input_weights.clone()], place.inputs, &mut self.input_rows);
        }
    }
}

// What runs under vector instructions chosen at run time is a struct with an inlined `with_simd` each: a closure is compiled apart from
// the dispatching function, for the baseline machine.

/// The element-wise part of one forward step, all lanes.
struct CellsForward<'a, A> {
    gates: &'a mut [f32],
    gate_stride: usize,
    units: usize,
    cell_before: &'a [f32],
    cell: &'a mut [f32],
    activated: &'a mut [f32],
    hidden: &'a mut [f32],
    limit: f32,
    marker: PhantomData<A>,
}

impl<A: CellActivation> WithSimd for CellsForward<'_, A> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let units = self.units;
        for (lane, row) in self.gates.chunks_exact_mut(self.gate_stride).enumerate() {
            let at = lane * units..(lane + 1) * units;
            cell_forward::<A>(
                &mut row[..4 * units],
                &self.cell_before[at.clone()],
                &mut self.cell[at.clone()],
                &mut self.activated[at.clone()],
                &mut self.hidden[at],
                self.limit,
            );
        }
    }
}

/// The element-wise part of one backward step, all lanes.
struct CellsBackward<'a, A> {
    gates: &'a mut [f32],
    gate_stride: usize,
    units: usize,
    saved: Saved<'a>,
    carried_cell: &'a mut [f32],
    bias_gradient: &'a mut [f32],
    limit: f32,
    marker: PhantomData<A>,
}

impl<A: CellActivation> WithSimd for CellsBackward<'_, A> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let units = self.units;
        for (lane, row) in self.gates.chunks_exact_mut(self.gate_stride).enumerate() {
            let at = lane * units..(lane + 1) * units;
            let saved = Saved {
                cell_before: &self.saved.cell_before[at.clone()],
                cell: &self.saved.cell[at.clone()],
                activated: &self.saved.activated[at.clone()],
                from_above: &self.saved.from_above[at.clone()],
                from_later: &self.saved.from_later[at.clone()],
            };
            cell_backward::<A>(&mut row[..4 * units], &saved, &mut self.carried_cell[at], self.bias_gradient, self.limit);
        }
    }
}

struct StepForward<'a> {
    layer: &'a mut LayerBuffers,
    place: &'a LayerLayout,
    lanes: usize,
    limit: f32,
    arch: Arch,
}

impl StepForward<'_> {
    fn run<A: CellActivation>(self, parameters: &[f32], steps: usize) {
        let Self { layer, place, lanes, limit, arch } = self;
        let width = 4 * layer.units;
        let state = lanes * layer.units;
        let weights = Matrix::rows(&parameters[place.recurrent_weights.clone()], width);
        for step in 0..steps {
            let gates = &mut layer.gates[step * lanes * layer.gate_stride..][..lanes * layer.gate_stride];
            let (hidden_before, hidden) = layer.hidden[step * state..][..2 * state].split_at_mut(state);
            let (cell_before, cell) = layer.cell[step * state..][..2 * state].split_at_mut(state);
            let activated = &mut layer.activated[step * state..][..state];
            multiply((lanes, width, layer.units), Matrix::rows(hidden_before, layer.units), weights, gates, layer.gate_stride, true);
            let (gate_stride, units) = (layer.gate_stride, layer.units);
            arch.dispatch(CellsForward::<A> {
                gates,
                gate_stride,
                units,
                cell_before,
                cell,
                activated,
                hidden,
                limit,
                marker: PhantomData,
            });
        }
    }
}

struct StepBackward<'a> {
    layer: &'a mut LayerBuffers,
    lanes: usize,
    limit: f32,
    arch: Arch,
}

impl StepBackward<'_> {
    fn run<A: CellActivation>(self, steps: usize, bias_gradient: &mut [f32]) {
        let Self { layer, lanes, limit, arch } = self;
        let units = layer.units;
        let width = 4 * units;
        let state = lanes * units;
        layer.carried_hidden.fill(0.0);
        layer.carried_cell.fill(0.0);
        for step in (0..steps).rev() {
            let gates = &mut layer.gates[step * lanes * layer.gate_stride..][..lanes * layer.gate_stride];
            arch.dispatch(CellsBackward::<A> {
                gates,
                gate_stride: layer.gate_stride,
                units,
                saved: Saved {
                    cell_before: &layer.cell[step * state..][..state],
                    cell: &layer.cell[(step + 1) * state..][..state],
                    activated: &layer.activated[step * state..][..state],
                    from_above: &layer.hidden_gradient[step * state..][..state],
                    from_later: &layer.carried_hidden,
                },
                carried_cell: &mut layer.carried_cell,
                bias_gradient,
                limit,
                marker: PhantomData,
            });
            if step > 0 {
                let weights = Matrix::rows(&layer.recurrent_rows, units);
                multiply((lanes, units, width), Matrix::rows(gates, layer.gate_stride), weights, &mut layer.carried_hidden, units, false);
            }
        }
    }
}

/// Up to [`BLOCK`] values of a slice; missing ones are zero.
#[inline(always)]
fn load(values: &[f32], from: usize) -> [f32; BLOCK] {
    match values.get(from..from + BLOCK) {
        Some(block) => block.try_into().unwrap_or([0.0; BLOCK]),
        None => {
            let mut block = [0.0; BLOCK];
            let rest = &values[from..];
            block[..rest.len()].copy_from_slice(rest);
            block
        }
    }
}

/// Writes back what fits.
#[inline(always)]
fn store(values: &mut [f32], from: usize, block: &[f32; BLOCK]) {
    match values.get_mut(from..from + BLOCK) {
        Some(target) => target.copy_from_slice(block),
        None => {
            let rest = &mut values[from..];
            rest.copy_from_slice(&block[..rest.len()]);
        }
    }
}

/// One lane, one step: pre-activations become gates, the states follow.
#[inline(always)]
fn cell_forward<A: CellActivation>(
    gates: &mut [f32],
    cell_before: &[f32],
    cell: &mut [f32],
    activated: &mut [f32],
    hidden: &mut [f32],
    limit: f32,
) {
    let units = cell.len();
    let (input_gates, rest) = gates.split_at_mut(units);
    let (forget_gates, rest) = rest.split_at_mut(units);
    let (candidates, output_gates) = rest.split_at_mut(units);
    for from in (0..units).step_by(BLOCK) {
        let mut i = load(input_gates, from);
        let mut f = load(forget_gates, from);
        let mut g = load(candidates, from);
        let mut o = load(output_gates, from);
        let mut c = load(cell_before, from);
        let mut a = [0.0; BLOCK];
        let mut h = [0.0; BLOCK];
        for lane in 0..BLOCK {
            i[lane] = sigmoid(i[lane]);
            f[lane] = sigmoid(f[lane]);
            g[lane] = A::value(g[lane], limit);
            o[lane] = sigmoid(o[lane]);
            c[lane] = bound(f[lane] * c[lane] + i[lane] * g[lane], -limit, limit);
            a[lane] = A::value(c[lane], limit);
            h[lane] = o[lane] * a[lane];
        }
        store(input_gates, from, &i);
        store(forget_gates, from, &f);
        store(candidates, from, &g);
        store(output_gates, from, &o);
        store(cell, from, &c);
        store(activated, from, &a);
        store(hidden, from, &h);
    }
}

/// What the backward pass of one lane and step reads.
struct Saved<'a> {
    cell_before: &'a [f32],
    cell: &'a [f32],
    activated: &'a [f32],
    from_above: &'a [f32],
    from_later: &'a [f32],
}

/// One lane, one step: gates become gradients with respect to the pre-activations, the carried cell gradient moves one step back.
#[inline(always)]
fn cell_backward<A: CellActivation>(gates: &mut [f32], saved: &Saved<'_>, carried_cell: &mut [f32], bias_gradient: &mut [f32], limit: f32) {
    let units = carried_cell.len();
    let (input_gates, rest) = gates.split_at_mut(units);
    let (forget_gates, rest) = rest.split_at_mut(units);
    let (candidates, output_gates) = rest.split_at_mut(units);
    let (input_bias, rest) = bias_gradient.split_at_mut(units);
    let (forget_bias, rest) = rest.split_at_mut(units);
    let (candidate_bias, output_bias) = rest.split_at_mut(units);
    for from in (0..units).step_by(BLOCK) {
        let mut i = load(input_gates, from);
        let mut f = load(forget_gates, from);
        let mut g = load(candidates, from);
        let mut o = load(output_gates, from);
        let before = load(saved.cell_before, from);
        let cell = load(saved.cell, from);
        let a = load(saved.activated, from);
        let above = load(saved.from_above, from);
        let later = load(saved.from_later, from);
        let mut carried = load(carried_cell, from);
        for lane in 0..BLOCK {
            let hidden = above[lane] + later[lane];
            let through = carried[lane] + hidden * o[lane] * A::slope(a[lane], limit);
            // Where the clamp held, nothing the cell was made of mattered.
            let through = if cell[lane].abs() < limit { through } else { 0.0 };
            carried[lane] = through * f[lane];
            let to_input = through * g[lane] * i[lane] * (1.0 - i[lane]);
            f[lane] = through * before[lane] * f[lane] * (1.0 - f[lane]);
            g[lane] = through * i[lane] * A::slope(g[lane], limit);
            o[lane] = hidden * a[lane] * o[lane] * (1.0 - o[lane]);
            i[lane] = to_input;
        }
        store(input_gates, from, &i);
        store(forget_gates, from, &f);
        store(candidates, from, &g);
        store(output_gates, from, &o);
        store(carried_cell, from, &carried);
        for (sums, deltas) in [(&mut *input_bias, &i), (&mut *forget_bias, &f), (&mut *candidate_bias, &g), (&mut *output_bias, &o)] {
            let mut sum = load(sums, from);
            for lane in 0..BLOCK {
                sum[lane] += deltas[lane];
            }
            store(sums, from, &sum);
        }
    }
}

/// `outputs = hidden . weights + bias`, row by row.
struct DenseForward<'a> {
    hidden: &'a [f32],
    weights: &'a [f32],
    bias: f32,
    outputs: &'a mut [f32],
}

impl WithSimd for DenseForward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { hidden, weights, bias, outputs } = self;
        for (output, row) in outputs.iter_mut().zip(hidden.chunks_exact(weights.len())) {
            let mut sums = [0.0f32; BLOCK];
            for from in (0..weights.len()).step_by(BLOCK) {
                let (values, factors) = (load(row, from), load(weights, from));
                for lane in 0..BLOCK {
                    sums[lane] += values[lane] * factors[lane];
                }
            }
            *output = bias + sums.iter().sum::<f32>();
        }
    }
}

/// Gradients of the dense output with respect to its weights and to the hidden state.
struct DenseBackward<'a> {
    hidden: &'a [f32],
    weights: &'a [f32],
    from_above: &'a [f32],
    hidden_gradient: &'a mut [f32],
    weight_gradient: &'a mut [f32],
}

impl WithSimd for DenseBackward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { hidden, weights, from_above, hidden_gradient, weight_gradient } = self;
        let units = weights.len();
        for ((&above, row), target) in from_above.iter().zip(hidden.chunks_exact(units)).zip(hidden_gradient.chunks_exact_mut(units)) {
            for from in (0..units).step_by(BLOCK) {
                let (values, mut factors) = (load(row, from), load(weights, from));
                let mut sums = load(weight_gradient, from);
                for lane in 0..BLOCK {
                    sums[lane] += above * values[lane];
                    factors[lane] *= above;
                }
                store(weight_gradient, from, &sums);
                store(target, from, &factors);
            }
        }
    }
}
