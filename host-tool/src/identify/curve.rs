//! The modified Prandtl-Ishlinskii model: the operators' sum bent by a rising, piecewise straight curve.
//!
//! The curve is a superposition of one-sided dead zones (K. Kuhnen, European Journal of Control 9, 2003) written by segments, so that
//! "rising" is a non-negative slope each. Unlike Kuhnen's inverse-side fit the error minimised here is that of the output: by turns
//! the slopes are fitted for given weights, and the weights by a Gauss-Newton step along the curve, both by non-negative least squares.

use super::bank::{Bank, Family, Run};
use super::linear::Compressed;
use super::model::{Curve, range};

/// Weights, constant and curve.
pub(super) struct Bent {
    /// Weights of the operators' signals, with their sign.
    pub weights: Vec<f64>,
    pub constant: f64,
    pub curve: Curve,
    pub squared_residual: f64,
}

/// Turns at most.
const TURNS: usize = 40;

/// Fits the curve and the weights, starting from the weights of the model without curve.
pub(super) fn fit(runs: &[Run], thresholds: &[f64], family: Family, weights: &[f64], segments: usize) -> Bent {
    // A falling output has negative weights; the curve rises, so the sign stays with the weights.
    let sign = if weights.iter().sum::<f64>() < 0.0 { -1.0 } else { 1.0 };
    let sums = sums(runs, thresholds, family, weights);
    let (low, high) = range(&sums);
    let breakpoints: Vec<f64> = (0..=segments).map(|index| low + (high - low) * index as f64 / segments as f64).collect();
    let mut best = bend(runs, thresholds, family, weights.to_vec(), &breakpoints);
    for _ in 0..TURNS {
        let target = straighten(runs, thresholds, family, &best, sign);
        let mut improved = false;
        for share in [1.0, 0.5, 0.25, 0.1, 0.03] {
            let weights = best.weights.iter().zip(&target).map(|(old, new)| old + share * (new - old)).collect();
            let trial = bend(runs, thresholds, family, weights, &breakpoints);
            if trial.squared_residual < best.squared_residual {
                improved = trial.squared_residual < best.squared_residual * (1.0 - 1e-7);
                best = trial;
                break;
            }
        }
        if !improved {
            break;
        }
    }
    best
}

/// The sums of all samples that count, run after run.
fn sums(runs: &[Run], thresholds: &[f64], family: Family, weights: &[f64]) -> Vec<f64> {
    let mut sums = Vec::new();
    visit(runs, thresholds, family, |signals, _| sums.push(weights.iter().zip(signals).map(|(weight, signal)| weight * signal).sum()));
    sums
}

/// Calls `each` with the signals and the output of every sample that counts.
fn visit(runs: &[Run], thresholds: &[f64], family: Family, mut each: impl FnMut(&[f64], f64)) {
    let mut signals = vec![0.0; thresholds.len()];
    for run in runs {
        let mut bank = Bank::new(thresholds, family);
        for (index, &input) in run.input.iter().enumerate() {
            bank.step(input);
            if index >= run.skip {
                signals.iter_mut().enumerate().for_each(|(k, signal)| *signal = bank.signal(k, input));
                each(&signals, run.output[index]);
            }
        }
    }
}

/// The best curve for given weights.
fn bend(runs: &[Run], thresholds: &[f64], family: Family, weights: Vec<f64>, breakpoints: &[f64]) -> Bent {
    let segments = breakpoints.len() - 1;
    let mut curve = Curve { breakpoints: breakpoints.to_vec(), slopes: vec![1.0; segments] };
    let mut system = Compressed::new(segments + 1);
    let mut row = vec![1.0; segments + 1];
    visit(runs, thresholds, family, |signals, output| {
        let sum: f64 = weights.iter().zip(signals).map(|(weight, signal)| weight * signal).sum();
        (0..segments).for_each(|index| row[index] = curve.part(index, sum));
        system.push(&row, output);
    });
    let mut free = vec![false; segments + 1];
    free[segments] = true;
    let mut solution = system.solve(&free);
    let constant = solution.coefficients.pop().unwrap_or(0.0);
    curve.slopes = solution.coefficients;
    Bent { weights, constant, curve, squared_residual: solution.squared_residual }
}

/// The weights that are best along the curve's tangents.
fn straighten(runs: &[Run], thresholds: &[f64], family: Family, bent: &Bent, sign: f64) -> Vec<f64> {
    let n = thresholds.len();
    let mut system = Compressed::new(n);
    let mut row = vec![0.0; n];
    visit(runs, thresholds, family, |signals, output| {
        let sum: f64 = bent.weights.iter().zip(signals).map(|(weight, signal)| weight * signal).sum();
        let slope = bent.curve.slope_at(sum);
        row.iter_mut().zip(signals).for_each(|(cell, signal)| *cell = sign * slope * signal);
        system.push(&row, output - bent.constant - bent.curve.at(sum) + slope * sum);
    });
    system.solve(&vec![false; n]).coefficients.into_iter().map(|weight| sign * weight).collect()
}
