//! Confidence intervals of the fitted parameters that stay honest when residuals are correlated in time.
//!
//! The model is linearised at the fit, `residual = J change`, and the covariance is the sandwich `G M G` with `G = (J^T J)^-1`. `M` sums
//! the outer products of `J^T residual` over *blocks* of consecutive samples, so whatever correlation there is within a block counts
//! (batch means). The block length follows Andrews' rule for an AR(1) residual (D. Andrews, Econometrica 59, 1991), at least thirty
//! blocks; the interval is 1.96 standard errors, widened by Student's distribution for so many blocks. Parameters at a bound (weights
//! of zero) have no two-sided interval: theirs is the point zero. The modified model's intervals hold for its curve as fitted.

use super::bank::{Bank, Family, Run};
use crate::physics::Curve;
use identification::linear::Compressed;

/// A fit to judge.
pub(super) struct Fitted<'a> {
    pub runs: &'a [Run],
    pub thresholds: &'a [f64],
    pub family: Family,
    /// Weights of the signals, with their sign.
    pub weights: &'a [f64],
    pub constant: f64,
    pub curve: Option<&'a Curve>,
    pub free_thresholds: bool,
    /// A constant for each run, not one for all.
    pub offsets: bool,
}

/// 95 % intervals, one for each parameter.
pub(super) struct Intervals {
    pub thresholds: Vec<[f64; 2]>,
    pub weights: Vec<[f64; 2]>,
    pub constant: Option<[f64; 2]>,
    pub widening: f64,
}

/// Fewest blocks that make a covariance.
const BLOCKS: usize = 30;

/// Computes the intervals.
pub(super) fn intervals(fitted: &Fitted) -> Intervals {
    let n = fitted.thresholds.len();
    // Parameters: active weights, then free thresholds of active operators (zero is a bound), then the constant.
    let active: Vec<usize> = (0..n).filter(|&k| fitted.weights[k] != 0.0).collect();
    let free: Vec<usize> = active.iter().copied().filter(|&k| fitted.free_thresholds && fitted.thresholds[k] > 0.0).collect();
    let count = active.len() + free.len() + usize::from(!fitted.offsets);
    // The lines are made anew in each pass: kept, those of five million samples would fill the memory.
    let lines = Lines { fitted, active: &active, free: &free, count };
    let means: Vec<Vec<f64>> = fitted.runs.iter().map(|run| if fitted.offsets { lines.means(run) } else { vec![0.0; count + 1] }).collect();
    let mut system = Compressed::new(count);
    let (mut total, mut lagged) = (0.0, 0.0);
    for (run, means) in fitted.runs.iter().zip(&means) {
        let mut before = 0.0;
        lines.each(run, means, &mut |line, residual| {
            system.push(line, residual);
            total += residual * residual;
            lagged += before * residual;
            before = residual;
        });
    }
    let all: Vec<usize> = (0..count).collect();
    let inverse = system.inverse_gram(&all);
    let samples = system.rows();
    let variance = total / samples.saturating_sub(count).max(1) as f64;
    let length = block_length(lagged, total, samples);
    let mut meat = vec![0.0; count * count];
    let mut blocks = 0_usize;
    let mut add = |sum: &mut Vec<f64>| {
        for row in 0..count {
            (0..count).for_each(|column| meat[row * count + column] += sum[row] * sum[column]);
        }
        sum.fill(0.0);
        blocks += 1;
    };
    for (run, means) in fitted.runs.iter().zip(&means) {
        let (mut sum, mut summed) = (vec![0.0; count], 0);
        lines.each(run, means, &mut |line, residual| {
            sum.iter_mut().zip(line).for_each(|(sum, cell)| *sum += cell * residual);
            summed += 1;
            if summed == length {
                add(&mut sum);
                summed = 0;
            }
        });
        if summed > 0 {
            add(&mut sum);
        }
    }
    let student = 1.96 + 2.37 / blocks.saturating_sub(1).max(1) as f64;
    let small_sample = blocks as f64 / blocks.saturating_sub(count).max(1) as f64;
    let half_width = |parameter: usize| {
        let line = &inverse[parameter * count..(parameter + 1) * count];
        let sandwich: f64 = (0..count * count).map(|k| line[k / count] * meat[k] * line[k % count]).sum();
        student * (small_sample * sandwich.max(0.0)).sqrt()
    };
    let around = |value: f64, parameter: Option<usize>| match parameter.map(half_width) {
        Some(half) => [value - half, value + half],
        None => [value, value],
    };
    let weights = (0..n).map(|k| around(fitted.weights[k], active.iter().position(|&index| index == k))).collect();
    let thresholds = (0..n).map(|k| {
        let place = free.iter().position(|&index| index == k).map(|place| place + active.len());
        let [low, high] = around(fitted.thresholds[k], place);
        [low.max(0.0), high]
    });
    let constant = (!fitted.offsets).then(|| around(fitted.constant, Some(count - 1)));
    let widening =
        (0..count).map(|k| half_width(k) / (1.96 * (variance * inverse[k * count + k]).sqrt())).filter(|ratio| ratio.is_finite());
    let (sum, number) = widening.fold((0.0, 0.0), |(sum, number), ratio| (sum + ratio, number + 1.0));
    Intervals { thresholds: thresholds.collect(), weights, constant, widening: if number > 0.0 { sum / number } else { 1.0 } }
}

