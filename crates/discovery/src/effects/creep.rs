//! `creep`: the material goes on giving for seconds, over decades of time constants.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::chain::columns::{Columns, Filter};
use crate::chain::filters::{Lag, grid, ladder, lag};
use crate::chain::form::{Form, Limits, Parameter, Place, Quantity, Spec, Told};
use crate::chain::side_by_side::leads_input;
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[
    &OfOutput(0),
    &OfOutput(1),
    &OfOutput(2),
    &OfOutput(3),
    &OfInput,
    &Activated { of_input: true },
    &Activated { of_input: false },
    crate::effects::offset_drift::LEFT_BY_CREEP,
];

/// Retardation times, s: a decade takes about two of them, and what creeps over decades has begun before the second is over.
pub const TIMES_S: [f64; 5] = [0.12, 0.5, 2.0, 8.0, 32.0];

/// Those of them that creep by the square of the load as well: what earlier recordings have left of that is not known, so none that outlasts a pause.
const SQUARED: Range<usize> = 1..4;

/// Share of what a recording has left in the material below which earlier recordings are not looked at.
const FORGOTTEN: f64 = 0.01;

/// By its number in [`FORMS`]: the plain one; one that goes on from recording to recording; one that, beside that, gives by the square of the load as
/// well (Leaderman 1943, Schapery 1969); and one that goes on under an input that is held where a recording ended.
struct OfOutput(usize);

const CURVED: usize = 2;

const HELD: usize = 3;

/// Of the pressure before the hysteresis.
pub struct OfInput;

/// Thermally activated flow (Eyring 1936): `z' = (A / T) sinh((x - z) / A)`, which creeps as the logarithm of time; of the pressure
/// before the hysteresis, `v = u + B z(u)`, or of the displacement behind it.
struct Activated {
    of_input: bool,
}

/// What earlier recordings have left, at the start of this one, in the input behind a lag of `time_s`: the lagged input over that of this start. Between
/// recordings the input rests where the next one starts, or where the last one ended (`held`).
pub fn left_of_earlier(run: &Run, time_s: f64, held: bool) -> f64 {
    let (start_s, start) = (run.session_s[0], run.input[0]);
    let fades_to = |from_s: f64| ((from_s - start_s) / time_s).exp();
    let (mut left, mut next) = (0.0, run);
    for earlier in run.session.iter().take(run.index).rev().take_while(|_| fades_to(next.session_s[0]) > FORGOTTEN) {
        let last = earlier.input.len() - 1;
        let (share, keep) = (earlier.period_s / time_s, (-earlier.period_s / time_s).exp());
        let at_its_end = earlier.input.iter().fold(0.0, |left, value| left * keep + value - start);
        let [end, resumed] = [earlier.session_s[last], next.session_s[0]].map(fades_to);
        let rest = if held { earlier.input[last] } else { next.input[0] };
        left += (resumed - end) * (rest - start) + share * at_its_end * end;
        next = earlier;
    }
    left + fades_to(next.session_s[0]) * (next.input[0] - start)
}

/// The same for a lag of [`TIMES_S`], as a file tells or by the recordings before.
fn left(run: &Run, at: usize, held: bool) -> f64 {
    let place = if held { TIMES_S.len() + at } else { at };
    run.earlier.as_ref().map_or_else(|| left_of_earlier(run, TIMES_S[at], held), |earlier| earlier.creeping[place])
}

/// How much of the output goes with a unit of the input in one recording.
pub fn gain(input: &[f64], output: &[f64]) -> f64 {
    let moved = |values: &[f64], sample: usize| values[sample] - values[0];
    let (product, square) = (0..input.len()).fold((0.0, 1e-30), |(product, square), sample| {
        let input = moved(input, sample);
        (product + input * moved(output, sample), square + input * input)
    });
    product / square
}

