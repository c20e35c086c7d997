//! `asymmetric-hysteresis`: the loop is not its own mirror image: friction grows with the pressure, on both branches or on one, the branches
//! bend apart, or they part the more the higher the pressure is.

use crate::chain::form::{Form, OperatorLaw, Parameter, Place, Quantity, Spec, Told};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&GROWS, &GROWS_UNLOADING, &GROWS_LOADING, &Bend, &Loading, &Unloading, &Unlike, &Opening];

struct Bend;

struct Loading;

struct Unloading;

struct Unlike;

struct Opening;

const BEND: &[Parameter] = &[Parameter { name: "bend", quantity: Quantity::Ratio, low: -0.6, high: 0.9, logarithmic: false }];

const GROWTH: &[Parameter] = &[Parameter { name: "growth", quantity: Quantity::PerInput, low: -0.9, high: 12.0, logarithmic: false }];

/// Branches of the loop.
#[derive(Clone, Copy)]
enum Branches {
    Both,
    Unloading,
    Loading,
}

/// Thresholds that grow with the input, on both branches or on one; the other keeps its thresholds.
struct Growth {
    form: Told,
    branches: Branches,
}

static GROWS: Growth = Growth { form: ("thresholds-grow", "thresholds grow with the input"), branches: Branches::Both };

static GROWS_UNLOADING: Growth =
    Growth { form: ("unloading-thresholds-grow", "thresholds of the unloading branch grow with the input"), branches: Branches::Unloading };

static GROWS_LOADING: Growth =
    Growth { form: ("loading-thresholds-grow", "thresholds of the loading branch grow with the input"), branches: Branches::Loading };

impl Form for Growth {
    fn spec(&self) -> Spec {
        Spec {
            parameters: GROWTH,
            starts: &[&[-0.7], &[-0.3], &[0.3], &[0.8], &[1.5], &[3.0], &[6.0]],
            ..Spec::new("asymmetric-hysteresis", self.form, Place::Operators)
        }
    }
    fn operator_law(&self, parameters: &[f64], operator_law: &mut OperatorLaw) {
        let growth = parameters[0];
        (operator_law.growth_per_input, operator_law.growth_unloading) = match self.branches {
            Branches::Both => (growth, 0.0),
            Branches::Unloading => (0.0, growth),
            Branches::Loading => (growth, -growth),
        };
    }
}

impl Form for Bend {
    fn spec(&self) -> Spec {
        Spec {
            parameters: BEND,
            starts: &[&[-0.3], &[-0.1], &[0.08], &[0.2], &[0.35], &[0.5]],
            ..Spec::new("asymmetric-hysteresis", ("bend-apart", "the branches bend apart"), Place::Operators)
        }
    }
    fn operator_law(&self, parameters: &[f64], operator_law: &mut OperatorLaw) {
        operator_law.envelope_bend = parameters[0];
    }
}

impl Form for Loading {
    fn spec(&self) -> Spec {
        Spec {
            parameters: BEND,
            is_static: true,
            starts: &[&[-0.4], &[-0.15], &[0.15], &[0.4]],
            ..Spec::new("asymmetric-hysteresis", ("loading-bends", "only the loading branch bends"), Place::Operators)
        }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        both_branches(path, 0.5 * parameters[0]);
    }
    fn operator_law(&self, parameters: &[f64], operator_law: &mut OperatorLaw) {
        operator_law.envelope_bend = -0.5 * parameters[0];
    }
}

impl Form for Unloading {
    fn spec(&self) -> Spec {
        Spec {
            parameters: BEND,
            is_static: true,
            starts: &[&[-0.4], &[-0.15], &[0.15], &[0.4]],
            ..Spec::new("asymmetric-hysteresis", ("unloading-bends", "only the unloading branch bends"), Place::Operators)
        }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        both_branches(path, 0.5 * parameters[0]);
    }
    fn operator_law(&self, parameters: &[f64], operator_law: &mut OperatorLaw) {
        operator_law.envelope_bend = 0.5 * parameters[0];
    }
}

