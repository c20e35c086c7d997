//! `leakage`: what is held trickles away: strokes pass, the level decays, `dv/dt = du/dt - v / T`, never below zero; or, with a regulator
//! that slowly fills up again, decays towards a share of the command, `dv/dt = du/dt - (v - k u) / T`; or through a hole in which the flow
//! is turbulent, `dv/dt = du/dt - v^n / T`: `n` is one for laminar flow and one half for a wide hole.

use crate::discover::catalogue::{Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::ladder;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Hole, &Refilled, &Turbulent];

struct Hole;
struct Refilled;
struct Turbulent;

const TIME: Parameter = Parameter { name: "time_constant", quantity: Quantity::Time, low: 0.5, high: 500.0, logarithmic: true };

/// Lets `path` decay towards `kept` times itself.
fn leak(path: &mut [f64], time_s: f64, kept: f64, run: &Run) {
    let keep = (-run.period_s / time_s).exp();
    let mut state = path[0];
    let mut last = path[0];
    // A unipolar line cannot go below the room's pressure.
    let floor = if run.input.iter().all(|&value| value >= -0.05) { 0.0 } else { f64::MIN };
    for value in path {
        let rest = kept * 0.5 * (*value + last);
        state = (rest + keep * (state - rest) + 0.5 * (1.0 + keep) * (*value - last)).max(floor);
        last = *value;
        *value = state;
    }
}

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
        &[TIME]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(2.0, 100.0, 7).into_iter().map(|value| vec![value]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        leak(path, parameters[0], 0.0, run);
    }
}

impl Form for Refilled {
    fn name(&self) -> &'static str {
        "leakage"
    }
    fn form(&self) -> &'static str {
        "held pressure decays to a share of the command"
    }
    fn place(&self) -> Place {
        Place::Tube
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[TIME, Parameter { name: "kept_share", quantity: Quantity::Ratio, low: 0.0, high: 0.95, logarithmic: false }]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(2.0, 30.0, 4).into_iter().flat_map(|value| [vec![value, 0.15], vec![value, 0.5]]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        leak(path, parameters[0], parameters[1], run);
    }
}

impl Form for Turbulent {
    fn name(&self) -> &'static str {
        "leakage"
    }
    fn form(&self) -> &'static str {
        "held pressure decays with a power of itself"
    }
    fn place(&self) -> Place {
        Place::Tube
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[TIME, Parameter { name: "pressure_power", quantity: Quantity::Ratio, low: 0.4, high: 1.6, logarithmic: true }]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(2.0, 60.0, 4).into_iter().map(|value| vec![value, 0.7]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let [time_s, power] = [parameters[0], parameters[1]];
        let mut state = path[0].max(0.0);
        let mut last = path[0];
        for value in path {
            // The stroke passes; what it fills leaks for half of the sample's time, what there was for all of it.
            let middle = (state + 0.5 * (*value - last)).max(0.0);
            state = (state + *value - last - run.period_s / time_s * middle.powf(power)).max(0.0);
            last = *value;
            *value = state;
        }
    }
}
