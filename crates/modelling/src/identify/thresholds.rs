//! Free thresholds by variable projection: the weights are eliminated by non-negative least squares, the thresholds follow a damped
//! Gauss-Newton method on what remains (G. Golub, V. Pereyra, SIAM J. Numer. Anal. 10, 1973; L. Kaufman, BIT 15, 1975).
//!
//! A fine grid gives the start: its few positive weights come in neighbouring groups, one group for each operator of the data.

use super::bank::{Bank, Family, Run, Samples, counted, linear_problem};
use identification::linear::Compressed;

/// What the search works on.
#[derive(Clone, Copy)]
pub(super) struct Search<'a> {
    pub runs: &'a [Samples<'a>],
    pub family: Family,
    pub sign: f64,
    pub offsets: bool,
    /// Largest sensible threshold.
    pub largest: f64,
}

/// Equations that thresholds are searched with, at most: of more, neighbours say the same.
pub const MOST_EQUATIONS: usize = 500_000;
/// Where they are more, the search begins with this share of the most.
const COARSE: usize = 10;

/// Samples from one equation of the search to the next.
pub(super) fn every(runs: &[Run], most: usize) -> usize {
    counted(runs).div_ceil(most).max(1)
}

/// The same where the search begins.
pub(super) fn coarse(runs: &[Run], most: usize) -> usize {
    if every(runs, most) > 1 { every(runs, (most / COARSE).max(1)) } else { 1 }
}

/// Thresholds with their weights and what they leave.
#[derive(Clone, Debug)]
pub(super) struct Found {
    pub thresholds: Vec<f64>,
    /// One weight a threshold, then the constant where there is one.
    pub coefficients: Vec<f64>,
    pub squared_residual: f64,
}

/// Thresholds of the starting grid; the finest that keeps 24,000 samples well under a second.
const GRID: usize = 40;
/// Operators whose thresholds are closer than this share of the largest sensible one are one.
const MERGE: f64 = 2e-3;
/// Weights below this share of the sum of all are nothing.
const PRUNE: f64 = 1e-6;
/// Damped steps at most; noise-free data need about five.
const STEPS: usize = 30;

impl Search<'_> {
    /// The best weights for given thresholds.
    pub(super) fn project(&self, thresholds: &[f64]) -> Found {
        let mut system = linear_problem(self.runs, thresholds, self.family, self.sign, self.offsets);
        let solution = system.solve(&self.free(thresholds));
        Found { thresholds: thresholds.to_vec(), coefficients: solution.coefficients, squared_residual: solution.squared_residual }
    }

    /// What the best weights leave for given thresholds: with the sign of the search, and with the other.
    pub(super) fn left_of_both_signs(&self, thresholds: &[f64]) -> [f64; 2] {
        let mut system = linear_problem(self.runs, thresholds, self.family, self.sign, self.offsets);
        let free = self.free(thresholds);
        [system.solve(&free).squared_residual, system.solve_opposite(&free).squared_residual]
    }

    /// Weights are not negative, the constant is free.
    fn free(&self, thresholds: &[f64]) -> Vec<bool> {
        let mut free = vec![false; thresholds.len()];
        if !self.offsets {
            free.push(true);
        }
        free
    }

    /// At most `count` free thresholds, ascending.
    pub(super) fn run(&self, count: usize) -> Found {
        self.settle(&self.start(count))
    }

    /// Thresholds to begin with, at most `count`.
    pub(super) fn start(&self, count: usize) -> Vec<f64> {
        let grid: Vec<f64> = (0..GRID).map(|index| self.largest * index as f64 / GRID as f64).collect();
        let start = self.project(&grid);
        let mut clusters = clusters(&start);
        while clusters.len() > count {
            merge_cheapest(&mut clusters);
        }
        clusters.into_iter().map(|cluster| cluster.0).collect()
    }

    /// The best free thresholds near these.
    pub(super) fn settle(&self, thresholds: &[f64]) -> Found {
        let mut found = self.refine(self.project(thresholds));
        loop {
            let tidy = self.tidy(&found);
            if tidy.len() == found.thresholds.len() || tidy.is_empty() {
                return found;
            }
            found = self.refine(self.project(&tidy));
        }
    }

    /// Damped Gauss-Newton steps until nothing improves.
    fn refine(&self, mut best: Found) -> Found {
        let mut damping = 1e-6;
        for _ in 0..STEPS {
            let Some(mut system) = self.joint_problem(&best) else { return best };
            let mut improved = false;
            for _ in 0..8 {
                let moved = self.step(&mut system, &best, damping);
                let trial = self.project(&moved);
                if trial.squared_residual < best.squared_residual {
                    let gain = 1.0 - trial.squared_residual / best.squared_residual;
                    best = trial;
                    damping = (damping * 0.1).max(1e-14);
                    improved = gain > 1e-7;
                    break;
                }
                damping = (damping * 10.0).min(1e6);
            }
            if !improved {
                return best;
            }
        }
        best
    }

    /// The linearised problem: signals and constant first, then the change with each threshold, against the residual.
    fn joint_problem(&self, found: &Found) -> Option<Compressed> {
        let n = found.thresholds.len();
        if n == 0 || found.squared_residual == 0.0 {
            return None;
        }
        let mut system = Compressed::new(2 * n);
        for run in self.runs {
            let mut own = Compressed::new(2 * n + 1);
            let mut bank = Bank::new(&found.thresholds, self.family);
            let mut row = vec![1.0; 2 * n + 1];
            let constant = found.coefficients.get(n).copied().unwrap_or(0.0);
            run.each(|input, output| {
                bank.step(input);
                let Some(output) = output else { return };
                let mut left = self.sign * output - constant;
                for k in 0..n {
                    let (signal, weight) = (bank.signal(k, input), found.coefficients[k]);
                    left -= weight * signal;
                    // An operator without weight keeps its place in the row so that indices stay, but does nothing.
                    row[1 + k] = if weight > 0.0 { signal } else { 0.0 };
                    row[1 + n + k] = weight * bank.slope(k);
                }
                own.push(&row, left);
            });
            // One constant for each run, projected out: the common constant is a special case the next projection returns to.
            for row in &own.into_rows()[1..] {
                system.push(&row[1..=2 * n], row[2 * n + 1]);
            }
        }
        Some(system)
    }

    /// The thresholds after one damped step, within their bounds and in order.
    fn step(&self, system: &mut Compressed, found: &Found, damping: f64) -> Vec<f64> {
        let n = found.thresholds.len();
        let mut damped = system.clone();
        // Marquardt's scaling: every threshold is held by its own sensitivity.
        let rows = system.clone().into_rows();
        for k in 0..n {
            let sensitivity: f64 = rows.iter().map(|row| row[n + k].powi(2)).sum();
            let mut row = vec![0.0; 2 * n];
            row[n + k] = (damping * sensitivity).sqrt();
            damped.push(&row, 0.0);
        }
        let change = damped.solve(&vec![true; 2 * n]).coefficients;
        let mut moved: Vec<f64> = (0..n)
            .map(|k| {
                let threshold = found.thresholds[k] + change[n + k];
                // A threshold at zero stays: there the operator is the input itself.
                if found.thresholds[k] == 0.0 { 0.0 } else { threshold.clamp(0.0, self.largest) }
            })
            .collect();
        moved.sort_by(f64::total_cmp);
        moved
    }

    /// The thresholds without those that weigh nothing or coincide.
    fn tidy(&self, found: &Found) -> Vec<f64> {
        let weights = &found.coefficients[..found.thresholds.len()];
        let total: f64 = weights.iter().sum();
        let mut kept: Vec<(f64, f64)> = Vec::new();
        for (&threshold, &weight) in found.thresholds.iter().zip(weights).filter(|&(_, &weight)| weight > PRUNE * total) {
            match kept.last_mut() {
                Some(last) if threshold - last.0 < MERGE * self.largest => *last = joined(*last, (threshold, weight)),
                _ => kept.push((threshold, weight)),
            }
        }
        kept.into_iter().map(|(threshold, _)| threshold).collect()
    }
}

