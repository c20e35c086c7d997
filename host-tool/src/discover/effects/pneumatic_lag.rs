//! `pneumatic-lag`: a volume fills through a restriction, `T dv/dt = u - v`; before the hysteresis or behind it, or two in a row.

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::{Lag, ladder, lag};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Command, &Sensor, &TwoPoles, &TwoPolesBehind];

const TIME: &[Parameter] = &[Parameter { name: "time_constant", quantity: Quantity::Time, low: 2e-3, high: 2.0, logarithmic: true }];

struct Command;
struct Sensor;
struct TwoPoles;
struct TwoPolesBehind;

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
        columns.filter(&Lag::new(parameters[0], run.period_s));
    }
}

/// A spool before the volume, or a volume behind a volume: the second is the faster one.
const TIMES: &[Parameter] =
    &[TIME[0], Parameter { name: "second_time_constant", quantity: Quantity::Time, low: 1e-3, high: 0.5, logarithmic: true }];

fn starts_of_two() -> Vec<Vec<f64>> {
    ladder(0.03, 0.6, 5).into_iter().flat_map(|slow| [vec![slow, 0.05 * slow], vec![slow, 0.3 * slow]]).collect()
}

impl Form for TwoPoles {
    fn name(&self) -> &'static str {
        "pneumatic-lag"
    }
    fn form(&self) -> &'static str {
        "two in a row before the hysteresis"
    }
    fn place(&self) -> Place {
        Place::Flow
    }
    fn parameters(&self) -> &'static [Parameter] {
        TIMES
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        starts_of_two()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        lag(path, parameters[0], run.period_s);
        lag(path, parameters[1], run.period_s);
    }
}

impl Form for TwoPolesBehind {
    fn name(&self) -> &'static str {
        "pneumatic-lag"
    }
    fn form(&self) -> &'static str {
        "two in a row behind the hysteresis"
    }
    fn place(&self) -> Place {
        Place::Tip
    }
    fn parameters(&self) -> &'static [Parameter] {
        TIMES
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        starts_of_two()
    }
    fn output(&self, parameters: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        columns.filter(&Lag::new(parameters[0], run.period_s));
        columns.filter(&Lag::new(parameters[1], run.period_s));
    }
}
