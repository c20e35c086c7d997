//! The slowly turning coordinates in which SOAP runs Adam (Vyas et al., 2024, "SOAP: improving and stabilizing Shampoo using Adam").
//!
//! For a gradient matrix `G` (rows x columns) the running means of `G G^T` and `G^T G` say in which directions of its rows and of its
//! columns the loss is steep. Their eigenvectors are the coordinates; they are followed by one step of orthogonal iteration now and then,
//! which costs a product and a QR factorisation.

use pulp::{Arch, Simd, WithSimd};

use crate::network::product::{Matrix, multiply};

/// Elements that the inner loops take at a time.
const LANES: usize = 16;

/// One side of a gradient matrix: the running second moment and its eigenvectors.
#[derive(Clone, Debug, PartialEq)]
pub struct Side {
    size: usize,
    /// Running mean of `G G^T` or `G^T G`, symmetric; empty for a side of one element, which has nothing to turn.
    moment: Vec<f32>,
    /// Row `i` is the eigenvector number `i`, largest eigenvalue first; empty as above.
    basis: Vec<f32>,
}

impl Side {
    /// Coordinates that are those of the parameters.
    fn new(size: usize) -> Self {
        if size == 1 {
            return Self { size, moment: Vec::new(), basis: Vec::new() };
        }
        let mut basis = vec![0.0; size * size];
        (0..size).for_each(|index| basis[index * (size + 1)] = 1.0);
        Self { size, moment: vec![0.0; size * size], basis }
    }

    fn is_fixed(&self) -> bool {
        self.basis.is_empty()
    }

    /// `moment = decay * moment + (1 - decay) * outer`.
    fn mix(&mut self, outer: &[f32], decay: f32) {
        self.moment.iter_mut().zip(outer).for_each(|(moment, &outer)| *moment = decay * *moment + (1.0 - decay) * outer);
    }

    /// One step of orthogonal iteration; gives where each new coordinate was before (a permutation, by size of the eigenvalues).
    fn turn(&mut self) -> Vec<usize> {
        let size = self.size;
        let mut order: Vec<usize> = (0..size).collect();
        if self.is_fixed() {
            return order;
        }
        let mut product = vec![0.0; size * size];
        multiply((size, size, size), Matrix::rows(&self.basis, size), Matrix::rows(&self.moment, size), &mut product, size, false);
        let rows = product.chunks_exact(size).zip(self.basis.chunks_exact(size));
        let eigenvalues: Vec<f32> = rows.map(|(image, vector)| image.iter().zip(vector).map(|(a, b)| a * b).sum()).collect();
        // A stable sort: coordinates of equal weight stay in their places.
        order.sort_by(|&one, &other| eigenvalues[other].total_cmp(&eigenvalues[one]));
        let mut sorted = Vec::with_capacity(size * size);
        order.iter().for_each(|&from| sorted.extend_from_slice(&product[from * size..][..size]));
        Arch::new().dispatch(Orthonormal { size, rows: &mut sorted, basis: &mut self.basis });
        order
    }
}

/// The coordinates of one gradient matrix.
#[derive(Clone, Debug, PartialEq)]
pub struct Eigenbasis {
    rows: usize,
    columns: usize,
    left: Side,
    right: Side,
    scratch: Vec<f32>,
}

impl Eigenbasis {
    /// Coordinates that are those of the parameters, until the first [`Self::turn`].
    #[must_use]
    pub fn new(rows: usize, columns: usize) -> Self {
        Self { rows, columns, left: Side::new(rows), right: Side::new(columns), scratch: vec![0.0; rows * columns] }
    }

    /// Elements of the matrix.
    #[must_use]
    pub fn elements(&self) -> usize {
        self.rows * self.columns
    }

    /// Takes a gradient into the running moments.
    pub fn observe(&mut self, gradient: &[f32], decay: f32) {
        let (rows, columns) = (self.rows, self.columns);
        let matrix = Matrix::rows(gradient, columns);
        let mut outer = vec![0.0; rows.max(columns).pow(2)];
        if !self.left.is_fixed() {
            multiply((rows, rows, columns), matrix, matrix.transposed(), &mut outer, rows, false);
            self.left.mix(&outer, decay);
        }
        if !self.right.is_fixed() {
            multiply((columns, columns, rows), matrix.transposed(), matrix, &mut outer, columns, false);
            self.right.mix(&outer, decay);
        }
    }

    /// `values` in the coordinates of the basis.
    pub fn enter(&mut self, values: &mut [f32]) {
        self.rotate(values, false);
    }

