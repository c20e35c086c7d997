//! `rate-dependent-hysteresis`: the loop changes with speed: thresholds grow with the rate or its inverse hyperbolic sine, operators follow late, their weights
//! change with the rate, or a slider before them relaxes.
//!
//! Thresholds that all grow by `c |dv/dt|` and a lag of the time constant `c` are the same to first order in `c`. To second order the lag
//! adds `c^2 v''`; growth that takes a time `T` to build up (a dashpot with a spring in series, Maxwell's element) adds `c T v''`. So what
//! the growth remembers decides between the two, and a form that remembers nothing loses to a lag wherever the rig's growth does.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::filters::{grid, ladder, with};
use crate::chain::form::{Form, OfOperators, Parameter, Place, Quantity, Spec};
use crate::data::session::{Run, Session};
use crate::effects::creep;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&ADDITIVE, &ADDITIVE_FADING, &PROPORTIONAL, &VISCOUS, &STIFFENING, &Weights, &Relaxing];

/// Weights that change with the logarithm of the rate, or in proportion to it.
struct Weights;

/// A slider on a spring (Maxwell slip) whose force relaxes: `f' = k v' - f / T`, no more than it slips at, holds the input back by `f`. Fast strokes
/// drag it to where it slips; slow ones let it go.
struct Relaxing;

/// Eyring's law (1936): an overstress grows with the inverse hyperbolic sine of the rate, in proportion below this one and with its logarithm
/// above.
const RATE: Parameter = Parameter { name: "reference_rate", quantity: Quantity::InputRate, low: 0.01, high: LINEAR, logarithmic: true };

/// A rate that no command reaches, spans per s: below it growth is in proportion.
const LINEAR: f64 = 200.0;

const OVERSTRESS: Parameter = Parameter { name: "overstress", quantity: Quantity::Input, low: 1e-4, high: 100.0, logarithmic: true };

const GROWTH: Parameter = Parameter { name: "growth", quantity: Quantity::Ratio, low: 1e-3, high: 2000.0, logarithmic: true };

/// Time constant of Maxwell's element; as short as a sample it is none.
const FADING: Parameter = Parameter { name: "fading_time", quantity: Quantity::Time, low: 5e-3, high: 0.5, logarithmic: true };

const RELAXATION: Parameter = Parameter { name: "relaxation_time", quantity: Quantity::Time, low: 2e-3, high: 10.0, logarithmic: true };

const NAME: &str = "rate-dependent-hysteresis";

/// Sizes at rates around `RATE`'s.
fn starts(sizes: &[f64]) -> Vec<Vec<f64>> {
    [0.1, 1.0, LINEAR].iter().flat_map(|&rate| sizes.iter().map(move |size| vec![size * rate.max(1.0), rate])).collect()
}

/// Without a memory: with both, and beside another effect, it is whatever a lag is.
static ADDITIVE: OfOperators = {
    let mut own = OfOperators::new(
        (NAME, ("overstress-asinh", "every threshold grows by the same overstress, with the inverse hyperbolic sine of the rate")),
        &[OVERSTRESS, RATE],
        || starts(&ladder(0.003, 0.1, 4)),
        |of, law| [law.extra_per_rate, law.rate_scale_per_s] = [of[0], of[1]],
    );
    own.spec.simpler_at = &[(1, LINEAR)];
    own
};

static ADDITIVE_FADING: OfOperators = OfOperators::new(
    (NAME, ("overstress-fading", "every threshold grows by the same, in proportion to the rate, and builds up and fades")),
    &[Parameter { name: "viscous_time", quantity: Quantity::Time, high: 0.5, ..OVERSTRESS }, FADING],
    || grid(&[&ladder(0.01, 0.1, 3), &[0.02, 0.06]]),
    |of, law| [law.extra_per_rate, law.rate_memory_s] = [of[0], of[1]],
);

