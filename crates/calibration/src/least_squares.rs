//! Least squares with few unknowns, and the covariance of what it finds.

use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::{CalibrationError, Estimate};

/// Pivots below this share of the largest are taken for zero.
const SINGULAR: f64 = 1e-12;

/// A fit with `N` unknowns.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit<const N: usize> {
    /// The unknowns.
    pub coefficients: [f64; N],
    /// Inverse of the normal matrix.
    inverse: [[f64; N]; N],
    /// Standard deviation of the residuals; `None` without degrees of freedom.
    pub residual: Option<f64>,
    quantile: f64,
}

/// Student's t for a two-sided 95 % interval.
fn quantile(degrees: usize) -> f64 {
    StudentsT::new(0.0, 1.0, degrees.max(1) as f64).map_or(f64::NAN, |student| student.inverse_cdf(0.975))
}

impl<const N: usize> Fit<N> {
    /// Fits `value = sum of coefficient * column` to rows of columns and value.
    ///
    /// # Errors
    /// With fewer rows than unknowns, numbers that are none, or columns that depend on each other.
    pub fn of(rows: &[([f64; N], f64)]) -> Result<Self, CalibrationError> {
        if rows.len() < N {
            return Err(CalibrationError::TooFew { found: rows.len(), wanted: N });
        }
        if rows.iter().any(|(columns, value)| !value.is_finite() || columns.iter().any(|column| !column.is_finite())) {
            return Err(CalibrationError::NotFinite("a measurement"));
        }
        let (mut normal, mut right) = ([[0.0; N]; N], [0.0; N]);
        for (columns, value) in rows {
            for row in 0..N {
                right[row] += columns[row] * value;
                for column in 0..N {
                    normal[row][column] += columns[row] * columns[column];
                }
            }
        }
        let inverse = invert(normal).ok_or(CalibrationError::Degenerate("the unknowns"))?;
        let coefficients: [f64; N] = std::array::from_fn(|row| inverse[row].iter().zip(&right).map(|(a, b)| a * b).sum());
        let degrees = rows.len() - N;
        let squares: f64 =
            rows.iter().map(|(columns, value)| (value - columns.iter().zip(&coefficients).map(|(a, b)| a * b).sum::<f64>()).powi(2)).sum();
        let residual = (degrees > 0).then(|| (squares / degrees as f64).sqrt());
        Ok(Self { coefficients, inverse, residual, quantile: quantile(degrees) })
    }

    /// A function of the unknowns, with the interval that its gradient gives by the delta method.
    #[must_use]
    pub fn estimate(&self, value: f64, gradient: [f64; N]) -> Estimate {
        let half_width = self.residual.map(|residual| {
            let variance: f64 =
                (0..N).map(|row| (0..N).map(|column| gradient[row] * self.inverse[row][column] * gradient[column]).sum::<f64>()).sum();
            self.quantile * residual * variance.max(0.0).sqrt()
        });
        Estimate { value, half_width }
    }
}

/// Inverse by Gauss and Jordan with pivoting, after scaling every unknown to a diagonal of one.
fn invert<const N: usize>(mut matrix: [[f64; N]; N]) -> Option<[[f64; N]; N]> {
    let scale: [f64; N] = std::array::from_fn(|index| matrix[index][index].sqrt());
    if scale.iter().any(|scale| scale.is_nan() || *scale <= 0.0) {
        return None;
    }
    for row in 0..N {
        for column in 0..N {
            matrix[row][column] /= scale[row] * scale[column];
        }
    }
    let mut inverse: [[f64; N]; N] = std::array::from_fn(|row| std::array::from_fn(|column| f64::from(u8::from(row == column))));
    for pivot in 0..N {
        let largest = (pivot..N).max_by(|a, b| matrix[*a][pivot].abs().total_cmp(&matrix[*b][pivot].abs()))?;
        matrix.swap(pivot, largest);
        inverse.swap(pivot, largest);
        let factor = matrix[pivot][pivot];
        if factor.abs() < SINGULAR {
            return None;
        }
        matrix[pivot].iter_mut().chain(&mut inverse[pivot]).for_each(|entry| *entry /= factor);
        let (pivot_row, pivot_inverse) = (matrix[pivot], inverse[pivot]);
        for row in (0..N).filter(|row| *row != pivot) {
            let share = matrix[row][pivot];
            for column in 0..N {
                matrix[row][column] -= share * pivot_row[column];
                inverse[row][column] -= share * pivot_inverse[column];
            }
        }
    }
    for row in 0..N {
        for column in 0..N {
            inverse[row][column] /= scale[row] * scale[column];
        }
    }
    Some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_of_a_mean_is_that_of_the_textbook() {
        let fit = Fit::of(&[1.0, 2.0, 4.0, 5.0].map(|value| ([1.0], value))).unwrap();
        let mean = fit.estimate(fit.coefficients[0], [1.0]);
        // s = sqrt(10 / 3), t(0.975; 3) = 3.182446.
        assert!((mean.value - 3.0).abs() < 1e-12);
        assert!((mean.half_width.unwrap() - 3.182_446 * (10.0_f64 / 3.0).sqrt() / 2.0).abs() < 1e-5, "{mean:?}");
    }

    #[test]
    fn what_cannot_be_told_apart_is_refused() {
        let same = [([1.0, 2.0], 1.0), ([1.0, 2.0], 2.0), ([1.0, 2.0], 3.0)];
        assert!(matches!(Fit::of(&same), Err(CalibrationError::Degenerate(_))));
        assert!(matches!(Fit::of(&same[..1]), Err(CalibrationError::TooFew { found: 1, wanted: 2 })));
        assert!(matches!(Fit::of(&[([f64::NAN], 1.0)]), Err(CalibrationError::NotFinite(_))));
    }
}
