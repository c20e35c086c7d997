//! Second moments of columns and output: all that weights, residuals and cross-validation need of the samples.

use gemm::Parallelism;

use crate::nuisance::Candidates;
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
    /// Sums from the recording's candidate step on; none without one.
    pub behind: Option<Section>,
    /// Sums with each covariate.
    pub covariates: Vec<CovariateSums>,
}

/// Sums over a part of a unit.
#[derive(Clone, Debug)]
pub struct Section {
    /// Samples.
    pub samples: f64,
    /// Sum of each column.
    pub columns: Vec<f64>,
    /// Sum of the output.
    pub output: f64,
}

/// Sums of products with a covariate.
#[derive(Clone, Debug)]
pub struct CovariateSums {
    /// Of the covariate itself.
    sum: f64,
    /// The same from the candidate step on.
    behind: f64,
    /// With each column.
    columns: Vec<f64>,
    /// With the output.
    output: f64,
    /// With each covariate.
    others: Vec<f64>,
}

/// One [`Moments`] a unit. Every `stride`-th sample counts; memory moves with all of them. `origin` is taken off the output first, so
/// that squares do not drown in its mean.
#[must_use]
pub(crate) fn moments(
    structure: &Structure,
    series: &[Series],
    units: &[Unit],
    stride: usize,
    origin: f64,
    candidates: &Candidates,
) -> Vec<Moments> {
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
            let mut made = Moments::of(matrix, rows, width, &output);
            let first = units[unit].samples.start;
            made.behind = candidates.steps.get(index).copied().flatten().map(|step| {
                // Rows are every `stride`-th sample.
                Section::from(matrix, rows, width, &output, step.saturating_sub(first).div_ceil(stride).min(rows))
            });
            let behind = made.behind.as_ref().map_or(rows, |behind| rows - count(behind.samples));
            let on_rows = |covariate: &crate::Covariate| -> Vec<f64> {
                units[unit].samples.clone().step_by(stride).map(|sample| covariate.values[index][sample]).collect()
            };
            let covariates: Vec<Vec<f64>> = candidates.covariates.iter().map(on_rows).collect();
            made.covariates = covariates.iter().map(|one| CovariateSums::of(one, &covariates, matrix, width, &output, behind)).collect();
            result[unit] = Some(made);
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
            behind: None,
            covariates: Vec::new(),
        }
    }

    /// The same of the output less what covariates move it by.
    #[must_use]
    pub(crate) fn less(&self, coefficients: &[Option<f64>]) -> Self {
        let mut made = self.clone();
        for (coefficient, sums) in coefficients.iter().zip(&self.covariates) {
            let Some(coefficient) = *coefficient else { continue };
            made.cross.iter_mut().zip(&sums.columns).for_each(|(cross, sum)| *cross -= coefficient * sum);
            made.output -= coefficient * sums.sum;
            if let Some(behind) = &mut made.behind {
                behind.output -= coefficient * sums.behind;
            }
            made.square -= 2.0 * coefficient * sums.output;
            let pairs = coefficients.iter().zip(&sums.others);
            made.square += coefficient * pairs.map(|(other, product)| other.unwrap_or(0.0) * product).sum::<f64>();
        }
        made
    }

    /// Samples, columns and output before and behind the candidate step.
    pub(crate) fn sections(&self) -> [Section; 2] {
        let whole = Section { samples: self.samples, columns: self.columns.clone(), output: self.output };
        let behind = self.behind.clone().unwrap_or_else(|| Section { samples: 0.0, columns: vec![0.0; self.columns.len()], output: 0.0 });
        let before = Section {
            samples: whole.samples - behind.samples,
            columns: whole.columns.iter().zip(&behind.columns).map(|(whole, behind)| whole - behind).collect(),
            output: whole.output - behind.output,
        };
        [before, behind]
    }

    /// Root mean square of `output - zero - weights . columns`, where `constant` is the zero or, without one, the best zero for these
    /// samples is known; `step`: and the best zero behind the candidate step.
    #[must_use]
    pub(crate) fn rmse_beside_nuisances(&self, constant: Option<f64>, step: bool, weights: &[f64]) -> f64 {
        match (constant, step && self.behind.is_some()) {
            (Some(constant), false) => self.rmse(constant, weights),
            (None, false) => self.rmse_with_own_zero(weights).0,
            (_, true) => {
                let [before, behind] = self.sections();
                let left =
                    |section: &Section| section.output - section.columns.iter().zip(weights).map(|(sum, weight)| sum * weight).sum::<f64>();
                let own = |section: &Section| -left(section).powi(2) / section.samples.max(1.0);
                let first = match constant {
                    Some(constant) => constant * (constant * before.samples - 2.0 * left(&before)),
                    None => own(&before),
                };
                let square = self.rmse(0.0, weights).powi(2) * self.samples.max(1.0) + first + own(&behind);
                (square.max(0.0) / self.samples.max(1.0)).sqrt()
            }
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

impl Section {
    /// Of the rows of a column-major matrix from `first` on.
    fn from(matrix: &[f64], rows: usize, width: usize, output: &[f64], first: usize) -> Self {
        Self {
            samples: (rows - first) as f64,
            columns: (0..width).map(|index| matrix[index * rows + first..(index + 1) * rows].iter().sum()).collect(),
            output: output[first..].iter().sum(),
        }
    }
}

impl CovariateSums {
    fn of(values: &[f64], all: &[Vec<f64>], matrix: &[f64], width: usize, output: &[f64], behind: usize) -> Self {
        let rows = values.len();
        let product = |other: &[f64]| values.iter().zip(other).map(|(one, other)| one * other).sum::<f64>();
        Self {
            sum: values.iter().sum(),
            behind: values[behind..].iter().sum(),
            columns: (0..width).map(|index| product(&matrix[index * rows..(index + 1) * rows])).collect(),
            output: product(output),
            others: all.iter().map(|other| product(other)).collect(),
        }
    }
}

/// A sum of ones as a count.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a sum of ones")]
fn count(samples: f64) -> usize {
    samples as usize
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
            widening: None,
            output_path: OutputPath::Lag { time_constant_s: 0.03 },
            columns: vec![column(Basis::Polynomial { input: 0, degree: 2 }), column(Basis::Play { input: 0, threshold: 0.3 })],
        };
        let units = [Unit { series: 0, samples: 7..300 }, Unit { series: 0, samples: 300..500 }];
        let moments = moments(&structure, &series, &units, 3, 40.0, &Candidates::default());
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
