//! `activation-threshold`: below a pressure the bladder does not touch the braid, `v = max(u - P, 0)` with a rounded corner; or the first part
//! of the displacement does not reach the tip, or little of it, `y = s - A min(s, D)`.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Corner, &Slack];

struct Corner;

struct Slack;

impl Form for Corner {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "threshold", quantity: Quantity::Input, low: 0.005, high: 0.7, logarithmic: false },
                Parameter { name: "rounding", quantity: Quantity::Ratio, low: 1e-3, high: 0.15, logarithmic: true },
            ],
            is_static: true,
            ..Spec::new("activation-threshold", ("rounded", "rounded corner"), Place::Muscle)
        }
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [0.03, 0.07, 0.12, 0.18, 0.25, 0.33, 0.45].into_iter().flat_map(|level| [vec![level, 0.005], vec![level, 0.04]]).collect()
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        let rest = 0.5 * (-parameters[0] + parameters[0].hypot(parameters[1]));
        for value in path {
            let initial_state = *value - parameters[0];
            *value = 0.5 * (initial_state + (initial_state * initial_state + parameters[1] * parameters[1]).sqrt()) - rest;
        }
    }
}

impl Form for Slack {
    fn spec(&self) -> Spec {
        Spec {
            // A corner in the upper half is where something ends, not where it begins.
            parameters: &[Parameter { name: "slack", quantity: Quantity::Output, low: 0.01, high: 0.5, logarithmic: false }],
            weights: 1,
            needs_sum: true,
            starts: &[&[0.04], &[0.1], &[0.18], &[0.3]],
            ..Spec::new("activation-threshold", ("of-the-displacement", "of the displacement"), Place::Material)
        }
    }
    fn output(&self, parameters: &[f64], _: &Run, sum: &[f64], columns: &mut Columns) {
        columns.push(false, |sample| -sum[sample].min(parameters[0]));
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("share_lost".to_owned(), weights[0])])
    }
}
