//! `rate-dependent-hysteresis`: the loop changes with speed: thresholds grow with the rate or its inverse hyperbolic sine, operators follow late, or their weights
//! change with the rate.
//!
//! Thresholds that all grow by `c |dv/dt|` and a lag of the time constant `c` are the same to first order in `c`. To second order the lag
//! adds `c^2 v''`; growth that takes a time `T` to build up (a dashpot with a spring in series, Maxwell's element) adds `c T v''`. So what
//! the growth remembers decides between the two, and a form that remembers nothing loses to a lag wherever the rig's growth does.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::filters::{grid, ladder, row};
use crate::chain::form::{Form, OfOperators, OperatorLaw, Parameter, Place, Quantity, Spec};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&ADDITIVE, &PROPORTIONAL, &VISCOUS, &STIFFENING, &Weights, &LogarithmicWeights];

struct Weights;

struct LogarithmicWeights;

/// Eyring's law (1936): an overstress grows with the inverse hyperbolic sine of the rate, in proportion below this one and with its logarithm
/// above.
const RATE: Parameter = Parameter { name: "reference_rate", quantity: Quantity::InputRate, low: 0.01, high: LINEAR, logarithmic: true };

/// A rate that no command reaches, spans per s: below it growth is in proportion.
const LINEAR: f64 = 200.0;

const OVERSTRESS: Parameter = Parameter { name: "overstress", quantity: Quantity::Input, low: 1e-4, high: 100.0, logarithmic: true };

const GROWTH: Parameter = Parameter { name: "growth", quantity: Quantity::Ratio, low: 1e-3, high: 2000.0, logarithmic: true };

/// Time constant of Maxwell's element; as short as a sample it is none.
const FADING: Parameter = Parameter { name: "fading_time", quantity: Quantity::Time, low: 5e-3, high: 0.5, logarithmic: true };

const RELAXATION: Parameter = Parameter { name: "relaxation_time", quantity: Quantity::Time, low: 2e-3, high: 1.0, logarithmic: true };

const NAME: &str = "rate-dependent-hysteresis";

/// Sizes at rates around `RATE`'s, each followed at once and with a memory.
fn starts(sizes: &[f64]) -> Vec<Vec<f64>> {
    let growths = [0.1, 1.0, LINEAR].map(|rate| sizes.iter().map(move |size| [size * f64::max(rate, 1.0), rate]));
    growths.into_iter().flatten().flat_map(|[size, rate]| [FADING.low, 0.04].map(|fading_s| vec![size, rate, fading_s])).collect()
}

/// A law with all three parameters by those of the forms that had fewer: growth in proportion to the rate, with a memory or none.
fn of_fewer(stem: &str, form: &str, parameters: &[f64]) -> Option<Vec<f64>> {
    match (form.strip_prefix(stem)?, parameters) {
        ("-linear" | ", in proportion to the rate", &[growth]) => Some(vec![growth * LINEAR, LINEAR, FADING.low]),
        ("-fading" | ", in proportion to the rate, and builds up and fades", &[growth, fading_s]) => {
            Some(vec![growth * LINEAR, LINEAR, fading_s])
        }
        _ => None,
    }
}

/// The memory, or none where it is as short as can be.
fn memory_s(parameters: &[f64]) -> f64 {
    if parameters[2] > FADING.low { parameters[2] } else { 0.0 }
}

const WITH_A_MEMORY: &[(usize, f64)] = &[(1, LINEAR), (2, FADING.low)];

static ADDITIVE: OfOperators = {
    let form = ("overstress-asinh", "every threshold grows by the same overstress, with the inverse hyperbolic sine of the rate");
    let set = |parameters: &[f64], law: &mut OperatorLaw| {
        [law.extra_per_rate, law.rate_scale_per_s, law.rate_memory_s] = [parameters[0], parameters[1], memory_s(parameters)];
    };
    let mut own = OfOperators::new((NAME, form), &[OVERSTRESS, RATE, FADING], || starts(&ladder(0.003, 0.1, 4)), set);
    own.spec.simpler_at = WITH_A_MEMORY;
    own.of_earlier = |form, parameters| {
        of_fewer("overstress", form, parameters).or_else(|| of_fewer("every threshold grows by the same", form, parameters))
    };
    own
};

