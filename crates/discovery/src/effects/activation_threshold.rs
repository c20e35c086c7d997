//! `activation-threshold`: below a pressure the bladder does not touch the braid, `v = max(u - P, 0)` with a rounded corner; or the first part
//! of the displacement does not reach the tip, or little of it, `y = s - A min(s, D)`; or something opens at a pressure and passes all of it; or a command of either sign has a dead zone about its centre.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::filters::grid;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Corner, &Opens, &Slack, &TwoSided];

struct Corner;

/// A valve that cracks open at the threshold and soon passes all: `v = u w` with an opening `w` from 0 to 1.
struct Opens;

struct Slack;

/// A dead zone about the centre: `v = max(u - P, 0) - max(-u - N, 0)`.
struct TwoSided;

impl Form for Corner {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "threshold", quantity: Quantity::Input, low: 0.005, high: 0.7, logarithmic: false },
                Parameter { name: "rounding", quantity: Quantity::Ratio, low: SHARPEST, high: 0.15, logarithmic: true },
            ],
            simpler_at: &[(1, SHARPEST)],
            is_static: true,
            starts: || {
                [0.03, 0.07, 0.12, 0.18, 0.25, 0.33, 0.45].into_iter().flat_map(|level| [vec![level, 0.005], vec![level, 0.04]]).collect()
            },
            ..Spec::new("activation-threshold", ("rounded", "rounded corner"), Place::Muscle)
        }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        path.iter_mut().for_each(|value| *value = beyond(*value, parameters[0], parameters[1]));
    }
}

impl Form for Opens {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "threshold", quantity: Quantity::Input, low: 0.02, high: 0.6, logarithmic: false },
                Parameter { name: "opening", quantity: Quantity::Ratio, low: 2e-3, high: 0.2, logarithmic: true },
            ],
            is_static: true,
            starts: || grid(&[&[0.06, 0.12, 0.18, 0.25, 0.35], &[0.01, 0.04]]),
            ..Spec::new("activation-threshold", ("opens", "nothing below, all of it above"), Place::Muscle)
        }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        path.iter_mut().for_each(|value| *value *= ((*value - parameters[0]) / parameters[1]).clamp(0.0, 1.0));
    }
}

/// What of `value` lies beyond a threshold with a rounded corner; nothing at zero.
fn beyond(value: f64, threshold: f64, rounding: f64) -> f64 {
    let above = value - threshold;
    0.5 * (above + (above * above + rounding * rounding).sqrt() + threshold - threshold.hypot(rounding))
}

/// A corner as sharp as any.
const SHARPEST: f64 = 1e-3;

/// Rounding of the corners of [`TwoSided`].
const SHARP: f64 = 0.005;

impl Form for TwoSided {
    fn spec(&self) -> Spec {
        const EDGE: Parameter = Parameter { name: "threshold", quantity: Quantity::Input, low: 0.005, high: 0.7, logarithmic: false };
        Spec {
            parameters: &[EDGE, Parameter { name: "threshold_below", ..EDGE }],
            is_static: true,
            ..Spec::new("activation-threshold", ("two-sided", "a dead zone about the centre"), Place::Muscle)
        }
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let edges = [0.03, 0.08, 0.16, 0.3];
        let all = edges.iter().flat_map(|&above| edges.map(|below| vec![above, below])).collect();
        if session.worked().any(|run| run.input.iter().any(|value| *value < -edges[0])) { all } else { Vec::new() }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        path.iter_mut().for_each(|value| *value = beyond(*value, parameters[0], SHARP) - beyond(-*value, parameters[1], SHARP));
    }
}

impl Form for Slack {
    fn spec(&self) -> Spec {
        Spec {
            // A corner in the upper half is where something ends, not where it begins.
            parameters: &[Parameter { name: "slack", quantity: Quantity::Output, low: 0.01, high: 0.5, logarithmic: false }],
            weights: 1,
            needs_sum: true,
            starts: || vec![vec![0.04], vec![0.1], vec![0.18], vec![0.3]],
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

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Recording, Signal};
    use std::path::Path;

    /// A recording that goes from `low` to 1.
    fn session(low: f64) -> Session {
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| low + (1.0 - low) * (0.5 - 0.5 * time.cos())).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        Session::new(&[recording.expect("a recording")], &[]).expect("a session")
    }

    #[test]
    fn a_dead_zone_passes_what_lies_beyond_its_edges() {
        let session = session(-1.0);
        let run = &session.runs[0];
        let mut path = run.input.clone();
        TwoSided.input(&[0.2, 0.35], run, &mut path);
        for (value, input) in path.iter().zip(&run.input) {
            let exact = input - input.clamp(-0.35, 0.2);
            // A rounded corner is half of the rounding off at most.
            assert!((value - exact).abs() < 0.6 * SHARP, "{value} of {input}");
        }
        let mut rest = [0.0];
        TwoSided.input(&[0.2, 0.35], run, &mut rest);
        assert!(rest[0].abs() < 1e-15, "{rest:?}");
    }

    #[test]
    fn a_dead_zone_is_looked_for_where_the_command_has_either_sign() {
        for (low, is_tried) in [(-1.0, true), (0.0, false)] {
            assert_ne!(TwoSided.starts(&session(low), &[]).is_empty(), is_tried, "from {low}");
        }
    }

    #[test]
    fn what_opens_passes_nothing_below_and_everything_above() {
        let session = session(0.0);
        let mut path = session.runs[0].input.clone();
        Opens.input(&[0.2, 0.1], &session.runs[0], &mut path);
        for (value, input) in path.iter().zip(&session.runs[0].input) {
            let share = if *input < 0.2 {
                0.0
            } else if *input > 0.3 {
                1.0
            } else {
                (input - 0.2) / 0.1
            };
            assert!((value - share * input).abs() < 1e-12, "{value} of {input}");
        }
    }
}
