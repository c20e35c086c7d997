//! `slew-limit`: the valve passes only so much air, `|dv/dt| <= S`; one limit, or one for each direction, or one that sets in gradually.

use crate::discover::catalogue::{Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::ladder;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Symmetric, &TwoSided, &Gradual];

struct Symmetric;
struct TwoSided;
struct Gradual;

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

/// Steps of the gradual limit inside a sample.
const LOOKS: usize = 2;

impl Form for Gradual {
    fn name(&self) -> &'static str {
        "slew-limit"
    }
    fn form(&self) -> &'static str {
        "one limit that sets in gradually"
    }
    fn place(&self) -> Place {
        Place::Flow
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "limit", quantity: Quantity::InputRate, low: 0.02, high: 200.0, logarithmic: true },
            Parameter { name: "time_constant", quantity: Quantity::Time, low: 1e-3, high: 0.2, logarithmic: true },
        ]
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(0.1, 0.97, 6).into_iter().map(|share| vec![share * session.fastest_per_s, 0.01]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        // A lag while the error is small, the limit when it is large: `a e / sqrt(1 + (a e / S h)^2)` a step of length `h`.
        let step_s = run.period_s / LOOKS as f64;
        let follow = 1.0 - (-step_s / parameters[1]).exp();
        let most = parameters[0] * step_s;
        let mut state = path[0];
        let mut last = path[0];
        for value in path {
            for look in 1..=LOOKS {
                let wanted = follow * (last + (*value - last) * look as f64 / LOOKS as f64 - state);
                let steep = wanted / most;
                state += wanted / (1.0 + steep * steep).sqrt();
            }
            last = *value;
            *value = state;
        }
    }
}