impl Form for Unlike {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "loading_bend", quantity: Quantity::Ratio, low: -0.8, high: 0.8, logarithmic: false },
                Parameter { name: "unloading_bend", quantity: Quantity::Ratio, low: -0.8, high: 0.8, logarithmic: false },
                Parameter { name: "common_cubic", quantity: Quantity::Ratio, low: -0.6, high: 0.6, logarithmic: false },
            ],
            // What both branches do alike is a curve of the input and no asymmetry: where the plain curve does as well, it is that.
            // Three bends of any size follow much that is neither.
            cost: Some(6),
            is_static: true,
            ..Spec::new("asymmetric-hysteresis", ("each-bends", "each branch bends its own way"), Place::Operators)
        }
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        [-0.25, 0.25].into_iter().flat_map(|loading| [vec![loading, -0.25, 0.0], vec![loading, 0.25, 0.0]]).collect()
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        for value in path {
            let v = value.clamp(0.0, 1.0);
            *value += v * (1.0 - v) * (0.5 * (parameters[0] + parameters[1]) + parameters[2] * (1.0 - 2.0 * v));
        }
    }
    fn operator_law(&self, parameters: &[f64], operator_law: &mut OperatorLaw) {
        operator_law.envelope_bend = 0.5 * (parameters[1] - parameters[0]);
    }
}

/// Generalised play operators: the unloading envelope rises by its own law, `v + A v^n` in place of `v`. Half of that is a curve that both
/// branches share, half opens the loop.
impl Form for Opening {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "opening", quantity: Quantity::Ratio, low: -0.2, high: 0.4, logarithmic: false },
                Parameter { name: "input_power", quantity: Quantity::Ratio, low: 0.7, high: 3.0, logarithmic: true },
                Parameter { name: "common_bend", quantity: Quantity::Ratio, low: -0.5, high: 0.5, logarithmic: false },
            ],
            // What both branches do alike is a curve of the input and no asymmetry: where the plain curve does as well, it is that.
            cost: Some(4),
            is_static: true,
            ..Spec::new("asymmetric-hysteresis", ("power-opening", "the branches part with a power of the input"), Place::Operators)
        }
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let sizes = [-0.04, 0.04, 0.12];
        sizes.into_iter().flat_map(|size: f64| [vec![size, 1.0, 0.0], vec![size, 2.0, size.abs()], vec![size, 2.0, -size.abs()]]).collect()
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        both_branches(path, parameters[2]);
    }
    fn operator_law(&self, parameters: &[f64], operator_law: &mut OperatorLaw) {
        operator_law.opening = parameters[0];
        operator_law.opening_power = parameters[1];
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chain::columns::Columns;
    use crate::model::initial_state::InitialState;
    use crate::model::structure::Model;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn the_branches_part_with_the_power_of_the_input() {
        let input: Vec<f64> =
            (0..1000).map(|sample| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * 0.1 * f64::from(sample) * 0.02).cos()).collect();
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let model = Model { thresholds: vec![0.1], base: vec![0.0; 2], ..Model::baseline(InitialState::Fresh, false) };
        let mut columns = Columns::default();
        model.with(&Opening, vec![0.08, 2.0, 0.0]).columns(run, &mut columns);
        let operator = columns.column(1);
        // Half way up (2.5 s) and half way down (7.5 s) the envelopes are a quarter of the opening beyond the threshold.
        assert!((operator[125] - (0.5 - 0.1 - 0.02)).abs() < 1e-9, "{}", operator[125]);
        assert!((operator[375] - (0.5 + 0.1 + 0.02)).abs() < 1e-9, "{}", operator[375]);
    }

    #[test]
    fn the_branch_whose_thresholds_grow_is_late_and_the_other_is_where_it_was() {
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * 0.1 * time).cos()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let operator = |forms: &[(&'static dyn Form, f64)]| {
            let mut model = Model { thresholds: vec![0.1], base: vec![0.0; 2], ..Model::baseline(InitialState::Fresh, false) };
            for &(form, size) in forms {
                model = model.with(form, vec![size]);
            }
            let mut columns = Columns::default();
            model.columns(run, &mut columns);
            columns.column(1)
        };
        let (plain, unloading, loading) = (operator(&[]), operator(&[(&GROWS_UNLOADING, 2.0)]), operator(&[(&GROWS_LOADING, 2.0)]));
        // Half way up (2.5 s) and half way down (7.5 s): the threshold there is twice as wide on the branch that grows.
        for (sample, of_unloading, of_loading) in [(125, 0.0, -0.1), (375, 0.1, 0.0)] {
            assert!((unloading[sample] - plain[sample] - of_unloading).abs() < 1e-9, "{} {}", unloading[sample], plain[sample]);
            assert!((loading[sample] - plain[sample] - of_loading).abs() < 1e-9, "{} {}", loading[sample], plain[sample]);
        }
    }
}
