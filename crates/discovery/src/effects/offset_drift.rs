//! `offset-drift`: the zero drifts with the session's time, towards a limit or along a spline; or every recording has a zero of its own.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::data::noise;
use crate::data::session::{Run, Session};
use crate::effects::session_curve::{Drifts, SessionCurve};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&WarmUp, &CURVE, &Own { of_creep: false }];

struct WarmUp;

/// Zeros of the sensor, or what a creep left of recordings before the first one or of a time that nobody wrote down.
struct Own {
    of_creep: bool,
}

/// What a creep of which nobody knows the initial state leaves in each recording. It is never looked for: zeros beside a creep become it.
pub const LEFT_BY_CREEP: &dyn Form = &Own { of_creep: true };

static CURVE: SessionCurve = SessionCurve { name: "offset-drift", drifts: Drifts::Offset };

impl Form for WarmUp {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[Parameter { name: "time_constant", quantity: Quantity::Time, low: 10.0, high: 1e5, logarithmic: true }],
            weights: 1,
            is_between_recordings: true,
            ..Spec::new("offset-drift", ("towards-a-limit", "towards a limit"), Place::Sensor)
        }
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [0.1, 0.3, 1.0, 5.0].into_iter().map(|share| vec![share * session.length_s]).collect()
    }
    fn output(&self, parameters: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        columns.push(true, |sample| -(-run.session_s[sample] / parameters[0]).exp_m1());
    }
    fn tell(&self, parameters: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        // The limit of a drift that has hardly begun to bend is anybody's guess; what it did in the session is not.
        let reached = -(-session.length_s / parameters[0]).exp_m1() * weights[0] * session.output_scale;
        BTreeMap::from([(format!("drift_in_the_session_{}", session.output_unit), reached)])
    }
}

/// Whether an effect gives each recording a zero of its own, as the sensor's.
pub fn gives_zeros(form: &dyn Form) -> bool {
    form.name() == WarmUp.spec().name && form.spec().reads_output
}

/// Least share of what the model leaves above the noise that must be in the recordings' means.
const LEAST_OF_ZEROS: f64 = 0.6;

/// A zero that walks at random, or recordings whose times nobody wrote down: no curve of the session's time follows it.
impl Form for Own {
    fn spec(&self) -> Spec {
        Spec {
            weights: 1,
            // It reads one value from each recording, those that it is judged by included.
            cost: Some(10),
            reads_output: true,
            is_between_recordings: true,
            is_a_zero: true,
            needs_sum: true,
            ..Spec::new(
                if self.of_creep { "creep" } else { "offset-drift" },
                if self.of_creep {
                    ("left-zeros", "what it left of what nobody recorded, a zero in each recording")
                } else {
                    ("of-each-recording", "a zero of its own in each recording")
                },
                Place::Sensor,
            )
        }
    }
    fn start_up_s(&self, _: &[f64]) -> f64 {
        1.0
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        if self.of_creep {
            return Vec::new();
        }
        // Whatever a model lacks leaves its mean in each recording, beside much else; a zero leaves nothing else.
        let kept = |run: &Run| -> Vec<f64> {
            residual[run.index].iter().zip(&run.keep).filter(|(_, keep)| **keep).map(|(value, _)| *value).collect()
        };
        let worked = |run: &&Run| run.is_worked_with();
        let (mut of_zeros, mut whole, mut count) = (0.0, 0.0, 1e-30);
        for values in session.runs.iter().filter(worked).map(kept) {
            of_zeros += values.iter().sum::<f64>().powi(2) / values.len().max(1) as f64;
            whole += values.iter().map(|value| value * value).sum::<f64>();
            count += values.len() as f64;
        }
        let of_noise = count * noise::floor(session, residual).powi(2);
        if of_zeros > LEAST_OF_ZEROS * (whole - of_noise) { vec![vec![]] } else { Vec::new() }
    }
    fn output(&self, _: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        // Where there is no measured output (a simulation) the zero stays where it is.
        let measured = run.output.iter().any(|value| *value != 0.0);
        let kept = || run.keep.iter().zip(run.output.iter().zip(sum)).filter(|(keep, _)| measured && **keep);
        let zero = kept().map(|(_, (output, sum))| output - sum).sum::<f64>() / kept().count().max(1) as f64;
        columns.push(false, |_| zero);
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("share_of_the_zeros".to_owned(), weights[0])])
    }
}