static PROPORTIONAL: OfOperators = {
    let mut own = OfOperators::new(
        (NAME, ("share-asinh", "every threshold grows by a share of itself, with the inverse hyperbolic sine of the rate")),
        &[GROWTH, RATE, FADING],
        || with(starts(&ladder(0.05, 1.0, 4)), &[FADING.low, 0.04]),
        // As short as can be it is none.
        |of, law| [law.growth_per_rate, law.rate_scale_per_s, law.rate_memory_s] = [of[0], of[1], of[2] * f64::from(of[2] > FADING.low)],
    );
    own.spec.simpler_at = &[(1, LINEAR), (2, FADING.low)];
    own
};

/// The time constant is that of an operator whose threshold is a tenth of the span; one of several times that is slower by a power of it.
static VISCOUS: OfOperators = {
    let mut own = OfOperators::new(
        (NAME, ("viscous", "operators follow their bounds late")),
        &[RELAXATION, Parameter { name: "power_of_the_threshold", quantity: Quantity::Ratio, low: 0.0, high: 1.0, logarithmic: false }],
        || grid(&[&ladder(0.01, 2.0, 8), &[0.0, 0.6]]),
        |of, law| [law.viscous_s, law.viscous_power] = [of[0], of[1]],
    );
    own.spec.simpler_at = &[(1, 0.0)];
    own
};

static STIFFENING: OfOperators = OfOperators::new(
    (NAME, ("viscous-stiffening", "operators follow their bounds late, far ones faster than in proportion")),
    &[
        Parameter { low: 5e-3, ..RELAXATION },
        Parameter { name: "stiffening_distance", quantity: Quantity::Input, low: 1e-3, high: 1.0, logarithmic: true },
    ],
    || grid(&[&[0.05, 0.2, 0.8], &[0.01, 0.03, 0.1]]),
    |parameters, law| [law.viscous_s, law.stiffening] = [parameters[0], parameters[1]],
);

impl Form for Relaxing {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "stiffness", quantity: Quantity::Ratio, low: 0.02, high: 0.95, logarithmic: true },
                Parameter { name: "slip", quantity: Quantity::Input, low: 5e-3, high: 0.3, logarithmic: true },
                Parameter { name: "relaxation_time", quantity: Quantity::Time, low: 0.05, high: 5.0, logarithmic: true },
            ],
            // A slider that does not slip is an element of Kelvin and Voigt.
            nested_limits: |of| vec![(&creep::OfInput, vec![of[0] / (1.0 - of[0]), of[2], 1.0])],
            starts: || grid(&[&[0.15, 0.4], &[0.03, 0.08], &[0.2, 0.8]]),
            ..Spec::new(NAME, ("relaxing-slider", "a slider holds the input back, and its spring relaxes"), Place::Muscle)
        }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let [stiffness, slip, time_s] = [parameters[0], parameters[1], parameters[2]];
        let (keep, mut force, mut last) = ((-run.period_s / time_s).exp(), 0.0, path[0]);
        for value in path {
            force = (force * keep + stiffness * (*value - last)).clamp(-slip, slip);
            last = *value;
            *value -= force;
        }
    }
}

