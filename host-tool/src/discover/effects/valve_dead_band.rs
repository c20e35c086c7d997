//! `valve-dead-band`: the pressure holds until the error passes the band, then the valve opens and follows until little error is left.

use crate::discover::catalogue::{Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::{fit_of_steps, ladder};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Follow];

struct Follow;

/// Moments inside a sample at which the valve looks.
const LOOKS: usize = 4;

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
        &[
            Parameter { name: "band", quantity: Quantity::Input, low: 2e-3, high: 0.5, logarithmic: true },
            Parameter { name: "closing_share", quantity: Quantity::Ratio, low: 0.005, high: 0.9, logarithmic: true },
            Parameter { name: "flow_time_constant", quantity: Quantity::Time, low: 2e-3, high: 0.3, logarithmic: true },
        ]
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        // When the valve jumps hangs on the band and on where it closed last time: a fine grid on the steps alone, which cost little.
        let mut all: Vec<(f64, Vec<f64>)> = Vec::new();
        for band in ladder(0.008, 0.3, 230) {
            for closing in [0.02, 0.06, 0.12, 0.2, 0.3, 0.45] {
                let parameters = vec![band, closing, 0.02];
                let score = fit_of_steps(session, residual, |run| {
                    let mut path = run.input.clone();
                    self.input(&parameters, run, &mut path);
                    path.iter().zip(&run.input).map(|(after, before)| after - before).collect()
                });
                all.push((score, parameters));
            }
        }
        all.sort_by(|x, y| y.0.total_cmp(&x.0));
        all.into_iter().take(10).map(|entry| entry.1).collect()
    }
    fn step(&self) -> f64 {
        0.02
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let (band, closing, flow_s) = (parameters[0], parameters[0] * parameters[1], parameters[2]);
        let step_s = run.period_s / LOOKS as f64;
        let keep = (-step_s / flow_s).exp();
        let mut state = path[0];
        let mut last = path[0];
        let mut open = false;
        for value in path {
            let begin = last;
            for look in 1..=LOOKS {
                let wanted = begin + (*value - begin) * look as f64 / LOOKS as f64;
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
}
