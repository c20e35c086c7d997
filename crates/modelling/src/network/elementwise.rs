//! The element-wise part of the batched passes, written so that vector instructions chosen at run time serve it.
//!
//! What runs under them is a struct with an inlined `with_simd` each: a closure is compiled apart from the dispatching function, for the
//! baseline machine.

use std::marker::PhantomData;

use pulp::{Simd, WithSimd};

use super::activation::{CellActivation, bound, sigmoid};

/// Elements that the element-wise loops take at a time.
pub(super) const BLOCK: usize = 16;

/// The element-wise part of one forward step, all lanes.
pub(super) struct CellsForward<'a, A> {
    pub(super) gates: &'a mut [f32],
    pub(super) gate_stride: usize,
    pub(super) units: usize,
    pub(super) cell_before: &'a [f32],
    pub(super) cell: &'a mut [f32],
    pub(super) activated: &'a mut [f32],
    pub(super) hidden: &'a mut [f32],
    pub(super) limit: f32,
    pub(super) marker: PhantomData<A>,
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
pub(super) struct CellsBackward<'a, A> {
    pub(super) gates: &'a mut [f32],
    pub(super) gate_stride: usize,
    pub(super) units: usize,
    pub(super) saved: Saved<'a>,
    pub(super) carried_cell: &'a mut [f32],
    pub(super) bias_gradient: &'a mut [f32],
    pub(super) limit: f32,
    pub(super) marker: PhantomData<A>,
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

/// Up to [`BLOCK`] values of a slice; missing ones are zero.
#[inline(always)]
pub(super) fn load(values: &[f32], from: usize) -> [f32; BLOCK] {
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
pub(super) fn store(values: &mut [f32], from: usize, block: &[f32; BLOCK]) {
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
pub(super) fn cell_forward<A: CellActivation>(
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
pub(super) struct Saved<'a> {
    pub(super) cell_before: &'a [f32],
    pub(super) cell: &'a [f32],
    pub(super) activated: &'a [f32],
    pub(super) from_above: &'a [f32],
    pub(super) from_later: &'a [f32],
}

/// One lane, one step: gates become gradients with respect to the pre-activations, the carried cell gradient moves one step back.
#[inline(always)]
pub(super) fn cell_backward<A: CellActivation>(
    gates: &mut [f32],
    saved: &Saved<'_>,
    carried_cell: &mut [f32],
    bias_gradient: &mut [f32],
    limit: f32,
) {
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
pub(super) struct DenseForward<'a> {
    pub(super) hidden: &'a [f32],
    pub(super) weights: &'a [f32],
    pub(super) bias: f32,
    pub(super) outputs: &'a mut [f32],
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
pub(super) struct DenseBackward<'a> {
    pub(super) hidden: &'a [f32],
    pub(super) weights: &'a [f32],
    pub(super) from_above: &'a [f32],
    pub(super) hidden_gradient: &'a mut [f32],
    pub(super) weight_gradient: &'a mut [f32],
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
