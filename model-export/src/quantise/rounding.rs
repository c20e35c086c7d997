//! Rows rounded to integers: each weight by itself, or with error feedback.

use std::vec::Vec;

use crate::schema::{Cell, Gate};

/// Two to that power.
pub fn power(exponent: i32) -> f64 {
    2f64.powi(exponent)
}

/// A row in integers; it may have no inputs, or nothing else.
pub struct RoundedRow {
    pub integers: Vec<i8>,
    pub inputs: usize,
    pub input_scale: f64,
    pub recurrent_scale: f64,
    pub bias: f64,
}

fn widest_scale(weights: &[f32]) -> f64 {
    weights.iter().fold(0.0, |largest: f64, weight| largest.max(f64::from(weight.abs()))) / 127.0
}

/// The nearest integer of 8 bits, symmetric.
fn round_weight(weight: f64, scale: f64) -> i8 {
    if scale > 0.0 { (weight / scale).round().clamp(-127.0, 127.0) as i8 } else { 0 }
}

pub fn nearest(input: &[f32], recurrent: &[f32], bias: f32) -> RoundedRow {
    let (input_scale, recurrent_scale) = (widest_scale(input), widest_scale(recurrent));
    let mut integers: Vec<i8> = input.iter().map(|weight| round_weight(f64::from(*weight), input_scale)).collect();
    integers.extend(recurrent.iter().map(|weight| round_weight(f64::from(*weight), recurrent_scale)));
    RoundedRow { integers, inputs: input.len(), input_scale, recurrent_scale, bias: f64::from(bias) }
}

/// The factors that tell how the columns still to be rounded make up for one that has been.
pub struct Feedback {
    width: usize,
    moments: Vec<f64>,
    clips: Vec<f64>,
    /// Upper Cholesky factor of the inverse of the (damped) moments, row-major.
    factor: Vec<f64>,
}

/// Part of the mean diagonal added to the moments: what calibration has not seen must not become free.
const DAMPING: f64 = 1e-3;

/// Ends of the scale that are tried, as parts of the largest weight.
const CLIPS: [f64; 8] = [1.0, 0.96, 0.92, 0.88, 0.84, 0.8, 0.72, 0.64];
/// As many that are tried in layers that were not trained with the quantiser in the loop: with a few weights in a row, there is a scale of
/// which all are nearly multiples.
const FINE_CLIPS: u8 = 96;

impl Feedback {
    /// For the rows of a gate of a layer with these moments: of them, the columns that the gate sees.
    pub fn new(moments: &[f64], inputs: usize, units: usize, (cell, gate): (Cell, Gate)) -> Self {
        let seen = |column: usize| match column {
            _ if column < inputs => gate.input.is_some(),
            _ if column < inputs + units => gate.recurrent.is_some(),
            _ => true,
        };
        let columns: Vec<usize> = (0..=inputs + units).filter(|column| seen(*column)).collect();
        let width = columns.len();
        let pairs = columns.iter().flat_map(|row| columns.iter().map(move |column| row * (inputs + units + 1) + column));
        let mut damped: Vec<f64> = pairs.map(|index| moments[index]).collect();
        let mean = (0..width).map(|index| damped[index * width + index]).sum::<f64>() / width.max(1) as f64;
        for index in 0..width {
            damped[index * width + index] += DAMPING * mean + 1e-12;
        }
        let factor = upper_factor_of_inverse(&damped, width);
        let clips = match cell {
            Cell::Lstm => CLIPS.to_vec(),
            Cell::Gru | Cell::Dense(_) => (0..FINE_CLIPS).map(|index| 1.0 - 0.4 * f64::from(index) / f64::from(FINE_CLIPS)).collect(),
        };
        Self { width, moments: damped, clips, factor }
    }