/// Neighbouring grid points with positive weight, joined to one operator each at their centre of weight.
fn clusters(found: &Found) -> Vec<(f64, f64)> {
    let mut clusters: Vec<(f64, f64)> = Vec::new();
    let mut open = 0;
    for (index, &threshold) in found.thresholds.iter().enumerate() {
        let weight = found.coefficients[index];
        if weight <= 0.0 {
            open = 0;
            continue;
        }
        // A true threshold between two grid points shows at both; a third neighbour is another operator's. Zero stays alone: it is the
        // input itself and must not be blurred.
        if open == 1 && found.thresholds[index - 1] != 0.0 {
            if let Some(last) = clusters.last_mut() {
                *last = joined(*last, (threshold, weight));
            }
            open = 0;
        } else {
            clusters.push((threshold, weight));
            open = 1;
        }
    }
    clusters
}

/// Joins the two neighbours whose joining changes least.
fn merge_cheapest(clusters: &mut Vec<(f64, f64)>) {
    let cost = |index: usize| {
        let ((first, weight), (second, other)) = (clusters[index], clusters[index + 1]);
        weight * other / (weight + other) * (second - first).powi(2)
    };
    if let Some(index) = (0..clusters.len().saturating_sub(1)).min_by(|&a, &b| cost(a).total_cmp(&cost(b))) {
        let second = clusters.remove(index + 1);
        clusters[index] = joined(clusters[index], second);
    }
}

fn joined(first: (f64, f64), second: (f64, f64)) -> (f64, f64) {
    let weight = first.1 + second.1;
    if first.0 == 0.0 {
        return (0.0, weight);
    }
    ((first.0 * first.1 + second.0 * second.1) / weight, weight)
}

/// At most `count` thresholds, ascending and up to `largest`, that explain prepared runs best: free thresholds by variable projection.
#[must_use]
pub fn free_thresholds(runs: &[Run], family: Family, count: usize, largest: f64) -> Vec<f64> {
    let every = every(runs, MOST_EQUATIONS);
    let runs: Vec<Samples<'_>> = runs.iter().map(|run| Samples::of(run, every)).collect();
    Search { runs: &runs, family, sign: 1.0, offsets: false, largest }.run(count).thresholds
}
