//! Least squares on sums of products: what one set of samples has to say about the weights, and the weights of the smallest residual.
//!
//! Weights that may not be negative come from Lawson and Hanson's active-set method (Solving Least Squares Problems, 1974, chapter 23)
//! on the normal equations. A search solves one problem after the other that hardly differ, so it begins with the weights that the last
//! fit made use of: mostly these are the ones again. The solution is the same wherever it begins, for there is only one.

use std::ops::Range;

use identification::nnls;
use pulp::{Arch, Simd, WithSimd};

use crate::chain::columns::{Rows, SIDE};

/// Sums of products of one set of samples: all that a linear fit needs to know of them.
#[derive(Clone, Debug)]
pub struct Gram {
    /// Number of columns.
    pub columns: usize,
    /// Products of columns with columns, row by row.
    pub products: Vec<f64>,
    /// Products of columns with the measured output.
    pub target: Vec<f64>,
    /// Sum of squares of the measured output.
    pub energy: f64,
    /// Number of samples.
    pub samples: f64,
}

impl Gram {
    /// No samples yet.
    #[must_use]
    pub fn new(columns: usize) -> Self {
        Self { columns, products: vec![0.0; columns * columns], target: vec![0.0; columns], energy: 0.0, samples: 0.0 }
    }

    /// The samples of both.
    pub fn add(&mut self, other: &Self) {
        for (sum, value) in self.products.iter_mut().zip(&other.products) {
            *sum += value;
        }
        for (sum, value) in self.target.iter_mut().zip(&other.target) {
            *sum += value;
        }
        self.energy += other.energy;
        self.samples += other.samples;
    }

    /// Mean square of the residual that `weights` leave; the largest number where that is none.
    #[must_use]
    pub fn mean_square(&self, weights: &[f64]) -> f64 {
        let mut sum = self.energy;
        for row in 0..self.columns {
            if weights[row] == 0.0 {
                continue;
            }
            let line = &self.products[row * self.columns..(row + 1) * self.columns];
            let product: f64 = line.iter().zip(weights).map(|(x, y)| x * y).sum();
            sum += weights[row] * (product - 2.0 * self.target[row]);
        }
        if sum.is_finite() { sum.max(0.0) / self.samples.max(1.0) } else { f64::MAX }
    }

    /// The weight of one column that leaves least beside `others`, in which its own is zero.
    #[must_use]
    pub fn weight_beside(&self, column: usize, others: &[f64]) -> f64 {
        let line = &self.products[column * self.columns..(column + 1) * self.columns];
        let taken: f64 = line.iter().zip(others).map(|(x, y)| x * y).sum();
        (self.target[column] - taken) / line[column].max(1e-30)
    }

    /// Weights of the smallest residual; those with `free[i] == false` are not negative. The search for those that are not zero begins with
    /// those that were not in `last`.
    #[must_use]
    pub fn solve(&self, free: &[bool], last: &[f64]) -> Vec<f64> {
        let n = self.columns;
        // Columns of unit length: thresholds and creep columns differ by orders of magnitude.
        let scale: Vec<f64> = (0..n).map(|i| 1.0 / self.products[i * n + i].max(1e-30).sqrt()).collect();
        let gram: Vec<f64> = (0..n * n)
            .map(|at| {
                let (row, column) = (at / n, at % n);
                // A ridge far below what noise does keeps twin columns apart.
                self.products[at] * scale[row] * scale[column] + if row == column { 1e-9 } else { 0.0 }
            })
            .collect();
        let right: Vec<f64> = (0..n).map(|i| self.target[i] * scale[i]).collect();
        let bounded: Vec<bool> = free.iter().map(|free| !free).collect();
        let begin: Vec<bool> = (0..n).map(|at| last.get(at).is_some_and(|weight| *weight != 0.0)).collect();
        let mut weights = nnls::solve_definite(&gram, &right, &bounded, &begin).unwrap_or_else(|| nnls::solve(&gram, &right, &bounded));
        for (weight, scale) in weights.iter_mut().zip(&scale) {
            *weight *= scale;
        }
        weights
    }
}

/// Rows that are multiplied with as many of the other factor at a time.
const TALL: usize = 4;

/// Samples whose rows stay in the processor's first cache.
const BLOCK: usize = 64;

/// Adds the products of all columns of `left` with all of `right` over the samples of `range` to `sums`, `left.stride` rows of
/// `right.stride`.
///
/// In which order a sum is made does not hang on how much a processor takes at a time.
pub fn add_products(left: &Rows, right: &Rows, range: Range<usize>, sums: &mut Vec<f64>) {
    sums.resize(left.stride * right.stride, 0.0);
    if !sums.is_empty() {
        Arch::new().dispatch(Products { left, right, range, sums });
    }
}

