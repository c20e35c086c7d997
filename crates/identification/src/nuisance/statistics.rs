//! The statistics that decide: a line through values, the chance of an F, and a range.

use statrs::function::beta::beta_reg;

/// Chance at which a test names what is not there.
pub(super) const LEVEL: f64 = 0.005;

/// Least squares of values on a constant and columns: coefficients of the columns, sum of squares left, and the sum of squares left where
/// each value is predicted from the others.
pub(super) fn line(columns: &[&[f64]], values: &[f64]) -> Option<(Vec<f64>, f64, f64)> {
    let width = columns.len() + 1;
    let row = |index: usize| -> Vec<f64> { std::iter::once(1.0).chain(columns.iter().map(|column| column[index])).collect() };
    let mut system = crate::linear::Compressed::new(width);
    (0..values.len()).for_each(|index| system.push(&row(index), values[index]));
    let solution = system.solve(&vec![true; width]);
    let inverse = system.inverse_gram(&(0..width).collect::<Vec<_>>());
    if !solution.coefficients.iter().chain(&inverse).all(|value| value.is_finite()) {
        return None;
    }
    let mut left_out = 0.0;
    for (index, value) in values.iter().enumerate() {
        let row = row(index);
        let predicted: f64 = row.iter().zip(&solution.coefficients).map(|(one, other)| one * other).sum();
        let leverage: f64 = (0..width).map(|i| (0..width).map(|j| row[i] * inverse[i * width + j] * row[j]).sum::<f64>()).sum();
        left_out += ((value - predicted) / (1.0 - leverage).max(1e-9)).powi(2);
    }
    Some((solution.coefficients[1..].to_vec(), solution.squared_residual, left_out))
}

/// The chance that Snedecor's F with these degrees of freedom lies above a value (M. Abramowitz and I. Stegun, 26.6.2).
pub(super) fn f_beyond(value: f64, above: f64, below: f64) -> f64 {
    if value.is_nan() {
        return 1.0;
    }
    beta_reg(0.5 * below, 0.5 * above, below / (below + above * value.max(0.0)))
}

pub(super) fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chances_are_those_of_tables() {
        // Snedecor's F at its 99 % points.
        for (above, below, point) in [(1.0, 10.0, 10.04), (5.0, 6.0, 8.746), (2.0, 3.0, 30.82), (19.0, 20.0, 2.96)] {
            let chance = f_beyond(point, above, below);
            assert!((chance - 0.01).abs() < 2e-4, "F({above}, {below}) beyond {point}: {chance}");
        }
        assert!((f_beyond(0.0, 2.0, 3.0) - 1.0).abs() < 1e-12 && f_beyond(f64::INFINITY, 2.0, 3.0) < 1e-12);
    }
}