    /// The better scales and integers of a row.
    pub fn search(&self, input: &[f32], recurrent: &[f32], bias: f32) -> RoundedRow {
        let widest = (widest_scale(input), widest_scale(recurrent));
        let mut best = self.round(input, recurrent, bias, widest);
        // One scale after the other; the second search starts from what the first found.
        for which in 0..2 {
            for clip in &self.clips {
                let scales = if which == 0 { (best.0.input_scale, clip * widest.1) } else { (clip * widest.0, best.0.recurrent_scale) };
                let trial = self.round(input, recurrent, bias, scales);
                if trial.1 < best.1 {
                    best = trial;
                }
            }
        }
        best.0
    }

    /// Rounds a row with error feedback; also its mean square output error.
    fn round(&self, input: &[f32], recurrent: &[f32], bias: f32, scales: (f64, f64)) -> (RoundedRow, f64) {
        let original: Vec<f64> = input.iter().chain(recurrent).chain([&bias]).map(|value| f64::from(*value)).collect();
        let mut left = original.clone();
        let mut integers = Vec::with_capacity(self.width - 1);
        for column in 0..self.width - 1 {
            let scale = if column < input.len() { scales.0 } else { scales.1 };
            let integer = round_weight(left[column], scale);
            let value = f64::from(integer) * scale;
            let factor = &self.factor[column * self.width..][..self.width];
            let error = (left[column] - value) / factor[column];
            for later in column + 1..self.width {
                left[later] -= error * factor[later];
            }
            left[column] = value;
            integers.push(integer);
        }
        let difference: Vec<f64> = left.iter().zip(&original).map(|(rounded, exact)| rounded - exact).collect();
        let mut cost = 0.0;
        for (row, error) in self.moments.chunks(self.width).zip(&difference) {
            cost += error * row.iter().zip(&difference).map(|(moment, other)| moment * other).sum::<f64>();
        }
        let row =
            RoundedRow { integers, inputs: input.len(), input_scale: scales.0, recurrent_scale: scales.1, bias: left[self.width - 1] };
        (row, cost)
    }
}

/// `U` with `M^-1 = U^T U`, `U` upper triangular, of a symmetric positive definite `M`.
fn upper_factor_of_inverse(matrix: &[f64], width: usize) -> Vec<f64> {
    let inverse = inverse_from_factor(&lower_factor(matrix, width), width);
    let lower = lower_factor(&inverse, width);
    let mut upper = std::vec![0.0; width * width];
    for row in 0..width {
        for column in 0..=row {
            upper[column * width + row] = lower[row * width + column];
        }
    }
    upper
}

/// Cholesky: `L` with `M = L L^T`.
fn lower_factor(matrix: &[f64], width: usize) -> Vec<f64> {
    let mut lower = std::vec![0.0; width * width];
    for row in 0..width {
        for column in 0..=row {
            let dot: f64 = (0..column).map(|k| lower[row * width + k] * lower[column * width + k]).sum();
            let rest = matrix[row * width + column] - dot;
            // Damping keeps the pivot away from zero; the bound only guards against rounding.
            lower[row * width + column] = if row == column { rest.max(1e-300).sqrt() } else { rest / lower[column * width + column] };
        }
    }
    lower
}

fn inverse_from_factor(lower: &[f64], width: usize) -> Vec<f64> {
    let mut inverse = std::vec![0.0; width * width];
    let mut solution = std::vec![0.0; width];
    for column in 0..width {
        for row in 0..width {
            let unit = if row == column { 1.0 } else { 0.0 };
            let dot: f64 = (0..row).map(|k| lower[row * width + k] * solution[k]).sum();
            solution[row] = (unit - dot) / lower[row * width + row];
        }
        for row in (0..width).rev() {
            let dot: f64 = (row + 1..width).map(|k| lower[k * width + row] * solution[k]).sum();
            solution[row] = (solution[row] - dot) / lower[row * width + row];
        }
        for row in 0..width {
            inverse[row * width + column] = solution[row];
        }
    }
    inverse
}
