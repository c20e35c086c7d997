//! `slew-limit`: the valve passes only so much air, `|dv/dt| <= S`; one limit, or one for each direction.

use crate::discover::catalogue::{Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::ladder;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Symmetric, &TwoSided];

struct Symmetric;
struct TwoSided;

fn limit(path: &mut [f64], up_per_s: f64, down_per_s: f64, period_s: f64) {
    let mut state = path[0];
    for value in path {
        state += (*value - state).clamp(-down_per_s * period_s, up_per_s * period_s);
        *value = state;
    }
}

impl Form for Symmetric {
    fn name(&self) -> &'static str {
        "slew-limit"
    }
    fn form(&self) -> &'static str {
        "one limit"
    }
    fn place(&self) -> Place {
        Place::Flow
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "limit", quantity: Quantity::InputRate, low: 0.02, high: 200.0, logarithmic: true }]
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(0.05, 0.97, 9).into_iter().map(|share| vec![share * session.fastest_per_s]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        limit(path, parameters[0], parameters[0], run.period_s);
    }
}

impl Form for TwoSided {
    fn name(&self) -> &'static str {
        "slew-limit"
    }
    fn form(&self) -> &'static str {
        "a limit for each direction"
    }
    fn place(&self) -> Place {
        Place::Flow
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "rising_limit", quantity: Quantity::InputRate, low: 0.02, high: 200.0, logarithmic: true },
            Parameter { name: "falling_limit", quantity: Quantity::InputRate, low: 0.02, high: 200.0, logarithmic: true },
        ]
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let shares = [0.15, 0.4, 0.8];
        let mut all = Vec::new();
        for up in shares {
            for down in shares {
                if up != down {
                    all.push(vec![up * session.fastest_per_s, down * session.fastest_per_s]);
                }
            }
        }
        all
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        limit(path, parameters[0], parameters[1], run.period_s);
    }
}
