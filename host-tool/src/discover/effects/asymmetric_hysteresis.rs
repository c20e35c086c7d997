//! `asymmetric-hysteresis`: the loop is not its own mirror image: friction grows with the pressure, or the branches bend apart.

use crate::discover::catalogue::{Form, Habit, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Growth, &Bend, &Loading, &Unloading];

struct Growth;
struct Bend;
struct Loading;
struct Unloading;

const BEND: &[Parameter] = &[Parameter { name: "bend", quantity: Quantity::Ratio, low: -0.6, high: 0.9, logarithmic: false }];

impl Form for Growth {
    fn name(&self) -> &'static str {
        "asymmetric-hysteresis"
    }
    fn form(&self) -> &'static str {
        "thresholds grow with the input"
    }
    fn place(&self) -> Place {
        Place::Operators
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "growth", quantity: Quantity::PerInput, low: -0.9, high: 12.0, logarithmic: false }]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [-0.7, -0.3, 0.3, 0.8, 1.5, 3.0, 6.0].into_iter().map(|value| vec![value]).collect()
    }
    fn habit(&self, parameters: &[f64], habit: &mut Habit) {
        habit.growth_per_input = parameters[0];
    }
}

impl Form for Bend {
    fn name(&self) -> &'static str {
        "asymmetric-hysteresis"
    }
    fn form(&self) -> &'static str {
        "the branches bend apart"
    }
    fn place(&self) -> Place {
        Place::Operators
    }
    fn parameters(&self) -> &'static [Parameter] {
        BEND
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [-0.3, -0.1, 0.08, 0.2, 0.35, 0.5].into_iter().map(|value| vec![value]).collect()
    }
    fn habit(&self, parameters: &[f64], habit: &mut Habit) {
        habit.envelope_bend = parameters[0];
    }
}

impl Form for Loading {
    fn name(&self) -> &'static str {
        "asymmetric-hysteresis"
    }
    fn form(&self) -> &'static str {
        "only the loading branch bends"
    }
    fn place(&self) -> Place {
        Place::Operators
    }
    fn parameters(&self) -> &'static [Parameter] {
        BEND
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [-0.4, -0.15, 0.15, 0.4].into_iter().map(|value| vec![value]).collect()
    }
    fn is_static(&self) -> bool {
        true
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        both_branches(path, 0.5 * parameters[0]);
    }
    fn habit(&self, parameters: &[f64], habit: &mut Habit) {
        habit.envelope_bend = -0.5 * parameters[0];
    }
}

impl Form for Unloading {
    fn name(&self) -> &'static str {
        "asymmetric-hysteresis"
    }
    fn form(&self) -> &'static str {
        "only the unloading branch bends"
    }
    fn place(&self) -> Place {
        Place::Operators
    }
    fn parameters(&self) -> &'static [Parameter] {
        BEND
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [-0.4, -0.15, 0.15, 0.4].into_iter().map(|value| vec![value]).collect()
    }
    fn is_static(&self) -> bool {
        true
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        both_branches(path, 0.5 * parameters[0]);
    }
    fn habit(&self, parameters: &[f64], habit: &mut Habit) {
        habit.envelope_bend = 0.5 * parameters[0];
    }
}

/// Bends both branches alike by `size v (1 - v)`; with the envelopes bent apart by as much, one of them stays as it was.
fn both_branches(path: &mut [f64], size: f64) {
    for value in path {
        // Outside the span the curve goes on straight.
        let v = value.clamp(0.0, 1.0);
        *value += size * v * (1.0 - v);
    }
}