    /// Back to the coordinates of the parameters.
    pub fn leave(&mut self, values: &mut [f32]) {
        self.rotate(values, true);
    }

    fn rotate(&mut self, values: &mut [f32], back: bool) {
        let (rows, columns) = (self.rows, self.columns);
        if !self.left.is_fixed() {
            let basis = Matrix::rows(&self.left.basis, rows);
            let basis = if back { basis.transposed() } else { basis };
            multiply((rows, columns, rows), basis, Matrix::rows(values, columns), &mut self.scratch, columns, false);
            values.copy_from_slice(&self.scratch);
        }
        if !self.right.is_fixed() {
            let basis = Matrix::rows(&self.right.basis, columns);
            let basis = if back { basis } else { basis.transposed() };
            multiply((rows, columns, columns), Matrix::rows(values, columns), basis, &mut self.scratch, columns, false);
            values.copy_from_slice(&self.scratch);
        }
    }

    /// Follows the running moments by one step of orthogonal iteration. `mean` and `square`, the moments of Adam in these coordinates, are
    /// carried over: the mean exactly, the squares to the coordinates that continue the old ones.
    pub fn turn(&mut self, mean: &mut [f32], square: &mut [f32]) {
        self.leave(mean);
        let rows = self.left.turn();
        let columns = self.right.turn();
        self.enter(mean);
        for (row, &from) in rows.iter().enumerate() {
            for (column, &from_column) in columns.iter().enumerate() {
                self.scratch[row * self.columns + column] = square[from * self.columns + from_column];
            }
        }
        square.copy_from_slice(&self.scratch);
    }

    /// Everything a checkpoint needs.
    #[must_use]
    pub fn state(&self) -> Vec<f32> {
        [&self.left, &self.right].into_iter().flat_map(|side| side.moment.iter().chain(&side.basis)).copied().collect()
    }

    /// Takes the front of `state` back, as [`Self::state`] gave it; gives the rest.
    pub fn restore<'a>(&mut self, state: &'a [f32]) -> &'a [f32] {
        let mut rest = state;
        for side in [&mut self.left, &mut self.right] {
            for target in [&mut side.moment, &mut side.basis] {
                let (values, after) = rest.split_at(target.len());
                target.copy_from_slice(values);
                rest = after;
            }
        }
        rest
    }
}

