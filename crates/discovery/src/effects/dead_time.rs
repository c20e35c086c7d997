//! `dead-time`: pressure waves take time through the tube, `v(t) = u(t - T)`.

use crate::chain::filters::{ladder, shift};
use crate::chain::form::{Form, Parameter, Place, Quantity};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Tube];

struct Tube;

impl Form for Tube {
    fn name(&self) -> &'static str {
        "dead-time"
    }
    fn form(&self) -> &'static str {
        "constant"
    }
    fn place(&self) -> Place {
        Place::Tube
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "delay", quantity: Quantity::Time, low: 1e-3, high: 0.8, logarithmic: true }]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(0.01, 0.5, 8).into_iter().map(|value| vec![value]).collect()
    }
    fn follows_history(&self) -> bool {
        false
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let before = path.to_vec();
        let samples = parameters[0] / run.period_s;
        shift(path, &before, |_| samples);
    }
}
