//! Weights from moments: ridge regression, and non-negative least squares where a sign is physics.
//!
//! Minimised is `sum (y - c_r - w . x)^2 / n + penalty sum_j w_j^2` (A. Hoerl and R. Kennard, Technometrics 12, 1970), where `c_r` is one
//! constant, or one for each recording, and bears no penalty. Columns are not standardised: each moves over about -1..1 when its
//! input crosses the whole range, so a weight says what the output may do there. A column that hardly moved in the data (a slow
//! lag, a wide play operator) would need a large weight to matter, and that is what must be dear: another recording may move it.

use std::collections::BTreeMap;

use crate::linear::cholesky;
use crate::{Fit, Moments, nnls};

/// Ridge penalties that are tried.
pub const PENALTIES: [f64; 6] = [1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2];
/// The same where signs are bound, which regularises by itself; the first is next to nothing, for data without noise.
pub const BOUND_PENALTIES: [f64; 5] = [1e-12, 1e-6, 1e-5, 1e-4, 1e-3];

/// Which weights are bound in sign.
#[derive(Clone, Debug, PartialEq)]
pub enum Signs {
    /// None.
    Free,
    /// 1: at or above zero; -1: at or below zero; 0: free. One a column.
    Bound(Vec<i8>),
}

/// A fitted sum.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// Constant; the mean of the recordings' constants where each has its own.
    pub constant: f64,
    /// One weight a column.
    pub columns: Vec<f64>,
}

/// The normal equations of some units with the constants projected out.
pub struct Normal {
    gram: Vec<f64>,
    cross: Vec<f64>,
    /// Standard deviation of each column.
    spread: Vec<f64>,
    samples: f64,
    /// Which constant each unit has, before and behind its recording's candidate step.
    zeros: Vec<[usize; 2]>,
}

impl Normal {
    /// Adds up the units of a fit; parts of units with equal numbers in `zeros`, before and behind a candidate step, share a constant.
    #[must_use]
    pub fn new(moments: &[Moments], fit: &Fit, zeros: &[[usize; 2]]) -> Self {
        let width = moments.first().map_or(0, |first| first.columns.len());
        let empty = vec![0.0; width];
        let mut sum =
            Self { gram: vec![0.0; width * width], cross: empty.clone(), spread: empty.clone(), samples: 0.0, zeros: zeros.to_vec() };
        let mut shared: BTreeMap<usize, (Vec<f64>, f64, f64)> = BTreeMap::new();
        for &unit in fit.units() {
            let one = &moments[unit];
            sum.gram.iter_mut().zip(&one.gram).for_each(|(sum, value)| *sum += value);
            sum.cross.iter_mut().zip(&one.cross).for_each(|(sum, value)| *sum += value);
            sum.samples += one.samples;
            let mut add = |owner: usize, part_columns: &[f64], part_output: f64, part_samples: f64| {
                let (columns, output, samples) = shared.entry(owner).or_insert_with(|| (empty.clone(), 0.0, 0.0));
                columns.iter_mut().zip(part_columns).for_each(|(sum, value)| *sum += value);
                *output += part_output;
                *samples += part_samples;
            };
            let [before, behind] = zeros[unit];
            if before == behind || one.behind.is_none() {
                add(before, &one.columns, one.output, one.samples);
            } else {
                for (owner, part) in [before, behind].into_iter().zip(one.sections()) {
                    add(owner, &part.columns, part.output, part.samples);
                }
            }
        }
        for (columns, output, samples) in shared.values() {
            sum.take_off(columns, *output, *samples);
        }
        for column in 0..width {
            sum.spread[column] = (sum.gram[column * width + column].max(0.0) / sum.samples.max(1.0)).sqrt();
        }
        sum
    }

    /// Takes off what a constant explains.
    fn take_off(&mut self, columns: &[f64], output: f64, samples: f64) {
        let width = columns.len();
        let share = 1.0 / samples.max(1.0);
        for (row, &left) in columns.iter().enumerate() {
            for (cell, &right) in self.gram[row * width..][..width].iter_mut().zip(columns) {
                *cell -= share * left * right;
            }
            self.cross[row] -= share * left * output;
        }
    }

    /// The weights for a penalty; columns without spread get zero. `None` when the data do not determine them.
    #[must_use]
    pub fn solve(&self, moments: &[Moments], fit: &Fit, penalty: f64, signs: &Signs) -> Option<Weights> {
        let width = self.cross.len();
        let largest = self.spread.iter().copied().fold(0.0, f64::max);
        let used: Vec<usize> = (0..width).filter(|&column| self.spread[column] > 1e-9 * largest).collect();
        let n = used.len();
        let sign = |column: usize| match signs {
            Signs::Bound(bound) if bound[column] < 0 => -1.0,
            _ => 1.0,
        };
        // Columns scaled to ones on the diagonal, for the sake of rounding; the penalty stays that of the columns as they are.
        let mut gram = vec![0.0; n * n];
        let mut right = vec![0.0; n];
        for (i, &row) in used.iter().enumerate() {
            for (j, &column) in used.iter().enumerate() {
                let scale = self.samples * sign(row) * self.spread[row] * sign(column) * self.spread[column];
                gram[i * n + j] = self.gram[row * width + column] / scale;
            }
            gram[i * n + i] += penalty / self.spread[row].powi(2);
            right[i] = self.cross[row] / (self.samples * sign(row) * self.spread[row]);
        }
        let standard = match signs {
            Signs::Free => cholesky(gram, right)?,
            Signs::Bound(bound) => {
                let bound: Vec<bool> = used.iter().map(|&column| bound[column] != 0).collect();
                nnls::solve_definite(&gram, &right, &bound, &vec![false; n])?
            }
        };
        let mut columns = vec![0.0; width];
        for (&column, value) in used.iter().zip(standard) {
            columns[column] = sign(column) * value / self.spread[column];
        }
        if columns.iter().any(|weight| !weight.is_finite()) {
            return None;
        }
        // Each recording is one observation of where its sensor was set to zero; what lies behind a step with a zero of its own is none.
        let mut sums: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
        for &unit in fit.units() {
            let one = &moments[unit];
            let [before, behind] = self.zeros[unit];
            let mut add = |part_columns: &[f64], part_output: f64, part_samples: f64| {
                let predicted: f64 = columns.iter().zip(part_columns).map(|(weight, sum)| weight * sum).sum();
                let (left, samples) = sums.entry(before).or_insert((0.0, 0.0));
                *left += part_output - predicted;
                *samples += part_samples;
            };
            if before == behind || one.behind.is_none() {
                add(&one.columns, one.output, one.samples);
            } else {
                let [first, _] = one.sections();
                add(&first.columns, first.output, first.samples);
            }
        }
        let zeros: Vec<f64> = sums.values().filter(|sum| sum.1 > 0.0).map(|(left, samples)| left / samples).collect();
        let constant = zeros.iter().sum::<f64>() / zeros.len().max(1) as f64;
        Some(Weights { constant, columns })
    }
}
