//! `pneumatic-lag`: a volume fills through a restriction, `T dv/dt = u - v`; before the hysteresis or behind it.

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::{ladder, lag};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Command, &Sensor];

const TIME: &[Parameter] = &[Parameter { name: "time_constant", quantity: Quantity::Time, low: 2e-3, high: 2.0, logarithmic: true }];

struct Command;
struct Sensor;

impl Form for Command {
    fn name(&self) -> &'static str {
        "pneumatic-lag"
    }
    fn form(&self) -> &'static str {
        "before the hysteresis"
    }
    fn place(&self) -> Place {
        Place::Flow
    }
    fn parameters(&self) -> &'static [Parameter] {
        TIME
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(0.02, 1.0, 7).into_iter().map(|value| vec![value]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        lag(path, parameters[0], run.period_s);
    }
}

impl Form for Sensor {
    fn name(&self) -> &'static str {
        "pneumatic-lag"
    }
    fn form(&self) -> &'static str {
        "behind the hysteresis"
    }
    fn place(&self) -> Place {
        Place::Tip
    }
    fn parameters(&self) -> &'static [Parameter] {
        TIME
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(0.02, 1.0, 7).into_iter().map(|value| vec![value]).collect()
    }
    fn output(&self, parameters: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        columns.filter(|column| lag(column, parameters[0], run.period_s));
    }
}
