//! `dead-time`: pressure waves take time through the tube, `v(t) = u(t - T)`.

use crate::chain::filters::{ladder, shift};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::data::session::Run;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Tube];

struct Tube;

impl Form for Tube {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[Parameter { name: "delay", quantity: Quantity::Time, low: 1e-3, high: 0.8, logarithmic: true }],
            keeps_turning_points: true,
            starts: || ladder(0.01, 0.5, 8).into_iter().map(|value| vec![value]).collect(),
            ..Spec::new("dead-time", ("constant", "constant"), Place::Tube)
        }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let before = path.to_vec();
        let samples = parameters[0] / run.period_s;
        shift(path, &before, |_| samples);
    }
}
