//! `supply-saturation`: the supply's pressure is the most there is, `v = min(u, L)` with a rounded corner.

use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::data::session::Run;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Corner];

struct Corner;

impl Form for Corner {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "limit", quantity: Quantity::Input, low: 0.3, high: 1.0, logarithmic: false },
                Parameter { name: "rounding", quantity: Quantity::Ratio, low: 1e-3, high: 0.15, logarithmic: true },
            ],
            simpler_at: &[(1, 1e-3)],
            is_static: true,
            starts: || {
                [0.5, 0.6, 0.7, 0.78, 0.85, 0.91, 0.96].into_iter().flat_map(|limit| [vec![limit, 0.005], vec![limit, 0.04]]).collect()
            },
            ..Spec::new("supply-saturation", ("rounded", "rounded corner"), Place::Supply)
        }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        for value in path {
            let initial_state = *value - parameters[0];
            *value -= 0.5 * (initial_state + (initial_state * initial_state + parameters[1] * parameters[1]).sqrt());
        }
    }
}
