//! `gain-drift`: the gain wanders with the session's time, towards a limit or along a spline.

use std::collections::BTreeMap;

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::session_curve::{Drifts, SessionCurve};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&WarmUp, &CURVE];

struct WarmUp;
static CURVE: SessionCurve = SessionCurve { name: "gain-drift", drifts: Drifts::Gain };

impl Form for WarmUp {
    fn name(&self) -> &'static str {
        "gain-drift"
    }
    fn form(&self) -> &'static str {
        "towards a limit"
    }
    fn place(&self) -> Place {
        Place::Sensor
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "time_constant", quantity: Quantity::Time, low: 10.0, high: 1e5, logarithmic: true }]
    }
    fn weights(&self) -> usize {
        1
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [0.1, 0.3, 1.0, 5.0].into_iter().map(|share| vec![share * session.length_s]).collect()
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        columns.push(true, |sample| -sum[sample] * (-run.session_s[sample] / parameters[0]).exp_m1());
    }
    fn tell(&self, parameters: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        // The limit of a drift that has hardly begun to bend is anybody's guess; what it did in the session is not.
        let reached = -(-session.length_s / parameters[0]).exp_m1() * weights[0];
        BTreeMap::from([("drift_in_the_session".to_owned(), reached)])
    }
}
