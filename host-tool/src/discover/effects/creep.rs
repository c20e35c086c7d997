//! `creep`: the material goes on giving for seconds, over decades of time constants.

use std::collections::BTreeMap;

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::{ladder, lag};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&OfOutput, &OfInput];

/// Retardation times, s: a decade takes about two of them.
pub const TIMES_S: [f64; 4] = [0.5, 2.0, 8.0, 32.0];

struct OfOutput;
struct OfInput;

impl Form for OfOutput {
    fn name(&self) -> &'static str {
        "creep"
    }
    fn form(&self) -> &'static str {
        "of the displacement"
    }
    fn place(&self) -> Place {
        Place::Material
    }
    fn weights(&self) -> usize {
        TIMES_S.len()
    }
    fn cost(&self) -> usize {
        // Weights that must not be negative are rarely all in use.
        2
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, _: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        for time_s in TIMES_S {
            let mut slow = sum.to_vec();
            lag(&mut slow, time_s, run.period_s);
            columns.push(false, |sample| slow[sample]);
        }
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        let total: f64 = weights.iter().sum();
        let mut told = BTreeMap::from([("total_compliance".to_owned(), total)]);
        for (time_s, weight) in TIMES_S.iter().zip(weights) {
            told.insert(format!("compliance_at_{time_s}_s"), *weight);
        }
        told
    }
}

impl Form for OfInput {
    fn name(&self) -> &'static str {
        "creep"
    }
    fn form(&self) -> &'static str {
        "of the pressure's effect"
    }
    fn place(&self) -> Place {
        Place::Muscle
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "total_compliance", quantity: Quantity::Ratio, low: 1e-3, high: 1.0, logarithmic: true },
            Parameter { name: "first_time_constant", quantity: Quantity::Time, low: 0.1, high: 8.0, logarithmic: true },
        ]
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(0.02, 0.3, 3).into_iter().flat_map(|size| [vec![size, 0.4], vec![size, 2.0]]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let before = path.to_vec();
        for factor in [1.0, 5.0, 25.0] {
            let mut slow = before.clone();
            lag(&mut slow, parameters[1] * factor, run.period_s);
            for (value, slow) in path.iter_mut().zip(slow) {
                *value += parameters[0] / 3.0 * slow;
            }
        }
    }
}