impl Form for OfOutput {
    fn spec(&self) -> Spec {
        const NAMES: [Told; 4] = [
            ("of-the-displacement", "of the displacement"),
            ("of-the-displacement-going-on", "of the displacement, going on from recording to recording"),
            ("of-the-displacement-curved", "of the displacement and its square, going on from recording to recording"),
            ("of-the-displacement-held", "of the displacement, going on where the last recording ended"),
        ];
        // Weights that must not be negative are rarely all in use.
        let (weights, cost) = if self.0 == CURVED { (TIMES_S.len() + SQUARED.len(), Some(4)) } else { (TIMES_S.len(), Some(2)) };
        Spec { weights, cost, needs_sum: true, ..Spec::new("creep", NAMES[self.0], Place::Material) }
    }
    fn output(&self, _: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        for (at, time_s) in TIMES_S.into_iter().enumerate() {
            let mut slow = sum.to_vec();
            lag(&mut slow, time_s, run.period_s);
            if self.0 > 0 {
                // The displacement of earlier recordings is in proportion to their input, closely enough for what is left of it.
                let left = gain(&run.input, sum) * left(run, at, self.0 == HELD);
                let keep = (-run.period_s / time_s).exp();
                slow.iter_mut().fold(left, |left, value| {
                    *value += left;
                    left * keep
                });
            }
            columns.push(false, |sample| slow[sample]);
        }
        for &time_s in if self.0 == CURVED { &TIMES_S[SQUARED] } else { &[] } {
            let mut slow: Vec<f64> = sum.iter().map(|value| value * value.abs()).collect();
            lag(&mut slow, time_s, run.period_s);
            columns.push(false, |sample| slow[sample]);
        }
    }
    fn nested_limits(&self, _: &[f64]) -> Limits {
        // Weights of zero, and nothing left of earlier recordings: the forms before this one.
        FORMS[..if self.0 == HELD { 1 } else { self.0 }].iter().map(|form| (*form, Vec::new())).collect()
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        // Of the whole stroke, which is one long.
        let squared = |at: usize| SQUARED.clone().position(|squared| squared == at).map(|at| TIMES_S.len() + at);
        let of = |at: usize| [Some(at), squared(at)].into_iter().flatten().filter_map(|at| weights.get(at)).sum();
        let at_times = TIMES_S.iter().enumerate().map(|(at, time_s)| (format!("compliance_at_{time_s}_s"), of(at)));
        at_times.chain([("total_compliance".to_owned(), weights.iter().sum())]).collect()
    }
}

impl Form for OfInput {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "total_compliance", quantity: Quantity::Ratio, low: 1e-3, high: 1.0, logarithmic: true },
                Parameter { name: "first_time_constant", quantity: Quantity::Time, low: 0.1, high: 8.0, logarithmic: true },
                Parameter { name: "times_as_long", quantity: Quantity::Ratio, low: 1.0, high: 10.0, logarithmic: true },
            ],
            simpler_at: &[(2, 1.0)],
            starts: || grid(&[&ladder(0.02, 0.3, 3), &[0.4, 2.0], &[1.0, 5.0]]),
            ..Spec::new("creep", ("of-the-pressure", "of the pressure's effect"), Place::Muscle)
        }
    }
    leads_input!(|self, parameters, run| Giving {
        share: parameters[0] / 3.0,
        lags: [0, 1, 2].map(|lag| Lag::new(parameters[1] * parameters[2].powi(lag), run.period_s)),
    });
}

/// What [`OfInput`] does to the input: three lags beside it, each so many times as long as the one before: one element, or a spectrum.
#[derive(PartialEq)]
struct Giving {
    share: f64,
    lags: [Lag; 3],
}

impl Filter<4> for Giving {
    fn begin(&self, first: f64) -> [f64; 4] {
        [first; 4]
    }
    #[inline(always)]
    fn step(&self, [first, second, third, last]: &mut [f64; 4], value: f64) -> f64 {
        let mut sum = value;
        for (lag, state) in self.lags.iter().zip([first, second, third]) {
            *state = lag.after(*state, *last, value);
            sum += self.share * *state;
        }
        *last = value;
        sum
    }
}

