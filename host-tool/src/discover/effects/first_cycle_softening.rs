//! `first-cycle-softening` (Mullins): the first strokes of a recording are stiffer, `y = s (1 - A exp(-d / D))` with the distance travelled `d`.

use std::collections::BTreeMap;

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::ladder;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Distance];

struct Distance;

impl Form for Distance {
    fn name(&self) -> &'static str {
        "first-cycle-softening"
    }
    fn form(&self) -> &'static str {
        "with the distance that the displacement has travelled since the recording began"
    }
    fn place(&self) -> Place {
        Place::Material
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "distance", quantity: Quantity::Output, low: 0.1, high: 10.0, logarithmic: true }]
    }
    fn weights(&self) -> usize {
        1
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(0.3, 6.0, 6).into_iter().map(|value| vec![value]).collect()
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, parameters: &[f64], _: &Run, sum: &[f64], columns: &mut Columns) {
        let mut travelled = 0.0;
        let mut last = sum[0];
        columns.push(true, |sample| {
            travelled += (sum[sample] - last).abs();
            last = sum[sample];
            sum[sample] * (-travelled / parameters[0]).exp()
        });
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("missing_gain".to_owned(), -weights[0])])
    }
}
