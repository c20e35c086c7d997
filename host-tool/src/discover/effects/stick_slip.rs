//! `stick-slip`: the tip holds until the pull exceeds a band, then jumps by a share of it.

use std::collections::BTreeMap;

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::ladder;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&StickBand];

struct StickBand;

impl Form for StickBand {
    fn name(&self) -> &'static str {
        "stick-slip"
    }
    fn form(&self) -> &'static str {
        "stick band with jumps"
    }
    fn place(&self) -> Place {
        Place::Tip
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "band", quantity: Quantity::Output, low: 1e-3, high: 0.3, logarithmic: true },
            Parameter { name: "remaining_share", quantity: Quantity::Ratio, low: 0.01, high: 0.98, logarithmic: false },
        ]
    }
    fn weights(&self) -> usize {
        1
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        ladder(0.008, 0.12, 9).into_iter().flat_map(|band| [vec![band, 0.15], vec![band, 0.45]]).collect()
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, parameters: &[f64], _: &Run, sum: &[f64], columns: &mut Columns) {
        let (band, remaining) = (parameters[0], parameters[0] * parameters[1]);
        // Where the tip sits is where the pull last made it go: the columns stay linear in the weights.
        let mut place = sum[0];
        let mut moved = 0;
        let mut lean = 0.0;
        let mut from = Vec::with_capacity(sum.len());
        let mut lag = Vec::with_capacity(sum.len());
        for (sample, &pull) in sum.iter().enumerate() {
            let stretch = pull - place;
            if stretch.abs() > band {
                lean = -stretch.signum();
                place = pull + lean * remaining;
                moved = sample;
            }
            from.push(moved);
            lag.push(lean * remaining);
        }
        let samples = columns.samples;
        let mut scratch = vec![0.0; samples];
        columns.filter(|column| {
            for (value, &index) in scratch.iter_mut().zip(&from) {
                *value = column[index];
            }
            column.copy_from_slice(&scratch);
        });
        columns.push(false, |sample| lag[sample]);
    }
    fn tell(&self, weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("remaining_weight".to_owned(), weights[0])])
    }
}