impl Form for Activated {
    fn spec(&self) -> Spec {
        const FLOW: [Parameter; 3] = [
            Parameter { name: "time_constant", quantity: Quantity::Time, low: 0.3, high: 100.0, logarithmic: true },
            Parameter { name: "activation", quantity: Quantity::Ratio, low: 0.02, high: 2.0, logarithmic: true },
            Parameter { name: "total_compliance", quantity: Quantity::Ratio, low: 1e-2, high: 1.0, logarithmic: true },
        ];
        if self.of_input {
            Spec {
                parameters: &FLOW,
                starts: || grid(&[&[2.0, 10.0], &[0.15, 0.5], &[0.05, 0.2]]),
                ..Spec::new("creep", ("of-the-pressure-activated", "of the pressure's effect, thermally activated"), Place::Muscle)
            }
        } else {
            Spec {
                parameters: &[FLOW[0], FLOW[1]],
                weights: 1,
                needs_sum: true,
                starts: || grid(&[&[2.0, 10.0], &[0.15, 0.5]]),
                ..Spec::new("creep", ("of-the-displacement-activated", "of the displacement, thermally activated"), Place::Material)
            }
        }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        if let &[time_s, activation, share] = parameters {
            let mut flowed = flowed_before(run, time_s);
            for value in path {
                flowed = flow(flowed, *value, time_s, activation, run.period_s);
                *value += share * flowed;
            }
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        if let &[time_s, activation] = parameters {
            let mut flowed = sum[0];
            columns.push(false, |sample| {
                flowed = flow(flowed, sum[sample], time_s, activation, run.period_s);
                flowed
            });
        }
    }
}

/// What has flowed when a recording begins: the material knows nothing of recordings, between which the input rests. Closely enough it is what the lag
/// of [`TIMES_S`] with the nearest time constant has left.
fn flowed_before(run: &Run, time_s: f64) -> f64 {
    let distance = |lag_s: &f64| (lag_s / time_s).ln().abs();
    let nearest = (1..TIMES_S.len()).fold(0, |best, at| if distance(&TIMES_S[at]) < distance(&TIMES_S[best]) { at } else { best });
    run.input[0] + left(run, nearest, false)
}

/// One step of [`Activated`], exact for what holds during it: `tanh((x - z) / (2 A))` decays exponentially.
fn flow(flowed: f64, towards: f64, time_s: f64, activation: f64, period_s: f64) -> f64 {
    let left = (0.5 * (towards - flowed) / activation).tanh() * (-period_s / time_s).exp();
    towards - 2.0 * activation * left.atanh()
}

#[cfg(test)]
mod tests {
    use super::{CURVED, HELD, OfInput, OfOutput, TIMES_S};
    use crate::chain::columns::Columns;
    use crate::chain::filters::lag;
    use crate::chain::form::Form;
    use crate::data::session::Session;
    use crate::effects::creep::{gain, left_of_earlier};
    use crate::tests::session_of;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn what_earlier_recordings_left_is_what_one_long_lag_has_left() {
        const PERIOD_S: f64 = 0.02;
        let record = |recording: u32| {
            let time_s: Vec<f64> = (0..900).map(|sample| f64::from(sample) * PERIOD_S).collect();
            let top = 1.0 + 0.3 * f64::from(recording);
            let input: Vec<f64> =
                time_s.iter().map(|time| top * (-0.1 * time).exp() * (1.0 - (1.9 * time + f64::from(recording)).cos())).collect();
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input)
                .expect("a recording")
        };
        let session = Session::new(&(0..5).map(record).collect::<Vec<_>>(), &[]).expect("a session");
        let last = session.runs.last().expect("recordings");
        for time_s in [2.0, 8.0, 32.0] {
            for held in [false, true] {
                // One signal with the rest between recordings in it.
                let mut whole: Vec<f64> = Vec::new();
                for run in &session.runs[..=last.index] {
                    let start = (run.session_s[0] / PERIOD_S).round() as usize;
                    whole.resize(start, if held { *whole.last().unwrap_or(&run.input[0]) } else { run.input[0] });
                    whole.extend(&run.input[..if run.index == last.index { 1 } else { run.input.len() }]);
                }
                lag(&mut whole, time_s, PERIOD_S);
                let exact = whole.last().expect("samples") - last.input[0];
                let left = left_of_earlier(last, time_s, held);
                assert!((left - exact).abs() < 0.02 * exact.abs() + 0.004, "{time_s} s, {held}: {left} instead of {exact}");
            }
        }
        assert_eq!(left_of_earlier(&session.runs[0], 8.0, true), 0.0);
    }

    #[test]
    fn creep_of_the_pressure_is_one_element_or_a_spectrum_of_three() {
        // One span long.
        let slope = 1.0 / (399.0 * 0.02);
        let session = session_of(400, 0.02, |time_s| slope * time_s);
        let run = &session.runs[0];
        for (times, lags_s) in [(1.0, [2.0, 2.0, 2.0]), (3.0, [2.0, 6.0, 18.0])] {
            let mut path = run.input.clone();
            OfInput.input(&[0.3, 2.0, times], run, &mut path);
            for (at, time_s) in run.time_s.iter().enumerate() {
                // The answer of a lag T to a ramp: a (t - T + T exp(-t / T)).
                let lagged = |lag_s: f64| slope * (time_s - lag_s + lag_s * (-time_s / lag_s).exp());
                let exact = run.input[at] + 0.1 * lags_s.map(lagged).iter().sum::<f64>();
                assert!((path[at] - exact).abs() < 1e-9, "{times} at {time_s} s: {} instead of {exact}", path[at]);
            }
        }
    }

