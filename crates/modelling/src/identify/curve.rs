//! The modified Prandtl-Ishlinskii model: the operators' sum bent by a rising, piecewise straight curve.
//!
//! The curve is a superposition of one-sided dead zones (K. Kuhnen, European Journal of Control 9, 2003) written by segments, so that
//! "rising" is a non-negative slope each. Unlike Kuhnen's inverse-side fit the error minimised here is that of the output: by turns
//! the slopes are fitted for given weights, and the weights by a Gauss-Newton step along the curve, both by non-negative least squares.

use super::bank::{Bank, Family, Run};
use crate::physics::{Curve, range};
use identification::linear::Compressed;

/// Weights, constant and curve: `output = constant + curve(sum_i weights_i signal_i)`.
pub struct Bent {
    /// Weights of the signals, with their sign.
    pub weights: Vec<f64>,
    /// Output where the curve starts.
    pub constant: f64,
    /// The curve of the sum.
    pub curve: Curve,
    /// Sum of the squared errors.
    pub squared_residual: f64,
}

/// Samples of weighted signals and the output they add up to.
pub trait Rows {
    /// Signals in a row.
    fn width(&self) -> usize;
    /// Calls `each` with the signals and the output of every sample that counts.
    fn visit(&self, each: &mut dyn FnMut(&[f64], f64));
}

/// The signals of a bank of operators along runs.
pub(super) struct BankRows<'a> {
    pub runs: &'a [Run],
    pub thresholds: &'a [f64],
    pub family: Family,
}

impl Rows for BankRows<'_> {
    fn width(&self) -> usize {
        self.thresholds.len()
    }

    fn visit(&self, each: &mut dyn FnMut(&[f64], f64)) {
        let mut signals = vec![0.0; self.width()];
        for run in self.runs {
            let mut bank = Bank::new(self.thresholds, self.family);
            for (index, &input) in run.input.iter().enumerate() {
                bank.step(input);
                if index >= run.skip {
                    signals.iter_mut().enumerate().for_each(|(k, signal)| *signal = bank.signal(k, input));
                    each(&signals, run.output[index]);
                }
            }
        }
    }
}

/// Turns at most.
const TURNS: usize = 40;

/// Fits the curve and the weights, starting from the weights of the model without curve.
#[must_use]
pub fn fit(rows: &impl Rows, weights: &[f64], segments: usize) -> Bent {
    // A falling output has negative weights; the curve rises, so the sign stays with the weights.
    let sign = if weights.iter().sum::<f64>() < 0.0 { -1.0 } else { 1.0 };
    let sums = sums(rows, weights);
    let (low, high) = range(&sums);
    let breakpoints: Vec<f64> = (0..=segments).map(|index| low + (high - low) * index as f64 / segments as f64).collect();
    let mut best = bend(rows, weights.to_vec(), &breakpoints);
    for _ in 0..TURNS {
        let target = straighten(rows, &best, sign);
        let mut improved = false;
        for share in [1.0, 0.5, 0.25, 0.1, 0.03] {
            let weights = best.weights.iter().zip(&target).map(|(old, new)| old + share * (new - old)).collect();
            let trial = bend(rows, weights, &breakpoints);
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

/// The weighted sums of all samples.
fn sums(rows: &impl Rows, weights: &[f64]) -> Vec<f64> {
    let mut sums = Vec::new();
    rows.visit(&mut |signals, _| sums.push(sum(weights, signals)));
    sums
}

fn sum(weights: &[f64], signals: &[f64]) -> f64 {
    weights.iter().zip(signals).map(|(weight, signal)| weight * signal).sum()
}

/// The best curve for given weights.
fn bend(rows: &impl Rows, weights: Vec<f64>, breakpoints: &[f64]) -> Bent {
    let segments = breakpoints.len() - 1;
    let mut curve = Curve { breakpoints: breakpoints.to_vec(), slopes: vec![1.0; segments] };
    let mut system = Compressed::new(segments + 1);
    let mut row = vec![1.0; segments + 1];
    rows.visit(&mut |signals, output| {
        let sum = sum(&weights, signals);
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
fn straighten(rows: &impl Rows, bent: &Bent, sign: f64) -> Vec<f64> {
    let n = rows.width();
    let mut system = Compressed::new(n);
    let mut row = vec![0.0; n];
    rows.visit(&mut |signals, output| {
        let sum = sum(&bent.weights, signals);
        let slope = bent.curve.slope_at(sum);
        row.iter_mut().zip(signals).for_each(|(cell, signal)| *cell = sign * slope * signal);
        system.push(&row, output - bent.constant - bent.curve.at(sum) + slope * sum);
    });
    system.solve(&vec![false; n]).coefficients.into_iter().map(|weight| sign * weight).collect()
}
