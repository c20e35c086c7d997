//! `valve-dead-band`: the pressure holds until the error passes the band, then the valve opens and follows until little error is left.

use crate::discover::catalogue::{Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::{best_starts, fit_of_steps, ladder};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Follow];

struct Follow;

/// Moments inside a sample at which the valve looks.
const LOOKS: usize = 4;

/// A valve that opens at `band` and closes again at `closing`, seen at `looks` moments a sample.
fn follow(path: &mut [f64], band: f64, closing: f64, flow_s: f64, period_s: f64, looks: usize) {
    let step_s = period_s / looks as f64;
    let keep = (-step_s / flow_s).exp();
    let mut state = path[0];
    let mut last = path[0];
    let mut open = false;
    for value in path {
        let begin = last;
        for look in 1..=looks {
            let wanted = begin + (*value - begin) * look as f64 / looks as f64;
            let rate = (wanted - last) / step_s;
            let mut error = last - state;
            let (mut left_s, mut decay) = (step_s, keep);
            if !open && (wanted - state).abs() > band {
                // The moment of opening, on the straight line between looks.
                let share = ((band - error.abs()) / ((wanted - state).abs() - error.abs()).max(1e-12)).clamp(0.0, 1.0);
                error += (wanted - state - error) * share;
                left_s = step_s * (1.0 - share);
                decay = (-left_s / flow_s).exp();
                open = true;
            }
            if open {
                // Exact for a command on a straight line.
                let after = rate * flow_s + (error - rate * flow_s) * decay;
                if after.abs() < closing {
                    let share = if error.abs() <= closing { 1.0 } else { (error.abs() - closing) / (error.abs() - after.abs()) };
                    state = wanted - rate * left_s * (1.0 - share) - error.signum() * closing.min(error.abs());
                    open = false;
                } else {
                    state = wanted - after;
                }
            }
            last = wanted;
        }
        *value = state;
    }
}

impl Form for Follow {
    fn name(&self) -> &'static str {
        "valve-dead-band"
    }
    fn form(&self) -> &'static str {
        "opens at the band, follows, closes"
    }
    fn place(&self) -> Place {
        Place::Supply
    }
    fn parameters(&self) -> &'static [Parameter] {
        // The travel decides when the next jump comes, and the one after it: an error in it adds up along the stairs, one in the band
        // does not. As parameters of their own the two are searched along the axes of the valley.
        &[
            Parameter { name: "band", quantity: Quantity::Input, low: 2e-3, high: 0.5, logarithmic: true },
            Parameter { name: "travel", quantity: Quantity::Input, low: 1e-3, high: 0.5, logarithmic: true },
            Parameter { name: "flow_time_constant", quantity: Quantity::Time, low: 1e-3, high: 0.3, logarithmic: true },
        ]
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let grid = ladder(0.006, 0.3, 160).into_iter().flat_map(|travel| {
            [1.005, 1.08, 1.2, 1.35, 1.6]
                .into_iter()
                .flat_map(move |wider| [0.004, 0.02, 0.05].map(|flow_s| vec![travel * wider, travel, flow_s]))
        });
        let score = |parameters: &Vec<f64>| {
            fit_of_steps(session, residual, |run| {
                let mut path = run.input.clone();
                follow(&mut path, parameters[0], parameters[0] - parameters[1], parameters[2], run.period_s, 2);
                path.iter().zip(&run.input).map(|(after, before)| after - before).collect()
            })
        };
        best_starts(grid, score, 14)
    }
    fn step(&self) -> f64 {
        0.01
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let closing = (parameters[0] - parameters[1]).max(0.005 * parameters[0]);
        follow(path, parameters[0], closing, parameters[2], run.period_s, LOOKS);
    }
}
