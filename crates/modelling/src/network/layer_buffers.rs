//! One layer of a batched pass: its buffers, and its steps forth and back.

use std::marker::PhantomData;

use pulp::Arch;

use super::activation::CellActivation;
use super::elementwise::{BLOCK, CellsBackward, CellsForward, Saved};
use super::parameters::LayerLayout;
use super::product::{Matrix, multiply};

/// Extra elements between gate rows: rows a power of two apart would all fall into the same few cache sets.
pub(super) const ROW_PADDING: usize = 16;

/// What one layer keeps from the forward pass for the backward pass.
pub(super) struct LayerBuffers {
    pub(super) units: usize,
    /// Rows of gates i, f, g, o, `gate_stride` apart.
    pub(super) gates: Vec<f32>,
    pub(super) gate_stride: usize,
    /// Hidden state, one row a step plus the state before the chunk as the first rows.
    pub(super) hidden: Vec<f32>,
    /// Cell state, laid out as `hidden`.
    pub(super) cell: Vec<f32>,
    /// `act(c)`, one row a step.
    pub(super) activated: Vec<f32>,
    /// Gradient with respect to the hidden state from above, one row a step.
    pub(super) hidden_gradient: Vec<f32>,
    /// Gradient carried back from the next step to the hidden state, one row a lane.
    pub(super) carried_hidden: Vec<f32>,
    /// The same for the cell state.
    pub(super) carried_cell: Vec<f32>,
    /// `W_h`, `4 * units` rows of `units`: what the backward pass multiplies with.
    pub(super) recurrent_rows: Vec<f32>,
    /// `W_x`, `4 * units` rows of `inputs`; empty for the first layer.
    pub(super) input_rows: Vec<f32>,
}

impl LayerBuffers {
    /// `gates = b + x W_x` for all rows of the chunk.
    pub(super) fn project(&mut self, place: &LayerLayout, parameters: &[f32], input: &[f32], rows: usize) {
        let width = 4 * self.units;
        let bias = &parameters[place.bias.clone()];
        for row in self.gates.chunks_exact_mut(self.gate_stride).take(rows) {
            row[..width].copy_from_slice(bias);
        }
        let weights = Matrix::rows(&parameters[place.input_weights.clone()], width);
        multiply((rows, width, place.inputs), Matrix::rows(input, place.inputs), weights, &mut self.gates, self.gate_stride, true);
    }

    /// Turns the transposed weights round for the backward pass.
    pub(super) fn refresh_rows(&mut self, place: &LayerLayout, parameters: &[f32], with_input: bool) {
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

pub(super) struct StepForward<'a> {
    pub(super) layer: &'a mut LayerBuffers,
    pub(super) place: &'a LayerLayout,
    pub(super) lanes: usize,
    pub(super) limit: f32,
    pub(super) arch: Arch,
}

impl StepForward<'_> {
    pub(super) fn run<A: CellActivation>(self, parameters: &[f32], steps: usize) {
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

pub(super) struct StepBackward<'a> {
    pub(super) layer: &'a mut LayerBuffers,
    pub(super) lanes: usize,
    pub(super) limit: f32,
    pub(super) arch: Arch,
}

impl StepBackward<'_> {
    pub(super) fn run<A: CellActivation>(self, steps: usize, bias_gradient: &mut [f32]) {
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