    #[test]
    fn what_creeps_by_the_square_of_the_load_gives_four_times_as_much_under_twice_the_load() {
        let crept = |load: f64| {
            let time_s: Vec<f64> = (0..400).map(|sample| f64::from(sample) * 0.02).collect();
            let input: Vec<f64> = time_s.iter().map(|time| if *time < 1.0 { 0.0 } else { load }).collect();
            let recording =
                Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
            let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
            let run = &session.runs[0];
            let sum: Vec<f64> = run.time_s.iter().map(|time| if *time < 1.0 { 0.0 } else { load }).collect();
            let mut columns = Columns::of(sum.len());
            OfOutput(CURVED).output(&[], run, &sum, &mut columns);
            let at_the_end = |column: usize| *columns.column(column).last().expect("samples");
            // In proportion to the load, and to its square, with a time constant of 2 s.
            [at_the_end(2), at_the_end(TIMES_S.len() + 1)]
        };
        let ([once, squared], [twice, fourfold]) = (crept(0.4), crept(0.8));
        let exact = 1.0 - f64::exp(-(8.0 - 1.0) / 2.0);
        assert!((once / (0.4 * exact) - 1.0).abs() < 0.01 && (twice / once - 2.0).abs() < 1e-9, "{once} and {twice}");
        assert!((squared / (0.16 * exact) - 1.0).abs() < 0.01 && (fourfold / squared - 4.0).abs() < 1e-9, "{squared} and {fourfold}");
    }

    #[test]
    fn a_time_is_told_what_gives_by_the_load_and_by_its_square() {
        let session = session_of(400, 0.02, |time_s| time_s);
        let told = |form: &OfOutput, weights: &[f64]| -> Vec<f64> {
            let told = form.tell(&[], weights, &session);
            let at_times = TIMES_S.iter().map(|time_s| told[&format!("compliance_at_{time_s}_s")]);
            at_times.chain([told["total_compliance"]]).collect()
        };
        assert_eq!(told(&OfOutput(0), &[1.0, 2.0, 4.0, 8.0, 16.0]), [1.0, 2.0, 4.0, 8.0, 16.0, 31.0]);
        let squared = [32.0, 64.0, 128.0];
        assert_eq!(told(&OfOutput(CURVED), &[&[1.0, 2.0, 4.0, 8.0, 16.0][..], &squared].concat()), [1.0, 34.0, 68.0, 136.0, 16.0, 255.0]);
    }

    #[test]
    fn what_creeps_by_the_square_is_compared_with_all_that_is_simpler() {
        let simpler: Vec<&str> = OfOutput(CURVED).nested_limits(&[]).iter().map(|(form, _)| form.key()).collect();
        assert_eq!(simpler, ["of-the-displacement", "of-the-displacement-going-on"]);
        let simpler: Vec<&str> = OfOutput(HELD).nested_limits(&[]).iter().map(|(form, _)| form.key()).collect();
        assert_eq!(simpler, ["of-the-displacement"]);
        assert!(OfOutput(0).nested_limits(&[]).is_empty());
    }

    #[test]
    fn the_gain_is_that_of_a_straight_line() {
        let input: Vec<f64> = (0..50).map(|sample| (f64::from(sample) * 0.3).sin()).collect();
        let output: Vec<f64> = input.iter().map(|value| 4.0 - 2.5 * value).collect();
        assert!((gain(&input, &output) + 2.5).abs() < 1e-12);
    }

    #[test]
    fn activated_flow_is_as_its_equation_says() {
        let (towards, time_s, activation, period_s) = (0.8, 4.0, 0.1, 0.02);
        let (mut found, mut state) = (0.0, 0.0_f64);
        for sample in 0..500 {
            found = super::flow(found, towards, time_s, activation, period_s);
            for _ in 0..1000 {
                state += 1e-3 * period_s * activation / time_s * ((towards - state) / activation).sinh();
            }
            assert!((found - state).abs() < 2e-3, "sample {sample}: {found} instead of {state}");
        }
        // Nearly a lag where little is left.
        let near = super::flow(0.0, 1e-3, time_s, activation, period_s);
        assert!((near / 1e-3 - (1.0 - (-period_s / time_s).exp())).abs() < 1e-6, "{near}");
    }
}
