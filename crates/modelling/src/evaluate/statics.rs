//! The lowest rung of the ladder: a polynomial of the input, without any memory.
//!
//! What it cannot explain is an upper bound of the hysteresis in the data (and of everything else it lacks).

use std::path::PathBuf;

use anyhow::{Result, bail};

use crate::model::{Arithmetic, Description, ModelError, Predictor};
use recording::Recording;

/// Degree of the polynomial: bends and saturates, and does not ring between samples.
pub const DEGREE: usize = 5;

/// A polynomial in the input, scaled to -1 to 1 over the range of the fitted data and held beyond it.
pub struct Polynomial {
    /// Coefficients of the Chebyshev polynomials, lowest first.
    coefficients: [f64; DEGREE + 1],
    middle: f64,
    half: f64,
    description: Description,
}

impl Polynomial {
    /// Fits the output of all recordings by least squares.
    ///
    /// # Errors
    /// When there is no recording or the input never moves.
    pub fn fit(recordings: &[Recording], skip_s: f64) -> Result<Self> {
        let Some(first) = recordings.first() else { bail!("there are no recordings to fit a static curve to") };
        let counted = |recording: &Recording| {
            let begin_s = recording.time_s[0] + skip_s;
            recording.time_s.partition_point(|&time_s| time_s < begin_s)
        };
        let samples: Vec<(f64, f64)> = recordings
            .iter()
            .flat_map(|recording| (counted(recording)..recording.len()).map(|index| (recording.input[index], recording.output[index])))
            .collect();
        let (low, high) =
            samples.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &(input, _)| (low.min(input), high.max(input)));
        if high <= low {
            bail!("the input never moves; a static curve cannot be fitted");
        }
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
        let mut matrix = [[0.0; DEGREE + 1]; DEGREE + 1];
        let mut right = [0.0; DEGREE + 1];
        for &(input, output) in &samples {
            let basis = chebyshev((input - middle) / half);
            for row in 0..=DEGREE {
                right[row] += basis[row] * output;
                for column in 0..=DEGREE {
                    matrix[row][column] += basis[row] * basis[column];
                }
            }
        }
        let description = Description {
            path: PathBuf::from("static"),
            kind: format!("polynomial of degree {DEGREE}, no memory"),
            arithmetic: Arithmetic::Physics,
            input: first.input_signal.clone(),
            more_inputs: Vec::new(),
            output: first.output_signal.clone(),
            input_range: Some((low, high)),
            sample_period_s: None,
            parameters: DEGREE + 1,
            macs_per_step: DEGREE,
        };
        Ok(Self { coefficients: solve(matrix, right), middle, half, description })
    }

    /// The output for one input.
    #[must_use]
    pub fn at(&self, input: f64) -> f64 {
        let basis = chebyshev(((input - self.middle) / self.half).clamp(-1.0, 1.0));
        basis.iter().zip(&self.coefficients).map(|(basis, coefficient)| basis * coefficient).sum()
    }
}

/// Chebyshev polynomials of the first kind: well conditioned on -1 to 1.
fn chebyshev(x: f64) -> [f64; DEGREE + 1] {
    let mut values = [1.0, x, 0.0, 0.0, 0.0, 0.0];
    for index in 2..=DEGREE {
        values[index] = 2.0 * x * values[index - 1] - values[index - 2];
    }
    values
}

/// Solves the normal equations by Cholesky factorisation; directions without data (too few different inputs) get zero.
fn solve(mut matrix: [[f64; DEGREE + 1]; DEGREE + 1], mut right: [f64; DEGREE + 1]) -> [f64; DEGREE + 1] {
    let scale = matrix[0][0].max(f64::MIN_POSITIVE);
    for column in 0..=DEGREE {
        let pivot = matrix[column][column] - (0..column).map(|k| matrix[column][k] * matrix[column][k]).sum::<f64>();
        // Twelve digits below the largest entry is rounding, not information.
        let usable = pivot > 1e-12 * scale;
        let diagonal = if usable { pivot.sqrt() } else { f64::INFINITY };
        matrix[column][column] = diagonal;
        for row in column + 1..=DEGREE {
            let sum = matrix[row][column] - (0..column).map(|k| matrix[row][k] * matrix[column][k]).sum::<f64>();
            matrix[row][column] = sum / diagonal;
        }
    }
    for row in 0..=DEGREE {
        let sum = right[row] - (0..row).map(|k| matrix[row][k] * right[k]).sum::<f64>();
        right[row] = sum / matrix[row][row];
    }
    for row in (0..=DEGREE).rev() {
        let sum = right[row] - (row + 1..=DEGREE).map(|k| matrix[k][row] * right[k]).sum::<f64>();
        right[row] = sum / matrix[row][row];
    }
    right
}

impl Predictor for Polynomial {
    fn description(&self) -> &Description {
        &self.description
    }

    fn predict(&self, input: &[f64], _gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        Ok(input.iter().map(|&input| self.at(input)).collect())
    }
}
