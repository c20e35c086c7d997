//! A candidate's weights: non-negative least squares on the normal equations, the curve behind them, and cross-validation over folds.

use super::candidate::{Candidate, Fit, Kind};
use crate::identify::nnls::{Normal, solve};
use crate::identify::{Rows, fit_curve};

/// Most folds of the cross-validation.
pub(super) const FOLDS: usize = 8;

/// What the training samples say about a candidate: a row of signals each.
pub(super) struct Samples {
    /// Operators, paths, creeps, constant.
    pub(super) columns: usize,
    pub(super) rows: Vec<f64>,
    pub(super) outputs: Vec<f64>,
    /// The fold that each sample is left out with.
    pub(super) folds: Vec<usize>,
}

/// The samples of some folds: operators and paths, which a curve bends.
struct Folds<'a> {
    samples: &'a Samples,
    width: usize,
    left_out: Option<usize>,
}

impl Rows for Folds<'_> {
    fn width(&self) -> usize {
        self.width
    }

    fn visit(&self, each: &mut dyn FnMut(&[f64], f64)) {
        for (row, output, fold) in self.samples.iter() {
            if self.left_out != Some(fold) {
                each(&row[..self.width], output);
            }
        }
    }
}

impl Samples {
    fn iter(&self) -> impl Iterator<Item = (&[f64], f64, usize)> {
        self.rows.chunks_exact(self.columns).zip(&self.outputs).zip(&self.folds).map(|((row, output), fold)| (row, *output, *fold))
    }
}

/// The weights of the linear sum, by non-negative least squares.
pub(super) fn straight(candidate: &Candidate, samples: &Samples) -> Fit {
    let (n, columns) = (candidate.operators.len(), samples.columns);
    let paths = n..n + candidate.falling.len();
    let mut folds = vec![Normal::new(columns); FOLDS];
    for (row, output, fold) in samples.iter() {
        folds[fold].add(row, output);
    }
    folds.iter_mut().for_each(Normal::complete);
    let total = Normal::sum(&folds, columns);
    let bounded: Vec<bool> =
        (0..columns).map(|index| index != columns - 1 && (!paths.contains(&index) || candidate.kind == Kind::Play)).collect();
    let solution = |normal: &Normal| solve(&normal.gram, &normal.right, &bounded);
    let x = solution(&total);
    let mut left_out = 0.0;
    for out in 0..FOLDS {
        let rest = Normal::sum(folds.iter().enumerate().filter(|(index, _)| *index != out).map(|(_, fold)| fold), columns);
        left_out += folds[out].residual_square(&solution(&rest));
    }
    let rows = total.rows as f64;
    Fit {
        weights: x[..n].to_vec(),
        input_weights: x[paths.clone()].to_vec(),
        creep_weights: x[paths.end..columns - 1].to_vec(),
        bias: x[columns - 1],
        curve: None,
        in_sample: total.residual_square(&x) / rows,
        left_out: left_out / rows,
    }
}

/// With which inputs the output falls, by least squares on the paths and a constant with free signs.
pub(super) fn falling(candidate: &Candidate, samples: &Samples) -> Vec<bool> {
    let (n, inputs) = (candidate.operators.len(), candidate.falling.len());
    let mut normal = Normal::new(inputs + 1);
    for (row, output, _) in samples.iter() {
        let paths: Vec<f64> = row[n..n + inputs].iter().copied().chain([1.0]).collect();
        normal.add(&paths, output);
    }
    normal.complete();
    let slopes = solve(&normal.gram, &normal.right, &vec![false; inputs + 1]);
    slopes[..inputs].iter().map(|slope| *slope < 0.0).collect()
}

/// Where the search for weights behind a curve starts: the weights without one.
fn start(straight: &Fit) -> Vec<f64> {
    straight.weights.iter().copied().chain(straight.input_weights.iter().map(|weight| weight.max(0.0))).collect()
}

/// The weights behind the best curve.
pub(super) fn bent(candidate: &Candidate, samples: &Samples, straight: &Fit) -> Fit {
    let n = candidate.operators.len();
    let width = n + candidate.falling.len();
    let all = fit_curve(&Folds { samples, width, left_out: None }, &start(straight), candidate.segments);
    Fit {
        curve: all.curve.dead_zones(all.constant, 0.0, 1.0),
        weights: all.weights[..n].to_vec(),
        input_weights: all.weights[n..].to_vec(),
        creep_weights: vec![0.0; candidate.creep.len()],
        bias: 0.0,
        in_sample: all.squared_residual / samples.outputs.len() as f64,
        left_out: f64::NAN,
    }
}

/// Mean square error of a curve and its weights on the folds left out.
pub(super) fn left_out(candidate: &Candidate, samples: &Samples, straight: &Fit) -> f64 {
    let start = start(straight);
    let mut sum = 0.0;
    for out in 0..FOLDS {
        let folds = Folds { samples, width: candidate.operators.len() + candidate.falling.len(), left_out: Some(out) };
        let bent = fit_curve(&folds, &start, candidate.segments);
        for (row, output, _) in samples.iter().filter(|(.., fold)| *fold == out) {
            let signal: f64 = bent.weights.iter().zip(row).map(|(weight, signal)| weight * signal).sum();
            sum += (output - bent.constant - bent.curve.at(signal)).powi(2);
        }
    }
    sum / samples.outputs.len() as f64
}