/// Derivatives of the output with respect to the parameters, and the residual, for each sample that counts.
struct Lines<'a> {
    fitted: &'a Fitted<'a>,
    active: &'a [usize],
    free: &'a [usize],
    count: usize,
}

impl Lines<'_> {
    /// Every line of a run less its means, the residual's last.
    fn each(&self, run: &Run, means: &[f64], see: &mut dyn FnMut(&[f64], f64)) {
        let fitted = self.fitted;
        let mut bank = Bank::new(fitted.thresholds, fitted.family);
        let mut line = vec![0.0; self.count];
        for (index, &input) in run.input.iter().enumerate() {
            bank.step(input);
            if index < run.skip {
                continue;
            }
            let sum: f64 = (0..fitted.thresholds.len()).map(|k| fitted.weights[k] * bank.signal(k, input)).sum();
            let (value, slope) = fitted.curve.map_or((sum, 1.0), |curve| (curve.at(sum), curve.slope_at(sum)));
            let weights = self.active.iter().map(|&k| slope * bank.signal(k, input));
            let thresholds = self.free.iter().map(|&k| slope * fitted.weights[k] * bank.slope(k));
            // The constant's derivative is one; each run's own constant is projected out by the means instead.
            let constant = std::iter::once(1.0);
            line.iter_mut()
                .zip(weights.chain(thresholds).chain(constant))
                .zip(means)
                .for_each(|((cell, value), mean)| *cell = value - mean);
            see(&line, run.output[index] - fitted.constant - value - means[self.count]);
        }
    }

    /// The means of a run's lines, the residual's last.
    fn means(&self, run: &Run) -> Vec<f64> {
        let mut sums = vec![0.0; self.count + 1];
        let mut samples = 0.0;
        self.each(run, &vec![0.0; self.count + 1], &mut |line, residual| {
            sums.iter_mut().zip(line.iter().chain([&residual])).for_each(|(sum, value)| *sum += value);
            samples += 1.0;
        });
        sums.iter().map(|sum| sum / f64::max(samples, 1.0)).collect()
    }
}

/// Samples of a block, from the correlation of neighbouring residuals.
fn block_length(lagged: f64, squares: f64, samples: usize) -> usize {
    let correlation = if squares > 0.0 { (lagged / squares).clamp(0.0, 0.9999) } else { 0.0 };
    let alpha = 4.0 * correlation.powi(2) / (1.0 - correlation.powi(2)).powi(2);
    let length = 1.1447 * (alpha * samples as f64).cbrt();
    (length as usize).clamp(1, (samples / BLOCKS).max(1))
}