static PROPORTIONAL: OfOperators = {
    let form = ("share-asinh", "every threshold grows by a share of itself, with the inverse hyperbolic sine of the rate");
    let set = |parameters: &[f64], law: &mut OperatorLaw| {
        [law.growth_per_rate, law.rate_scale_per_s, law.rate_memory_s] = [parameters[0], parameters[1], memory_s(parameters)];
    };
    let mut own = OfOperators::new((NAME, form), &[GROWTH, RATE, FADING], || starts(&ladder(0.05, 1.0, 4)), set);
    own.spec.simpler_at = WITH_A_MEMORY;
    own.of_earlier = |form, parameters| {
        of_fewer("share", form, parameters).or_else(|| of_fewer("every threshold grows by a share of itself", form, parameters))
    };
    own
};

static VISCOUS: OfOperators = OfOperators::new(
    (NAME, ("viscous", "operators follow their bounds late")),
    &[RELAXATION],
    || row(&ladder(0.01, 0.4, 6)),
    |parameters, law| law.viscous_s = parameters[0],
);

static STIFFENING: OfOperators = OfOperators::new(
    (NAME, ("viscous-stiffening", "operators follow their bounds late, far ones faster than in proportion")),
    &[
        Parameter { low: 5e-3, high: 10.0, ..RELAXATION },
        Parameter { name: "stiffening_distance", quantity: Quantity::Input, low: 1e-3, high: 1.0, logarithmic: true },
    ],
    || grid(&[0.05, 0.2, 0.8], &[0.01, 0.03, 0.1]),
    |parameters, law| [law.viscous_s, law.stiffening] = [parameters[0], parameters[1]],
);

/// `y = s + |du/dt| (a s + b u)`: all weights change by one share for each unit of the rate, and the one without a threshold by another.
impl Form for Weights {
    fn spec(&self) -> Spec {
        Spec {
            weights: 2,
            cost: Some(3),
            needs_sum: true,
            ..Spec::new(NAME, ("weights-linear", "weights change with the rate"), Place::Material)
        }
    }
    fn output(&self, _: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let rates = rates(&run.input, run.period_s);
        columns.push(true, |sample| rates[sample] * sum[sample]);
        columns.push(true, |sample| rates[sample] * run.input[sample]);
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let of = |weight: f64| weight / session.input_scale;
        let per = format!("per_{}_per_s", session.input_unit);
        BTreeMap::from([
            (format!("weights_change_{per}"), of(weights[0])),
            (format!("of_the_weight_without_threshold_{per}"), of(weights[0] + weights[1])),
        ])
    }
}

/// `y = s + ln(1 + |du/dt| / r) (a s + b u)`: what Eyring's law makes of thermally activated friction, far above the rate `r`.
impl Form for LogarithmicWeights {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[Parameter { name: "reference_rate", quantity: Quantity::InputRate, low: 1e-2, high: 5.0, logarithmic: true }],
            weights: 2,
            cost: Some(4),
            needs_sum: true,
            ..Spec::new(NAME, ("weights-logarithmic", "weights change with the logarithm of the rate"), Place::Material)
        }
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        vec![vec![0.05], vec![0.4]]
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let folds: Vec<f64> = rates(&run.input, run.period_s).into_iter().map(|rate| (rate / parameters[0]).ln_1p()).collect();
        columns.push(true, |sample| folds[sample] * sum[sample]);
        columns.push(true, |sample| folds[sample] * run.input[sample]);
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([
            ("weights_change_per_e_fold".to_owned(), weights[0]),
            ("of_the_weight_without_threshold_per_e_fold".to_owned(), weights[0] + weights[1]),
        ])
    }
}

/// How fast the input goes, spans per s, over two samples to either side: noise of the command is no speed.
fn rates(input: &[f64], period_s: f64) -> Vec<f64> {
    let last = input.len() - 1;
    let rate = |sample: usize| {
        let (before, after) = (sample.saturating_sub(2), (sample + 2).min(last));
        (input[after] - input[before]).abs() / ((after - before) as f64 * period_s)
    };
    (0..input.len()).map(rate).collect()
}
