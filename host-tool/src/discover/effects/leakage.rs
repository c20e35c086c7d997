//! `leakage`: what is held trickles away: strokes pass, the level decays, `dv/dt = du/dt - v / T`, never below zero.

use crate::discover::catalogue::{Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::ladder;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Hole];

struct Hole;

impl Form for Hole {
    fn name(&self) -> &'static str {
        "leakage"
    }
    fn form(&self) -> &'static str {
        "held pressure decays"
    }
    fn place(&self) -> Place {
        Place::Tube
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "time_constant", quantity: Quantity::Time, low: 0.5, high: 500.0, logarithmic: true }]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(2.0, 100.0, 7).into_iter().map(|value| vec![value]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let keep = (-run.period_s / parameters[0]).exp();
        let mut state = path[0];
        let mut last = path[0];
        // A unipolar line cannot go below the room's pressure.
        let floor = if run.input.iter().all(|&value| value >= -0.05) { 0.0 } else { f64::MIN };
        for value in path {
            state = (keep * state + 0.5 * (1.0 + keep) * (*value - last)).max(floor);
            last = *value;
            *value = state;
        }
    }
}
