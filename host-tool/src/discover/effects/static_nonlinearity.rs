//! `static-nonlinearity`: a curve without memory, of the pressure or of the displacement.

use std::collections::BTreeMap;

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Pressure, &Displacement, &Parallel];

struct Pressure;
struct Displacement;
struct Parallel;

impl Form for Pressure {
    fn name(&self) -> &'static str {
        "static-nonlinearity"
    }
    fn form(&self) -> &'static str {
        "curve of the input: v = u + a u (1 - u) + b u (1 - u) (1 - 2 u)"
    }
    fn place(&self) -> Place {
        Place::Muscle
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "quadratic", quantity: Quantity::Ratio, low: -0.8, high: 0.8, logarithmic: false },
            Parameter { name: "cubic", quantity: Quantity::Ratio, low: -0.6, high: 0.6, logarithmic: false },
        ]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [-0.4, -0.15, 0.15, 0.4].into_iter().flat_map(|a| [vec![a, -0.08], vec![a, 0.08]]).collect()
    }
    fn is_static(&self) -> bool {
        true
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        for value in path {
            // Outside the span the curve goes on straight.
            let u = value.clamp(0.0, 1.0);
            *value += u * (1.0 - u) * (parameters[0] + parameters[1] * (1.0 - 2.0 * u));
        }
    }
}

impl Form for Displacement {
    fn name(&self) -> &'static str {
        "static-nonlinearity"
    }
    fn form(&self) -> &'static str {
        "curve of the output: y = s + a s^2 + b s^3"
    }
    fn place(&self) -> Place {
        Place::Material
    }
    fn weights(&self) -> usize {
        2
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, _: &[f64], _: &Run, sum: &[f64], columns: &mut Columns) {
        columns.push(true, |sample| sum[sample] * sum[sample]);
        columns.push(true, |sample| sum[sample].powi(3));
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let unit = &session.output_unit;
        BTreeMap::from([
            (format!("quadratic_per_{unit}"), weights[0] / session.output_scale),
            (format!("cubic_per_{unit}2"), weights[1] / session.output_scale.powi(2)),
        ])
    }
}

impl Form for Parallel {
    fn name(&self) -> &'static str {
        "static-nonlinearity"
    }
    fn form(&self) -> &'static str {
        "curve of the input beside the hysteresis: y = s + a u^2 + b u^3"
    }
    fn place(&self) -> Place {
        Place::Material
    }
    fn weights(&self) -> usize {
        2
    }
    fn output(&self, _: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        columns.push(true, |sample| run.input[sample] * run.input[sample]);
        columns.push(true, |sample| run.input[sample].powi(3));
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let (input, output) = (&session.input_unit, &session.output_unit);
        BTreeMap::from([
            (format!("quadratic_{output}_per_{input}2"), weights[0] * session.output_scale / session.input_scale.powi(2)),
            (format!("cubic_{output}_per_{input}3"), weights[1] * session.output_scale / session.input_scale.powi(3)),
        ])
    }
}
