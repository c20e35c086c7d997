//! `activation-threshold`: below a pressure the bladder does not touch the braid, `v = max(u - P, 0)` with a rounded corner.

use crate::discover::catalogue::{Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Corner];

struct Corner;

impl Form for Corner {
    fn name(&self) -> &'static str {
        "activation-threshold"
    }
    fn form(&self) -> &'static str {
        "rounded corner"
    }
    fn place(&self) -> Place {
        Place::Muscle
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "threshold", quantity: Quantity::Input, low: 0.005, high: 0.7, logarithmic: false },
            Parameter { name: "rounding", quantity: Quantity::Ratio, low: 1e-3, high: 0.15, logarithmic: true },
        ]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [0.03, 0.07, 0.12, 0.18, 0.25, 0.33, 0.45].into_iter().flat_map(|level| [vec![level, 0.005], vec![level, 0.04]]).collect()
    }
    fn is_static(&self) -> bool {
        true
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        let rest = 0.5 * (-parameters[0] + parameters[0].hypot(parameters[1]));
        for value in path {
            let past = *value - parameters[0];
            *value = 0.5 * (past + past.hypot(parameters[1])) - rest;
        }
    }
}