/// Adds the products of all columns with each other over the samples of `range` to `sums`, `rows.stride` rows of as many; those below the
/// diagonal are no use.
///
/// Large operators stand still most of the time, and the smaller an operator the farther in front it is. So columns at the end that stand
/// still for a while are taken out of the sums for as long.
pub fn add_squares(rows: &Rows, range: Range<usize>, sums: &mut Vec<f64>) {
    sums.resize(rows.stride * rows.stride, 0.0);
    if !sums.is_empty() {
        Arch::new().dispatch(Squares { rows, range, sums });
    }
}

/// The arguments of [`add_products`].
struct Products<'a> {
    left: &'a Rows,
    right: &'a Rows,
    range: Range<usize>,
    sums: &'a mut [f64],
}

impl WithSimd for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { left, right, range, sums } = self;
        let lefts = left.values[range.start * left.stride..range.end * left.stride].chunks(BLOCK * left.stride);
        let rights = right.values[range.start * right.stride..range.end * right.stride].chunks(BLOCK * right.stride);
        for (lefts, rights) in lefts.zip(rights) {
            for row in (0..left.stride).step_by(TALL) {
                for column in (0..right.stride).step_by(SIDE) {
                    let tile = tile(lefts, left.stride, row, rights, right.stride, column);
                    add_tile(tile, sums, right.stride, row, column);
                }
            }
        }
    }
}

/// The arguments of [`add_squares`].
struct Squares<'a> {
    rows: &'a Rows,
    range: Range<usize>,
    sums: &'a mut [f64],
}

impl WithSimd for Squares<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let stride = self.rows.stride;
        let values = &self.rows.values[self.range.start * stride..self.range.end * stride];
        let mut totals = vec![0.0; stride];
        for block in values.chunks(BLOCK * stride) {
            let moving = moving(simd, block, stride);
            for row in (0..moving).step_by(TALL) {
                for column in (row / SIDE * SIDE..moving).step_by(SIDE) {
                    let tile = tile(block, stride, row, block, stride, column);
                    add_tile(tile, self.sums, stride, row, column);
                }
            }
            if moving == stride {
                continue;
            }
            let (first, samples) = (&block[..stride], (block.len() / stride) as f64);
            totals[..moving].fill(0.0);
            for row in block.chunks_exact(stride) {
                totals[..moving].iter_mut().zip(row).for_each(|(total, value)| *total += value);
            }
            totals[moving..].iter_mut().zip(&first[moving..]).for_each(|(total, still)| *total = samples * still);
            for (line, total) in self.sums.chunks_exact_mut(stride).zip(&totals) {
                line[moving..].iter_mut().zip(&first[moving..]).for_each(|(sum, still)| *sum += total * still);
            }
        }
    }
}

/// Columns of a block in front of those that stand still at its end, a multiple of [`SIDE`].
#[inline(always)]
fn moving<S: Simd>(simd: S, block: &[f64], stride: usize) -> usize {
    let vectors = stride / S::F64_LANES;
    let (first, _) = S::as_simd_f64s(&block[..stride]);
    let mut still = vectors;
    while still > 0 {
        let at = still - 1;
        let mut apart = simd.splat_f64s(0.0);
        for row in block.chunks_exact(stride) {
            let (row, _) = S::as_simd_f64s(row);
            apart = simd.add_f64s(apart, simd.abs_f64s(simd.sub_f64s(row[at], first[at])));
        }
        // What is no number does not stand still either.
        if simd.reduce_sum_f64s(apart) != 0.0 {
            break;
        }
        still = at;
    }
    (still * S::F64_LANES).next_multiple_of(SIDE)
}

/// Adds the sums of a tile where they belong.
#[inline(always)]
fn add_tile(tile: [[f64; SIDE]; TALL], sums: &mut [f64], stride: usize, row: usize, column: usize) {
    for (line, tile) in sums[row * stride..].chunks_mut(stride).zip(tile) {
        for (sum, value) in line[column..].iter_mut().zip(tile) {
            *sum += value;
        }
    }
}

