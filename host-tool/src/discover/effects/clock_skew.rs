//! `clock-skew`: input and output are stamped by clocks of different speed, the delay grows through each recording.

use crate::discover::catalogue::{Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::shift;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Recording];

struct Recording;

impl Form for Recording {
    fn name(&self) -> &'static str {
        "clock-skew"
    }
    fn form(&self) -> &'static str {
        "from the start of each recording"
    }
    fn place(&self) -> Place {
        Place::Tube
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "skew", quantity: Quantity::Ratio, low: -0.03, high: 0.03, logarithmic: false }]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [-0.012, -0.005, -0.002, 0.002, 0.005, 0.012].into_iter().map(|value| vec![value]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let before = path.to_vec();
        // A fast output clock (positive skew: its sample k was taken at k (1 + skew)) sees the input early.
        shift(path, &before, |sample| -parameters[0] * run.time_s[sample] / run.period_s);
    }
}
