//! Second moments of columns and output: all that weights, residuals and cross-validation need of the samples.

use gemm::Parallelism;

use crate::{Series, Structure, Unit};

/// Sums over the samples of one unit.
#[derive(Clone, Debug)]
pub struct Moments {
    /// Samples.
    pub samples: f64,
    /// Sum of each column.
    pub columns: Vec<f64>,
    /// Sum of the output.
    pub output: f64,
    /// Sums of products of columns, square and symmetric.
    pub gram: Vec<f64>,
    /// Sums of products of columns and output.
    pub cross: Vec<f64>,
    /// Sum of the output's squares.
    pub square: f64,
    /// Smallest and largest output.
    pub range: (f64, f64),
}

/// One [`Moments`] a unit. Every `stride`-th sample counts; memory moves with all of them. `origin` is taken off the output first, so
/// that squares do not drown in its mean.
#[must_use]
pub fn moments(structure: &Structure, series: &[Series], units: &[Unit], stride: usize, origin: f64) -> Vec<Moments> {
    let mut result: Vec<Option<Moments>> = vec![None; units.len()];
    for (index, one) in series.iter().enumerate() {
        let own: Vec<usize> = (0..units.len()).filter(|&unit| units[unit].series == index).collect();
        if own.is_empty() {
            continue;
        }
        let rows: Vec<usize> = own.iter().map(|&unit| units[unit].samples.len().div_ceil(stride)).collect();
        let width = structure.columns.len();
        let mut matrices: Vec<Vec<f64>> = rows.iter().map(|&rows| Vec::with_capacity(rows * width)).collect();
        let inputs: Vec<&[f64]> = one.inputs.iter().map(Vec::as_slice).collect();
        structure.for_each_column(&inputs, &one.gaps, |_, values| {
            for (matrix, &unit) in matrices.iter_mut().zip(&own) {
                matrix.extend(units[unit].samples.clone().step_by(stride).map(|sample| values[sample]));
            }
        });
        for ((matrix, &unit), &rows) in matrices.iter().zip(&own).zip(&rows) {
            let output: Vec<f64> = units[unit].samples.clone().step_by(stride).map(|sample| one.output[sample] - origin).collect();
            result[unit] = Some(Moments::of(matrix, rows, width, &output));
        }
    }
    result.into_iter().flatten().collect()
}

impl Moments {
    /// Of a column-major matrix of `rows` by `width` and an output.
    fn of(matrix: &[f64], rows: usize, width: usize, output: &[f64]) -> Self {
        let column = |index: usize| &matrix[index * rows..(index + 1) * rows];
        let mut gram = vec![0.0; width * width];
        if width > 0 && rows > 0 {
            product(&mut gram, matrix, width, rows);
        }
        let (low, high) = output.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &y| (low.min(y), high.max(y)));
        Self {
            samples: rows as f64,
            columns: (0..width).map(|index| column(index).iter().sum()).collect(),
            output: output.iter().sum(),
            gram,
            cross: (0..width).map(|index| column(index).iter().zip(output).map(|(x, y)| x * y).sum()).collect(),
            square: output.iter().map(|y| y * y).sum(),
            range: (low, high),
        }
    }

    /// Root mean square of `output - constant - weights . columns`.
    #[must_use]
    pub fn rmse(&self, constant: f64, weights: &[f64]) -> f64 {
        let width = weights.len();
        let mut sum = self.square - 2.0 * constant * self.output + constant * constant * self.samples;
        for (row, &weight) in weights.iter().enumerate() {
            let product: f64 = self.gram[row * width..][..width].iter().zip(weights).map(|(gram, other)| gram * other).sum();
            sum += weight * (product - 2.0 * self.cross[row] + 2.0 * constant * self.columns[row]);
        }
        (sum.max(0.0) / self.samples.max(1.0)).sqrt()
    }

    /// Root mean square of the same when the best constant for these samples is known, and that constant.
    #[must_use]
    pub fn rmse_with_own_zero(&self, weights: &[f64]) -> (f64, f64) {
        let predicted: f64 = weights.iter().zip(&self.columns).map(|(weight, sum)| weight * sum).sum();
        let zero = (self.output - predicted) / self.samples.max(1.0);
        (self.rmse(zero, weights), zero)
    }
}

/// `gram = matrix^T matrix` of a column-major matrix.
fn product(gram: &mut [f64], matrix: &[f64], width: usize, rows: usize) {
    assert!(gram.len() == width * width && matrix.len() == width * rows, "the slices are as long as the shapes say");
    let (wide, stride) = (width.cast_signed(), rows.cast_signed());
    // SAFETY: lengths are asserted above; the strides stay within them, and `gram` overlaps nothing.
    unsafe {
        gemm::gemm(
            width,
            width,
            rows,
            gram.as_mut_ptr(),
            wide,
            1,
            false,
            matrix.as_ptr(),
            1,
            stride,
            matrix.as_ptr(),
            stride,
            1,
            0.0,
            1.0,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Basis, Column, OutputPath, Scaling};

    #[test]
    fn errors_by_moments_are_those_by_samples() {
        let input: Vec<f64> = (0..500).map(|k| (f64::from(k) * 0.05).sin()).collect();
        let output: Vec<f64> = (0..500).map(|k| 40.0 + (f64::from(k) * 0.05 - 0.3).sin()).collect();
        let series = [Series { name: "a".into(), group: String::new(), inputs: vec![input], output, gaps: vec![200], skip: 7 }];
        let column = |basis| Column { basis, lag: None };
        let structure = Structure {
            sample_period_s: 0.01,
            dead_time_s: 0.013,
            lag_s: 0.02,
            scalings: vec![Scaling { centre: 0.1, half: 0.8 }],
            rest: Some(vec![0.0]),
            output_path: OutputPath::Lag { time_constant_s: 0.03 },
            columns: vec![column(Basis::Polynomial { input: 0, degree: 2 }), column(Basis::Play { input: 0, threshold: 0.3 })],
        };
        let units = [Unit { series: 0, samples: 7..300 }, Unit { series: 0, samples: 300..500 }];
        let moments = moments(&structure, &series, &units, 3, 40.0);
        let (constant, weights) = (0.2, [0.7, -0.4]);
        let mut predicted = vec![40.0 + constant; 500];
        structure.for_each_column(&[&series[0].inputs[0]], &series[0].gaps, |index, values| {
            predicted.iter_mut().zip(values).for_each(|(sum, value)| *sum += weights[index] * value);
        });
        for (unit, moments) in units.iter().zip(&moments) {
            let errors: Vec<f64> = unit.samples.clone().step_by(3).map(|k| series[0].output[k] - predicted[k]).collect();
            let rmse = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
            assert!((moments.rmse(constant, &weights) - rmse).abs() < 1e-12);
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            let (own, zero) = moments.rmse_with_own_zero(&weights);
            assert!((zero - constant - mean).abs() < 1e-12);
            assert!((own - (rmse * rmse - mean * mean).sqrt()).abs() < 1e-9);
        }
    }
}