/// Products of a few columns with a few others.
#[inline(always)]
fn tile(lefts: &[f64], left_stride: usize, row: usize, rights: &[f64], right_stride: usize, column: usize) -> [[f64; SIDE]; TALL] {
    let mut sums = [[0.0; SIDE]; TALL];
    for (left, right) in lefts.chunks_exact(left_stride).zip(rights.chunks_exact(right_stride)) {
        let left: &[f64] = &left[row..row + TALL];
        let right: &[f64] = &right[column..column + SIDE];
        for (sums, left) in sums.iter_mut().zip(left) {
            for (sum, right) in sums.iter_mut().zip(right) {
                *sum += left * right;
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        }
    }

    #[test]
    fn a_weight_beside_others_is_what_they_leave_of_its_column() {
        // Columns (1, 1, 1) and (1, 2, 3), and the measured output 4 + 0.5 t.
        let gram = Gram { columns: 2, products: vec![3.0, 6.0, 6.0, 14.0], target: vec![15.0, 31.0], energy: 0.0, samples: 3.0 };
        assert!((gram.weight_beside(1, &[4.0, 0.0]) - 0.5).abs() < 1e-12);
        assert!((gram.weight_beside(0, &[0.0, 0.5]) - 4.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_not_finite_explains_nothing() {
        let gram = Gram { columns: 1, products: vec![1.0], target: vec![1.0], energy: 1.0, samples: 1.0 };
        assert_eq!([1.0, f64::NAN, f64::INFINITY].map(|weight| gram.mean_square(&[weight])), [0.0, f64::MAX, f64::MAX]);
    }

    #[test]
    fn products_are_those_of_the_columns_over_the_range() {
        let mut noise = noise(3);
        let mut rows = |count: usize, stride: usize| {
            let mut rows = Rows::default();
            rows.shape(200, count, stride);
            rows.values.fill_with(&mut noise);
            rows
        };
        let (left, right) = (rows(13, 16), rows(7, 8));
        let mut resting = rows(31, 32);
        for (sample, row) in resting.values.chunks_exact_mut(32).enumerate() {
            // The last ten always stand still, the ten before them for a while, as large operators do.
            row[22..].fill(0.7);
            if sample > 50 {
                row[12..22].fill(-0.3);
            }
        }
        let check = |one: &Rows, other: &Rows, sums: &[f64], from: &dyn Fn(usize) -> usize| {
            for row in 0..one.stride {
                for column in from(row)..other.stride {
                    let wanted: f64 = (7..183).map(|at| one.values[at * one.stride + row] * other.values[at * other.stride + column]).sum();
                    let got = sums[row * other.stride + column];
                    assert!((got - wanted).abs() < 1e-12, "{row}, {column}: {got} instead of {wanted}");
                }
            }
        };
        let mut sums = Vec::new();
        add_products(&left, &right, 7..183, &mut sums);
        check(&left, &right, &sums, &|_| 0);
        for rows in [&left, &resting] {
            let mut sums = Vec::new();
            add_squares(rows, 7..183, &mut sums);
            check(rows, rows, &sums, &|row| row);
        }
    }

    #[test]
    fn the_weights_are_the_same_wherever_the_search_for_them_begins_and_no_other_leave_less() {
        for seed in 0..20 {
            let mut noise = noise(seed);
            let (n, samples) = (12, 40);
            let rows: Vec<Vec<f64>> = (0..samples).map(|_| (0..n).map(|_| noise()).collect()).collect();
            // Neighbours much alike, as operators are.
            let rows: Vec<Vec<f64>> = rows.iter().map(|row| (0..n).map(|at| row[at / 3] + 0.01 * row[at]).collect()).collect();
            let target: Vec<f64> = rows.iter().map(|row| row[4] + 0.5 * row[8] + noise()).collect();
            let mut gram = Gram::new(n);
            for (row, y) in rows.iter().zip(&target) {
                for i in 0..n {
                    gram.target[i] += row[i] * y;
                    (0..n).for_each(|j| gram.products[i * n + j] += row[i] * row[j]);
                }
                gram.energy += y * y;
                gram.samples += 1.0;
            }
            let free: Vec<bool> = (0..n).map(|at| at == 0).collect();
            let cold = gram.solve(&free, &[]);
            let warm = gram.solve(&free, &cold);
            let far: Vec<f64> = cold.iter().map(|weight| if *weight == 0.0 { 1.0 } else { 0.0 }).collect();
            assert_eq!(cold, warm);
            assert_eq!(cold, gram.solve(&free, &far), "seed {seed}");
            let held = cold[1..].iter().filter(|weight| **weight == 0.0).count();
            assert!(cold[1..].iter().all(|weight| *weight >= 0.0) && (1..11).contains(&held), "seed {seed}: {held} weights are held");
            // Kuhn and Tucker: no gradient in what is in use, none upwards on what is not.
            for at in 0..n {
                let gradient = gram.target[at] - gram.products[at * n..(at + 1) * n].iter().zip(&cold).map(|(x, y)| x * y).sum::<f64>();
                assert!(
                    gradient < 1e-6 && (cold[at] == 0.0 || gradient.abs() < 1e-6),
                    "seed {seed}: a gradient of {gradient} at weight {at}"
                );
            }
        }
    }

    #[test]
    fn a_repeated_column_and_an_empty_one_do_no_harm() {
        let mut gram = Gram::new(3);
        for at in 0..20 {
            let (t, y) = (f64::from(at), 2.0 * f64::from(at));
            for (i, x) in [t, t, 0.0].into_iter().enumerate() {
                gram.target[i] += x * y;
                [t, t, 0.0].into_iter().enumerate().for_each(|(j, other)| gram.products[i * 3 + j] += x * other);
            }
            gram.energy += y * y;
            gram.samples += 1.0;
        }
        let weights = gram.solve(&[true, false, false], &[]);
        assert!((weights[0] + weights[1] - 2.0).abs() < 1e-6 && weights[2] == 0.0, "{weights:?}");
        assert!(gram.mean_square(&weights) < 1e-9);
    }
}