/// Orthonormal rows that span what the leading rows span, by Householder reflections: exact however different the rows' lengths are,
/// which Gram and Schmidt's method is not. `rows` is used up.
struct Orthonormal<'a> {
    size: usize,
    rows: &'a mut [f32],
    basis: &'a mut [f32],
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0f32; LANES];
    let ((a_blocks, a_rest), (b_blocks, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a_blocks.iter().zip(b_blocks) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f32>() + rest
}

/// `row -= 2 (row . mirror) mirror`.
#[inline(always)]
fn reflect(row: &mut [f32], mirror: &[f32]) {
    let along = 2.0 * dot(row, mirror);
    row.iter_mut().zip(mirror).for_each(|(value, &mirror)| *value -= along * mirror);
}

impl WithSimd for Orthonormal<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { size, rows, basis } = self;
        let mut signs = vec![1.0f32; size];
        for index in 0..size {
            let (done, below) = rows.split_at_mut((index + 1) * size);
            let mirror = &mut done[index * size + index..];
            // The largest element first: squares of tiny gradients would underflow.
            let largest = mirror.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
            if largest > 0.0 {
                mirror.iter_mut().for_each(|value| *value /= largest);
                let length = dot(mirror, mirror).sqrt();
                let sign = if mirror[0] < 0.0 { -1.0 } else { 1.0 };
                // The reflection takes the row to `-sign * length` along its own axis.
                signs[index] = -sign;
                mirror[0] += sign * length;
                let norm = dot(mirror, mirror).sqrt();
                mirror.iter_mut().for_each(|value| *value /= norm);
                for row in below.chunks_exact_mut(size) {
                    reflect(&mut row[index..], mirror);
                }
            }
        }
        basis.fill(0.0);
        for (index, sign) in signs.iter().enumerate() {
            basis[index * (size + 1)] = *sign;
        }
        for index in (0..size).rev() {
            let mirror = &rows[index * size + index..][..size - index];
            // Rows above still are axes that this mirror does not touch.
            for row in basis.chunks_exact_mut(size).skip(index) {
                reflect(&mut row[index..], mirror);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Numbers in -1 to 1 without a pattern.
    fn numbers(count: usize, seed: u32) -> Vec<f32> {
        let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(1);
        (0..count)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / 8_388_608.0 - 1.0
            })
            .collect()
    }

    /// Largest deviation of `basis basis^T` from the unit matrix.
    fn deviation(size: usize, basis: &[f32]) -> f32 {
        let mut largest = 0.0f32;
        for (row, one) in basis.chunks_exact(size).enumerate() {
            for (column, other) in basis.chunks_exact(size).enumerate() {
                let expected = if row == column { 1.0 } else { 0.0 };
                largest = largest.max((dot(one, other) - expected).abs());
            }
        }
        largest
    }

    proptest! {
        #[test]
        fn rows_become_orthonormal_and_span_what_they_spanned(size in 2_usize..40, seed in 0_u32..1000, decades in 0.0_f32..12.0) {
            let mut rows = numbers(size * size, seed);
            // Rows of very different lengths, as late in training.
            for (index, row) in rows.chunks_exact_mut(size).enumerate() {
                let length = 10.0_f32.powf(-decades * index as f32 / size as f32);
                row.iter_mut().for_each(|value| *value *= length);
            }
            let before = rows.clone();
            let mut basis = vec![0.0; size * size];
            Arch::new().dispatch(Orthonormal { size, rows: &mut rows, basis: &mut basis });
            // Rounding of sums of up to 40 products.
            prop_assert!(deviation(size, &basis) < 1e-5);
            // Row `i` lies in the span of the first `i + 1` new ones, on the positive side of the last.
            for (index, row) in before.chunks_exact(size).enumerate() {
                let length = dot(row, row).sqrt();
                for (other, axis) in basis.chunks_exact(size).enumerate() {
                    if other > index {
                        prop_assert!(dot(row, axis).abs() <= 1e-5 * length, "row {index} along {other}");
                    }
                }
                prop_assert!(dot(row, &basis[index * size..][..size]) > -1e-5 * length);
            }
        }

        #[test]
        fn leaving_undoes_entering(rows in 1_usize..20, columns in 1_usize..20, seed in 0_u32..1000) {
            let mut basis = Eigenbasis::new(rows, columns);
            let (mut mean, mut square) = (vec![0.0; rows * columns], vec![0.0; rows * columns]);
            for step in 0..5 {
                basis.observe(&numbers(rows * columns, seed + step), 0.9);
                basis.turn(&mut mean, &mut square);
            }
            let values = numbers(rows * columns, seed + 77);
            let mut turned = values.clone();
            basis.enter(&mut turned);
            prop_assert!((dot(&turned, &turned) - dot(&values, &values)).abs() < 1e-4 * dot(&values, &values), "lengths stay");
            basis.leave(&mut turned);
            prop_assert!(turned.iter().zip(&values).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }

    #[test]
    fn the_coordinates_become_the_eigenvectors_of_the_gradients_moments() {
        let (rows, columns) = (7, 4);
        let mut basis = Eigenbasis::new(rows, columns);
        let (mut mean, mut square) = (vec![0.0; rows * columns], vec![0.0; rows * columns]);
        let gradient = numbers(rows * columns, 3);
        for _ in 0..300 {
            basis.observe(&gradient, 0.5);
            basis.turn(&mut mean, &mut square);
        }
        // In its own singular vectors a matrix is diagonal, largest value first.
        let mut turned = gradient;
        basis.enter(&mut turned);
        let diagonal: Vec<f32> = (0..columns).map(|index| turned[index * columns + index].abs()).collect();
        for (index, value) in turned.iter().enumerate() {
            if index / columns != index % columns {
                assert!(value.abs() < 1e-4, "{value} at {index}");
            }
        }
        assert!(diagonal.windows(2).all(|pair| pair[0] >= pair[1]) && diagonal[0] > 1.0, "{diagonal:?}");
    }

    #[test]
    fn turning_carries_the_running_mean_over() {
        let (rows, columns) = (5, 9);
        let mut basis = Eigenbasis::new(rows, columns);
        let direction = numbers(rows * columns, 8);
        let (mut mean, mut square) = (direction.clone(), vec![1.0; rows * columns]);
        for step in 0..4 {
            basis.observe(&numbers(rows * columns, step), 0.8);
            basis.turn(&mut mean, &mut square);
        }
        assert!(mean.iter().zip(&direction).any(|(a, b)| (a - b).abs() > 0.1), "the coordinates did turn");
        basis.leave(&mut mean);
        assert!(mean.iter().zip(&direction).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}
