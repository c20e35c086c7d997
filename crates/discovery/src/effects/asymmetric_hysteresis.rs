//! `asymmetric-hysteresis`: the loop is not its own mirror image: friction grows with the pressure, on both branches or on one, the branches
//! bend apart, or they part the more the higher the pressure is.

use crate::chain::filters::row;
use crate::chain::form::{Form, OfOperators, Parameter, Quantity, Spec};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&GROWS, &GROWS_UNLOADING, &GROWS_LOADING, &BENDS, &LOADING, &UNLOADING, &UNLIKE, &OPENING];

const BEND: &[Parameter] = &[Parameter { name: "bend", quantity: Quantity::Ratio, low: -0.6, high: 0.9, logarithmic: false }];

const GROWTH: &[Parameter] = &[Parameter { name: "growth", quantity: Quantity::PerInput, low: -0.9, high: 12.0, logarithmic: false }];

const NAME: &str = "asymmetric-hysteresis";

/// A law beside a curve that both branches share.
const fn curved(law: OfOperators, cost: Option<usize>, curve: fn(&[f64], &mut [f64])) -> OfOperators {
    OfOperators { spec: Spec { cost, is_static: true, ..law.spec }, curve, ..law }
}

/// Where the search for [`GROWTH`] begins.
fn growths() -> Vec<Vec<f64>> {
    row(&[-0.7, -0.3, 0.3, 0.8, 1.5, 3.0, 6.0])
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
    || row(&[-0.3, -0.1, 0.08, 0.2, 0.35, 0.5]),
    |parameters, law| law.envelope_bend = parameters[0],
);

static LOADING: OfOperators = curved(
    OfOperators::new(
        (NAME, ("loading-bends", "only the loading branch bends")),
        BEND,
        || row(&[-0.4, -0.15, 0.15, 0.4]),
        |parameters, law| law.envelope_bend = -0.5 * parameters[0],
    ),
    None,
    |parameters, path| both_branches(path, 0.5 * parameters[0]),
);

static UNLOADING: OfOperators = curved(
    OfOperators::new(
        (NAME, ("unloading-bends", "only the unloading branch bends")),
        BEND,
        || row(&[-0.4, -0.15, 0.15, 0.4]),
        |parameters, law| law.envelope_bend = 0.5 * parameters[0],
    ),
    None,
    |parameters, path| both_branches(path, 0.5 * parameters[0]),
);

/// What both branches do alike is a curve of the input and no asymmetry: where the plain curve does as well, it is that. Three bends of any size follow
/// much that is neither.
static UNLIKE: OfOperators = curved(
    OfOperators::new(
        (NAME, ("each-bends", "each branch bends its own way")),
        &[
            Parameter { name: "loading_bend", quantity: Quantity::Ratio, low: -0.8, high: 0.8, logarithmic: false },
            Parameter { name: "unloading_bend", quantity: Quantity::Ratio, low: -0.8, high: 0.8, logarithmic: false },
            Parameter { name: "common_cubic", quantity: Quantity::Ratio, low: -0.6, high: 0.6, logarithmic: false },
        ],
        || [-0.25, 0.25].into_iter().flat_map(|loading| [vec![loading, -0.25, 0.0], vec![loading, 0.25, 0.0]]).collect(),
        |parameters, law| law.envelope_bend = 0.5 * (parameters[1] - parameters[0]),
    ),
    Some(6),
    |parameters, path| {
        for value in path {
            let v = value.clamp(0.0, 1.0);
            *value += v * (1.0 - v) * (0.5 * (parameters[0] + parameters[1]) + parameters[2] * (1.0 - 2.0 * v));
        }
    },
);

/// Generalised play operators: the unloading envelope rises by its own law, `v + A v^n` in place of `v`. Half of that is a curve that both
/// branches share, half opens the loop.
static OPENING: OfOperators = curved(
    OfOperators::new(
        (NAME, ("power-opening", "the branches part with a power of the input")),
        &[
            Parameter { name: "opening", quantity: Quantity::Ratio, low: -0.2, high: 0.4, logarithmic: false },
            Parameter { name: "input_power", quantity: Quantity::Ratio, low: 0.7, high: 3.0, logarithmic: true },
            Parameter { name: "common_bend", quantity: Quantity::Ratio, low: -0.5, high: 0.5, logarithmic: false },
        ],
        || {
            let of = |size: f64| [vec![size, 1.0, 0.0], vec![size, 2.0, size.abs()], vec![size, 2.0, -size.abs()]];
            [-0.04, 0.04, 0.12].into_iter().flat_map(of).collect()
        },
        |parameters, law| [law.opening, law.opening_power] = [parameters[0], parameters[1]],
    ),
    Some(4),
    |parameters, path| both_branches(path, parameters[2]),
);

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
    use crate::data::session::Session;
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
        model.with(&OPENING, vec![0.08, 2.0, 0.0]).columns(run, &mut columns);
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
