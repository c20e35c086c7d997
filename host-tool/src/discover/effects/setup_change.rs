//! `setup-change`: load, pose or sensor were changed between two recordings: zero and gain step there.

use std::collections::BTreeMap;

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Step];

struct Step;

impl Form for Step {
    fn name(&self) -> &'static str {
        "setup-change"
    }
    fn form(&self) -> &'static str {
        "zero and gain step between two recordings"
    }
    fn place(&self) -> Place {
        Place::Sensor
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "from_recording", quantity: Quantity::Ratio, low: 0.5, high: 1e4, logarithmic: false }]
    }
    fn weights(&self) -> usize {
        2
    }
    fn discrete(&self) -> bool {
        true
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        (1..session.runs.len()).map(|run| vec![run as f64 - 0.5]).collect()
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let after = if run.index as f64 > parameters[0] { 1.0 } else { 0.0 };
        columns.push(true, |_| after);
        columns.push(true, |sample| after * sum[sample]);
    }
    fn tell(&self, weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([
            (format!("shift_{}", session.output_unit), weights[0] * session.output_scale),
            ("gain".to_owned(), 1.0 + weights[1]),
        ])
    }
}
