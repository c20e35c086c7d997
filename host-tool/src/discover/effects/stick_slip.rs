//! `stick-slip`: the tip holds until the pull exceeds a band, then jumps, and holds again or slides on while the pull is fast.

use std::collections::BTreeMap;

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::jumps::{self, Drive};
use crate::discover::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Seen];

/// Where the tip sits hangs on when it last broke away, which no simulation meets; it is read from the output seen so far.
struct Seen;

impl Form for Seen {
    fn name(&self) -> &'static str {
        "stick-slip"
    }
    fn form(&self) -> &'static str {
        "holds and breaks away, its seat seen in the output"
    }
    fn place(&self) -> Place {
        Place::Tip
    }
    fn parameters(&self) -> &'static [Parameter] {
        const LENGTH: Parameter = Parameter { name: "break_away", quantity: Quantity::Output, low: 1e-3, high: 0.5, logarithmic: true };
        const PARAMETERS: [Parameter; jumps::PARAMETERS] = jumps::parameters(LENGTH, Quantity::OutputRate);
        &PARAMETERS
    }
    fn weights(&self) -> usize {
        1
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        Vec::new()
    }
    fn discrete(&self) -> bool {
        true
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        if parameters[jumps::LAG] > 0.0 {
            super::lag(path, parameters[jumps::LAG], run.period_s);
        }
    }
    fn jumps(&self) -> Option<Drive> {
        Some(Drive::Pull)
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        jumps::push_departure(Drive::Pull, parameters, run, sum, columns);
    }
    fn tell(&self, parameters: &[f64], _: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let travel = parameters[0] * (1.0 + parameters[1]) * session.output_scale.abs();
        BTreeMap::from([(format!("travel_{}", session.output_unit), travel)])
    }
}
