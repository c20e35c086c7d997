//! What holds at a seat and breaks away, its seat read from the output: the form that a sticking tip and a valve share.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::form::{Drive, FOLLOWING, Form, Parameter, Place};
use crate::data::session::{Run, Session};
use crate::observers::{jumps, law};

/// Where it sits hangs on when it last broke away, which no simulation meets; it is read from the output seen so far.
pub struct Seated {
    /// The effect.
    pub name: &'static str,
    /// The form's description.
    pub form: &'static str,
    /// What it breaks away by.
    pub drive: Drive,
    /// Whether the seat feels what the sensor's effects add: a heart may pull at the wire behind a tip that sticks, or beat against the tip.
    pub feels: bool,
}

impl Form for Seated {
    fn name(&self) -> &'static str {
        self.name
    }
    fn form(&self) -> &'static str {
        self.form
    }
    // What it departs from is the model's output: a valve acts on the pressure, but it is seen behind everything.
    fn place(&self) -> Place {
        Place::Reading
    }
    fn parameters(&self) -> &'static [Parameter] {
        match self.drive {
            Drive::Pull => law::OF_A_TIP,
            Drive::Command => law::OF_A_VALVE,
        }
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
        follow(parameters, run, path);
    }
    fn jumps(&self) -> Option<Drive> {
        Some(self.drive)
    }
    fn feels_sensor(&self) -> bool {
        self.feels
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        jumps::push_departure(self.drive, self.feels, parameters, run, sum, columns);
    }
    fn tell(&self, parameters: &[f64], _: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let (unit, scale, share) = match self.drive {
            Drive::Pull => (&session.output_unit, session.output_scale.abs(), 1.0 + parameters[1]),
            Drive::Command => (&session.input_unit, session.input_scale, 1.0 - parameters[2]),
        };
        BTreeMap::from([(format!("travel_{unit}"), parameters[0] * share * scale)])
    }
}

/// What moves follows with a lag of its own.
fn follow(parameters: &[f64], run: &Run, path: &mut [f64]) {
    if parameters[law::LAG] > 0.0 {
        crate::chain::filters::lag(path, parameters[law::LAG], run.period_s);
    }
}

/// The pull of a tip as its leaps tell it: no effect of its own, but what weights are fitted to.
struct Pull {
    feels: bool,
}

static PULL: Pull = Pull { feels: false };

static FELT_PULL: Pull = Pull { feels: true };

/// What the weights behind a tip are fitted to, with the parameters of [`jumps::tell_pull`]; whether the seat feels what the sensor's effects add.
pub fn pull_as_told(feels: bool) -> &'static dyn Form {
    if feels { &FELT_PULL } else { &PULL }
}

impl Form for Pull {
    fn name(&self) -> &'static str {
        "stick-slip"
    }
    fn form(&self) -> &'static str {
        "the pull that its leaps tell"
    }
    fn place(&self) -> Place {
        Place::Reading
    }
    fn parameters(&self) -> &'static [Parameter] {
        law::OF_A_TIP
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        follow(parameters, run, path);
    }
    fn jumps(&self) -> Option<Drive> {
        Some(Drive::Pull)
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        jumps::tell_pull(self.feels, parameters, run, sum, columns);
    }
}

/// The pressure behind a valve that is never shut: no effect of its own, but what the errors of one that shuts are counted from. The drive of its
/// seat is the command before.
struct NeverShut;

/// See [`NeverShut`].
pub static NEVER_SHUT: &dyn Form = &NeverShut;

impl Form for NeverShut {
    fn name(&self) -> &'static str {
        "valve-dead-band"
    }
    fn form(&self) -> &'static str {
        FOLLOWING
    }
    fn place(&self) -> Place {
        Place::Muscle
    }
    fn parameters(&self) -> &'static [Parameter] {
        &law::OF_A_VALVE[law::LAG..=law::LAG]
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        crate::chain::filters::lag(path, parameters[0], run.period_s);
    }
}
