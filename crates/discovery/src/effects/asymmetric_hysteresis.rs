//! `asymmetric-hysteresis`: the loop is not its own mirror image: friction grows with the pressure, on both branches or on one, the branches
//! bend apart, or they part the more the higher the pressure is; or smooth friction has a bound for each direction.

use crate::chain::filters::grid;
use crate::chain::form::{Form, OfOperators, Parameter, Place, Quantity, Spec};
use crate::effects::smooth_hysteresis::{BoucWen, Dahl, LEANING as NAME};
use crate::effects::static_nonlinearity;

/// All forms.
pub const FORMS: &[&dyn Form] = &[
    &GROWS,
    &GROWS_UNLOADING,
    &GROWS_LOADING,
    &BENDS,
    &EACH,
    &BoucWen { leans: true, remembers: false },
    &BoucWen { leans: true, remembers: true },
    &Dahl { leans: true, remembers: false },
    &Dahl { leans: true, remembers: true },
];

const BEND: &[Parameter] = &[Parameter { name: "bend", quantity: Quantity::Ratio, low: -0.6, high: 0.9, logarithmic: false }];

const GROWTH: &[Parameter] = &[Parameter { name: "growth", quantity: Quantity::PerInput, low: -0.9, high: 12.0, logarithmic: false }];

/// Where the search for [`GROWTH`] begins.
fn growths() -> Vec<Vec<f64>> {
    grid(&[&[-0.7, -0.3, 0.3, 0.8, 1.5, 3.0, 6.0]])
}

/// Thresholds that grow with the input, on both branches or on one; the other keeps its thresholds.
static GROWS: OfOperators =
    OfOperators::new((NAME, ("thresholds-grow", "thresholds grow with the input")), GROWTH, growths, |parameters, law| {
        law.growth_per_input = parameters[0]
    });

static GROWS_UNLOADING: OfOperators = OfOperators::new(
    (NAME, ("unloading-thresholds-grow", "thresholds of the unloading branch grow with the input")),
    GROWTH,
    growths,
    |parameters, law| law.growth_unloading = parameters[0],
);

static GROWS_LOADING: OfOperators = OfOperators::new(
    (NAME, ("loading-thresholds-grow", "thresholds of the loading branch grow with the input")),
    GROWTH,
    growths,
    |parameters, law| [law.growth_per_input, law.growth_unloading] = [parameters[0], -parameters[0]],
);

static BENDS: OfOperators = OfOperators::new(
    (NAME, ("bend-apart", "the branches bend apart")),
    BEND,
    || grid(&[&[-0.3, -0.1, 0.08, 0.2, 0.35, 0.5]]),
    |parameters, law| law.envelopes[1] = parameters[0],
);

/// Generalised play operators: each branch is a curve of its own. What both do alike is a curve of the input and no asymmetry: where the plain curve does as
/// well, it is that. Bends of any size follow much that is neither.
static EACH: OfOperators = OfOperators {
    spec: Spec {
        parameters: &[
            Parameter { name: "loading_bend", quantity: Quantity::Ratio, low: -0.8, high: 0.8, logarithmic: false },
            Parameter { name: "unloading_bend", quantity: Quantity::Ratio, low: -0.8, high: 0.8, logarithmic: false },
            Parameter { name: "loading_cubic", quantity: Quantity::Ratio, low: -0.6, high: 0.6, logarithmic: false },
            Parameter { name: "unloading_cubic", quantity: Quantity::Ratio, low: -0.6, high: 0.6, logarithmic: false },
            Parameter { name: "opening", quantity: Quantity::Ratio, low: -0.4, high: 0.8, logarithmic: false },
        ],
        is_static: true,
        nested_limits: |of| vec![(static_nonlinearity::FORMS[0], vec![0.5 * (of[0] + of[1]), 0.5 * (of[2] + of[3]), 0.0])],
        starts: || grid(&[&[-0.25, 0.25], &[-0.25, 0.25], &[0.0], &[0.0], &[0.0, 0.1]]),
        ..Spec::new(NAME, ("each-curves", "each branch has a curve of its own"), Place::Operators)
    },
    set: |of, law| law.envelopes = [0.5 * of[4], 0.5 * (of[1] - of[0]), 0.5 * (of[3] - of[2])],
    curve: |of, path| {
        for value in path {
            let v = value.clamp(0.0, 1.0);
            *value += 0.5 * v * (1.0 - v) * (of[0] + of[1] + (of[2] + of[3]) * (1.0 - 2.0 * v));
        }
    },
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chain::columns::Columns;
    use crate::data::session::Session;
    use crate::model::initial_state::InitialState;
    use crate::model::structure::Model;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn each_branch_follows_its_own_curve() {
        let input: Vec<f64> = (0..1000).map(|sample| 0.5 - 0.5 * (std::f64::consts::TAU * 0.1 * f64::from(sample) * 0.02).cos()).collect();
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input.clone());
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let model = Model { thresholds: vec![0.05], base: vec![0.0; 2], ..Model::baseline(InitialState::Fresh, false) };
        let mut columns = Columns::default();
        let [loading, unloading] = [[0.0, 0.0], [0.2, -0.1]];
        model.with(&EACH, vec![loading[0], unloading[0], loading[1], unloading[1], 0.1]).columns(&session.runs[0], &mut columns);
        let operator = columns.column(1);
        let curve = |[bend, cubic]: [f64; 2], v: f64| v + v * (1.0 - v) * (bend + cubic * (1.0 - 2.0 * v));
        // A quarter and three quarters of the way up, and down again. What parts the branches is a function of the input that their mean has bent.
        for (sample, envelope, gap) in [(83, loading, -0.05), (167, loading, -0.05), (333, unloading, 0.05), (417, unloading, 0.05)] {
            let wanted = curve(envelope, input[sample]) + gap * (1.0 + input[sample]);
            assert!((operator[sample] - wanted).abs() < 3e-3, "{} instead of {wanted} at {sample}", operator[sample]);
        }
        // Branches with one curve are no more than that curve of the input.
        let alike = [0.2, 0.2, -0.1, -0.1, 0.0];
        let (near, mut bent, mut path) = (EACH.nested_limits(&alike), input.clone(), input);
        (EACH.curve)(&alike, &mut bent);
        near[0].0.input(&near[0].1, &session.runs[0], &mut path);
        assert!(near[0].0.name() == "static-nonlinearity" && bent.iter().zip(path).all(|(bent, v)| (bent - v).abs() < 1e-12));
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
