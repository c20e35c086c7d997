//! What holds at a stick position and breaks away, its stick position read from the output: the form that a sticking tip and a valve share.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::form::{Drive, FOLLOWING, Form, Place, Spec, Told};
use crate::data::session::{Run, Session};
use crate::observers::{jumps, law};

/// Where it sits hangs on when it last broke away, which no simulation meets; it is read from the output seen so far.
pub struct Sticking {
    /// The effect.
    pub name: &'static str,
    /// The form's description.
    pub form: Told,
    /// What it breaks away by.
    pub drive: Drive,
    /// Whether the stick position feels what the sensor's effects add: a heart may quasi-static response at the wire behind a tip that sticks, or beat against the tip.
    pub feels: bool,
}

impl Form for Sticking {
    fn spec(&self) -> Spec {
        // What it departs from is the model's output: a valve acts on the pressure, but it is seen behind everything.
        Spec {
            parameters: match self.drive {
                Drive::QuasiStatic => law::OF_A_TIP,
                Drive::Command => law::OF_A_VALVE,
            },
            simpler_at: match self.drive {
                Drive::QuasiStatic => &[],
                Drive::Command => &[(8, law::NEVER)],
            },
            weights: 1,
            discrete: true,
            jumps: Some(self.drive),
            feels_sensor: self.feels,
            needs_sum: true,
            starts: || Vec::new(),
            ..Spec::new(self.name, self.form, Place::Reading)
        }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        follow(parameters, run, path);
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        jumps::push_departure(self.drive, self.feels, parameters, run, sum, columns);
    }
    fn tell(&self, parameters: &[f64], _: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let (unit, scale, share) = match self.drive {
            Drive::QuasiStatic => (&session.output_unit, session.output_scale.abs(), 1.0 + parameters[1]),
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

/// The quasi-static response of a tip as its slips tell it: no effect of its own, but what weights are fitted to.
struct QuasiStatic {
    feels: bool,
}

static QUASI_STATIC: QuasiStatic = QuasiStatic { feels: false };

static FELT_QUASI_STATIC: QuasiStatic = QuasiStatic { feels: true };

/// What the weights behind a tip are fitted to, with the parameters of the observers; whether the stick position feels what the sensor's effects add.
pub fn inferred_quasi_static(feels: bool) -> &'static dyn Form {
    if feels { &FELT_QUASI_STATIC } else { &QUASI_STATIC }
}

impl Form for QuasiStatic {
    fn spec(&self) -> Spec {
        Spec {
            parameters: law::OF_A_TIP,
            jumps: Some(Drive::QuasiStatic),
            needs_sum: true,
            ..Spec::new("stick-slip", ("pull", "the pull that its leaps tell"), Place::Reading)
        }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        follow(parameters, run, path);
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        jumps::infer_quasi_static(self.feels, parameters, run, sum, columns);
    }
}

/// The pressure behind a valve that is never shut: no effect of its own, but what the errors of one that shuts are counted from. The drive of its
/// stick position is the command before.
struct LagWithoutDeadBand;

/// The pressure behind a valve that is never shut.
pub static LAG_WITHOUT_DEAD_BAND: &dyn Form = &LagWithoutDeadBand;

impl Form for LagWithoutDeadBand {
    fn spec(&self) -> Spec {
        Spec { parameters: &law::OF_A_VALVE[law::LAG..=law::LAG], ..Spec::new("valve-dead-band", FOLLOWING, Place::Muscle) }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        crate::chain::filters::lag(path, parameters[0], run.period_s);
    }
}