/// `y = s + f (a s + b u)`: all weights change by one share of `f`, and the one without a threshold by another, with `f = ln(1 + |du/dt| / r)`:
/// what Eyring's law makes of thermally activated friction, far above the rate `r`, and below it in proportion to the rate.
impl Form for Weights {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[RATE],
            starts: || grid(&[&[0.05, 0.4, LINEAR]]),
            simpler_at: &[(0, LINEAR)],
            weights: 2,
            cost: Some(4),
            needs_sum: true,
            ..Spec::new(NAME, ("weights", "weights change with the rate, fast ones with its logarithm"), Place::Material)
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let change: Vec<f64> = rates(&run.input, run.period_s).into_iter().map(|rate| (rate / parameters[0]).ln_1p()).collect();
        columns.push(true, |sample| change[sample] * sum[sample]);
        columns.push(true, |sample| change[sample] * run.input[sample]);
    }
    fn tell(&self, parameters: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let told = [("weights_change", weights[0]), ("of_the_weight_without_threshold", weights[0] + weights[1])];
        let per_rate = |value: f64| value / (parameters[0] * session.input_scale);
        told.map(|(name, value)| (format!("{name}_per_{}_per_s", session.input_unit), per_rate(value))).into()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chain::columns::{AHEAD, Rows, SIDE};
    use crate::chain::form::OperatorLaw;
    use crate::chain::operators::{self, Begin, Lead};

    #[test]
    fn operators_that_follow_late_are_slower_by_a_power_of_their_thresholds() {
        const PERIOD_S: f64 = 0.002;
        let path: Vec<f64> = (0..4000).map(|sample| 0.5 - 0.5 * (1.3 * f64::from(sample) * PERIOD_S).cos()).collect();
        let thresholds = [0.02, 0.1, 0.3];
        for (power, times_s) in [(0.0, [0.2; 3]), (0.5, [0.2 * 0.2_f64.sqrt(), 0.2, 0.2 * 3.0_f64.sqrt()]), (1.0, [0.04, 0.2, 0.6])] {
            let mut law = OperatorLaw::default();
            VISCOUS.operator_law(&[0.2, power], &mut law);
            let mut rows = Rows::default();
            let count = AHEAD + thresholds.len();
            rows.shape(path.len(), count, count.next_multiple_of(SIDE));
            let lead = Lead { begin: Begin::After(&[]), path: &path, operator_law: &law, period_s: PERIOD_S };
            operators::write(&thresholds, &lead, &mut rows);
            for (at, (threshold, time_s)) in thresholds.iter().zip(times_s).enumerate() {
                // A dashpot by Euler's method at a fiftieth of a sample, from where the first sample finds it.
                let mut state = 0.0;
                for (sample, pair) in path.windows(2).enumerate() {
                    for step in 0..50 {
                        let input = pair[0] + (pair[1] - pair[0]) * f64::from(step) / 50.0;
                        let bound = f64::clamp(state, input - threshold, input + threshold);
                        state += (bound - state) * PERIOD_S / 50.0 / time_s;
                    }
                    let got = rows.values[(sample + 1) * rows.stride + AHEAD + at];
                    assert!((got - state).abs() < 2e-3, "power {power}, threshold {threshold}, sample {sample}: {got}, not {state}");
                }
            }
        }
    }

    #[test]
    fn a_slider_that_never_slips_is_the_creep_that_it_is_compared_with() {
        let session = crate::tests::session_of(2000, 0.01, |time_s| 0.5 - 0.5 * (2.0 * time_s).cos());
        let run = &session.runs[0];
        let (mut slid, stiffness) = (run.input.clone(), 0.3);
        let parameters = [stiffness, 0.3, 1.0];
        Relaxing.input(&parameters, run, &mut slid);
        // No more than the spring's share of the stroke, with which it does not slip.
        assert!(run.input.iter().zip(&slid).all(|(input, slid)| (input - slid).abs() < 0.299));
        for (form, parameters) in Relaxing.nested_limits(&parameters) {
            let mut crept = run.input.clone();
            form.input(&parameters, run, &mut crept);
            for (sample, (slid, crept)) in slid.iter().zip(&crept).enumerate() {
                let crept = (1.0 - stiffness) * crept;
                assert!((slid - crept).abs() < 5e-3, "sample {sample}: {slid} instead of {crept}");
            }
        }
        assert_eq!(Relaxing.nested_limits(&parameters).len(), 1);
    }

    #[test]
    fn a_relaxing_slider_holds_back_what_its_spring_keeps_and_no_more_than_it_slips_at() {
        let session = crate::tests::session_of(2000, 0.01, |time_s| 0.05 * time_s);
        let run = &session.runs[0];
        let held = |slip: f64| {
            let mut path = run.input.clone();
            Relaxing.input(&[0.4, slip, 0.5], run, &mut path);
            run.input[1999] - path[1999]
        };
        // On a ramp of a span in 20 s the spring keeps its stiffness times what half a second brings.
        assert!((held(0.3) - 0.4 * 0.05 * 0.5).abs() < 2e-4, "{}", held(0.3));
        assert!((held(0.006) - 0.006).abs() < 1e-12, "{}", held(0.006));
    }
}
