//! `fill-vent-asymmetry`: filling and venting have their own time constants.

use crate::discover::catalogue::{Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::{ladder, lag_coefficients};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&TwoLags];

struct TwoLags;

impl Form for TwoLags {
    fn name(&self) -> &'static str {
        "fill-vent-asymmetry"
    }
    fn form(&self) -> &'static str {
        "two time constants"
    }
    fn place(&self) -> Place {
        Place::Flow
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "fill_time_constant", quantity: Quantity::Time, low: 2e-3, high: 2.0, logarithmic: true },
            Parameter { name: "vent_time_constant", quantity: Quantity::Time, low: 2e-3, high: 2.0, logarithmic: true },
        ]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let times = ladder(0.03, 0.5, 4);
        let mut all = Vec::new();
        for &fill in &times {
            for &vent in &times {
                if fill != vent {
                    all.push(vec![fill, vent]);
                }
            }
        }
        all
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let fill = lag_coefficients(parameters[0], run.period_s);
        let vent = lag_coefficients(parameters[1], run.period_s);
        let mut state = path[0];
        let mut last = path[0];
        for value in path {
            let (keep, now, before) = if 0.5 * (*value + last) > state { fill } else { vent };
            state = keep * state + now * *value + before * last;
            last = *value;
            *value = state;
        }
    }
}
