//! `setup-change`: load, pose or sensor were changed between two recordings: zero and gain step there.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Step, &Twice];

struct Step;

struct Twice;

const FROM: Parameter = Parameter { name: "from_recording", quantity: Quantity::Ratio, low: 0.5, high: 1e4, logarithmic: false };

const AGAIN_FROM: Parameter = Parameter { name: "again_from_recording", ..FROM };

impl Form for Step {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[FROM],
            weights: 2,
            discrete: true,
            is_between_recordings: true,
            needs_sum: true,
            ..Spec::new("setup-change", ("one-step", "zero and gain step between two recordings"), Place::Sensor)
        }
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let sums: Vec<[f64; 6]> = session.runs.iter().map(|run| line_sums(run, &residual[run.index])).collect();
        let place = |first: usize| (left(&sums[..first]) + left(&sums[first..]), vec![first as f64 - 0.5]);
        best(told_apart(session).into_iter().map(place).collect())
    }
    fn changes_at<'a>(&self, parameters: &'a [f64]) -> &'a [f64] {
        parameters
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let after = if run.index as f64 > parameters[0] { 1.0 } else { 0.0 };
        columns.push(true, |_| after);
        columns.push(true, |sample| after * sum[sample]);
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([
            (format!("shift_{}", session.output_unit), weights[0] * session.output_scale),
            ("gain".to_owned(), 1.0 + weights[1]),
        ])
    }
}

impl Form for Twice {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[FROM, AGAIN_FROM],
            weights: 4,
            discrete: true,
            is_between_recordings: true,
            needs_sum: true,
            ..Spec::new("setup-change", ("two-steps", "zero and gain step between recordings twice"), Place::Sensor)
        }
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let sums: Vec<[f64; 6]> = session.runs.iter().map(|run| line_sums(run, &residual[run.index])).collect();
        let firsts = told_apart(session);
        let pairs = firsts.iter().enumerate().flat_map(|(at, &first)| firsts[at + 1..].iter().map(move |&second| (first, second)));
        let place = |(first, second): (usize, usize)| {
            let energy = left(&sums[..first]) + left(&sums[first..second]) + left(&sums[second..]);
            (energy, vec![first as f64 - 0.5, second as f64 - 0.5])
        };
        best(pairs.map(place).collect())
    }
    fn changes_at<'a>(&self, parameters: &'a [f64]) -> &'a [f64] {
        parameters
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        for from in parameters {
            let after = if run.index as f64 > *from { 1.0 } else { 0.0 };
            columns.push(true, |_| after);
            columns.push(true, |sample| after * sum[sample]);
        }
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let unit = &session.output_unit;
        BTreeMap::from([
            (format!("shift_{unit}"), weights[0] * session.output_scale),
            ("gain".to_owned(), 1.0 + weights[1]),
            (format!("second_shift_{unit}"), weights[2] * session.output_scale),
            ("second_gain".to_owned(), 1.0 + weights[3]),
        ])
    }
}

/// First recordings after a change, of all changes that the recordings worked with tell apart.
///
/// Test recordings have no say, so a change among them is put in front of the first: on which side of it they are is not known.
fn told_apart(session: &Session) -> Vec<usize> {
    (1..session.runs.len()).filter(|&first| session.runs[first - 1].is_worked_with()).collect()
}

/// What a line of the residual over the model's output leaves of these recordings.
fn left(part: &[[f64; 6]]) -> f64 {
    line_residual(&part.iter().fold([0.0; 6], |all, one| std::array::from_fn(|at| all[at] + one[at])))
}

/// The four places that divide the session best.
fn best(mut places: Vec<(f64, Vec<f64>)>) -> Vec<Vec<f64>> {
    places.sort_by(|x, y| x.0.total_cmp(&y.0));
    places.into_iter().take(4).map(|place| place.1).collect()
}

/// Sums for a line of the residual over the model's output: 1, x, x^2, r, x r, r^2. Test recordings have no say.
fn line_sums(run: &Run, residual: &[f64]) -> [f64; 6] {
    let mut sums = [0.0; 6];
    for ((&output, &r), (&role, &keep)) in run.output.iter().zip(residual).zip(run.role.iter().zip(&run.keep)) {
        if keep && role.is_worked_with() {
            let x = output - r;
            for (sum, value) in sums.iter_mut().zip([1.0, x, x * x, r, x * r, r * r]) {
                *sum += value;
            }
        }
    }
    sums
}

/// What the best line leaves of the residual's energy.
fn line_residual(&[count, x, xx, r, xr, rr]: &[f64; 6]) -> f64 {
    if count < 1.0 {
        return 0.0;
    }
    let (spread, common) = (xx - x * x / count, xr - x * r / count);
    let slope_part = if spread > 1e-12 { common * common / spread } else { 0.0 };
    rr - r * r / count - slope_part
}
