//! `valve-dead-band`: the pressure holds until the error passes the band, then the valve opens and follows until little error is left.

use crate::discover::catalogue::{Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::{fit_of_steps, ladder};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Follow];

struct Follow;

/// Moments inside a sample at which the valve looks.
const LOOKS: usize = 5;

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
        let (band, closing) = (parameters[0], parameters[0] * parameters[1]);
        let keep = (-run.period_s / LOOKS as f64 / parameters[2]).exp();
        let mut state = path[0];
        let mut last = path[0];
        let mut open = false;
        for value in path {
            for look in 1..=LOOKS {
                let wanted = last + (*value - last) * look as f64 / LOOKS as f64;
                let error = wanted - state;
                if error.abs() > band {
                    open = true;
                } else if error.abs() < closing {
                    open = false;
                }
                if open {
                    state = wanted - keep * error;
                }
            }
            last = *value;
            *value = state;
        }
    }
}
