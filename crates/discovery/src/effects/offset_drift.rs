//! `offset-drift`: the zero drifts with the session's time, towards a limit or along a spline; or every recording has a zero of its own.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::form::{Form, Place, Spec};
use crate::data::session::{Run, Session};
use crate::effects::session_curve::{Drifts, SessionCurve, TowardsALimit, is_most};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&LIMIT, &CURVE, &Own { of_creep: false }, &INSIDE];

/// Zeros of the sensor, or what a creep left of recordings before the first one or of a time that nobody wrote down.
struct Own {
    of_creep: bool,
}

/// What a creep of which nobody knows the initial state leaves in each recording. It is never looked for: zeros beside a creep become it.
pub const LEFT_BY_CREEP: &dyn Form = &Own { of_creep: true };

static CURVE: SessionCurve = SessionCurve { name: NAME, drifts: Drifts::Offset };

static LIMIT: TowardsALimit = TowardsALimit::between(NAME, Drifts::Offset);

static INSIDE: TowardsALimit = TowardsALimit::between(NAME, Drifts::Offset).inside();

const NAME: &str = "offset-drift";

/// Whether an effect gives each recording a zero of its own, as the sensor's.
pub fn gives_zeros(form: &dyn Form) -> bool {
    form.name() == NAME && form.spec().reads_output
}

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
                if self.of_creep { "creep" } else { NAME },
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
        let of_zero = |run: &Run, residual: &[f64]| {
            let kept = || residual.iter().zip(&run.keep).filter(|(_, keep)| **keep).map(|(value, _)| value);
            kept().sum::<f64>().powi(2) / kept().count().max(1) as f64
        };
        if !self.of_creep && is_most(session, residual, of_zero) { vec![vec![]] } else { Vec::new() }
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
