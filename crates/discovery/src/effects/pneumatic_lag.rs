//! `pneumatic-lag`: a volume fills through a restriction, `T dv/dt = u - v`; before the hysteresis or behind it, two in a row or beside each other, behind a
//! converter that holds the command between samples, through a tube in which the denser air flows more easily, or through an orifice.
//!
//! The time constant is the mean lag at half the span in every form, by which a slow ramp is late there, and that at a tenth of the span of an
//! orifice: forms of one rig can be compared.

use crate::chain::columns::{Columns, Filter};
use crate::chain::elementary;
use crate::chain::filters::{Lag, grid, ladder, lag, lag_coefficients, lag_of_held};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::chain::side_by_side::leads_input;
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&BEFORE, &HELD, &BEHIND, &TWO_POLES, &TWO_POLES_BEHIND, &Beside, &Changing, &ORIFICE];

/// One lag, or two in a row.
struct Restriction {
    form: Told,
    place: Place,
    parameters: &'static [Parameter],
    /// Whether the command holds from one sample to the next, as behind a converter, instead of going straight.
    held: bool,
}

const TIME: Parameter = Parameter { name: "time_constant", quantity: Quantity::Time, low: 2e-3, high: 2.0, logarithmic: true };

/// A spool before the volume, or a volume behind a volume: share of their lag that is the faster one's.
const FASTER: Parameter = Parameter { name: "faster_share", quantity: Quantity::Ratio, low: 5e-3, high: 0.5, logarithmic: true };

const fn lags(form: Told, place: Place, parameters: &'static [Parameter], held: bool) -> Restriction {
    Restriction { form, place, parameters, held }
}

static BEFORE: Restriction = lags(("before", "before the hysteresis"), Place::Flow, &[TIME], false);

/// Shorter lags of a held command are hardly more than half a sample of delay: they must not pass for a dead time.
static HELD: Restriction = Restriction {
    form: ("before-held", "before the hysteresis, of a command that holds between samples"),
    place: Place::Flow,
    parameters: &[Parameter { low: 0.015, ..TIME }],
    held: true,
};

static BEHIND: Restriction = lags(("behind", "behind the hysteresis"), Place::Tip, &[TIME], false);

static TWO_POLES: Restriction = lags(("two-before", "two in a row before the hysteresis"), Place::Flow, &[TIME, FASTER], false);
static TWO_POLES_BEHIND: Restriction = lags(("two-behind", "two in a row behind the hysteresis"), Place::Tip, &[TIME, FASTER], false);

impl Restriction {
    /// Time constants of its lags, s.
    fn times_s(parameters: &[f64]) -> impl Iterator<Item = f64> {
        let faster = parameters.get(1).map_or(0.0, |share| share * parameters[0]);
        [parameters[0] - faster, faster].into_iter().take(parameters.len())
    }
}

impl Form for Restriction {
    fn spec(&self) -> Spec {
        Spec {
            parameters: self.parameters,
            // That a converter holds the command is an assumption of its own: a short lag behind one is nearly a dead time.
            cost: Some(self.parameters.len() + usize::from(self.held)),
            ..Spec::new("pneumatic-lag", self.form, self.place)
        }
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let two = || grid(&[&ladder(0.03, 0.7, 5), &[0.05, 0.23]]);
        if self.parameters.len() == 1 { grid(&[&ladder(0.02, 1.0, 7)]) } else { two() }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        if self.place > Place::Operators {
            return;
        }
        if self.held {
            lag_of_held(path, parameters[0], run.period_s);
        } else {
            Self::times_s(parameters).for_each(|time_s| lag(path, time_s, run.period_s));
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        if self.place > Place::Operators {
            Self::times_s(parameters).for_each(|time_s| columns.filter(&Lag::new(time_s, run.period_s)));
        }
    }
}

/// Air that is compressed at once and warm, and what its heat holds back; or a short way and a long one.
struct Beside;

impl Form for Beside {
    fn spec(&self) -> Spec {
        const RATIO: Parameter = Parameter { name: "faster_ratio", high: 1.0, ..FASTER };
        const SHARE: Parameter = Parameter { name: "faster_part", low: 0.05, high: 0.95, logarithmic: false, ..FASTER };
        Spec {
            parameters: &[TIME, RATIO, SHARE],
            starts: || ladder(0.06, 0.6, 4).into_iter().map(|mean| vec![mean, 0.15, 0.5]).collect(),
            ..Spec::new("pneumatic-lag", ("two-beside", "two beside each other before the hysteresis"), Place::Flow)
        }
    }
    leads_input!(|self, parameters, run| {
        let [mean_s, ratio, share] = [parameters[0], parameters[1], parameters[2]];
        let slow_s = mean_s / (1.0 - share + share * ratio);
        Both { lags: [slow_s, ratio * slow_s].map(|time_s| Lag::new(time_s, run.period_s)), share }
    });
}

/// What [`Beside`] does to the input.
#[derive(PartialEq)]
struct Both {
    lags: [Lag; 2],
    share: f64,
}

impl Filter<3> for Both {
    fn begin(&self, first: f64) -> [f64; 3] {
        [first; 3]
    }
    #[inline(always)]
    fn step(&self, [slow, fast, last]: &mut [f64; 3], value: f64) -> f64 {
        (*slow, *fast) = (self.lags[0].after(*slow, *last, value), self.lags[1].after(*fast, *last, value));
        *last = value;
        (1.0 - self.share) * *slow + self.share * *fast
    }
}

/// A lag whose time constant changes with the pressure: `T k(v) / k(1/2) dv/dt = u - v`. Laminar flow of a compressible gas goes with the difference of
/// the squares of the pressures, `(u - v)(u + v + 2 P)` with the room's pressure `P`, so that a tube under pressure is a faster one:
/// `k = 1 / (1 + c (u + v) / 2)`, and `c` is `1 / P`. A muscle that grows as it fills takes the longer to fill, the fuller it is: `k = 1 - c v`, `c < 0`.
struct Changing;

impl Form for Changing {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[TIME, Parameter { name: "faster", quantity: Quantity::PerInput, low: -5.0, high: 10.0, logarithmic: false }],
            steps: &[0.15, 0.2],
            simpler_at: &[(1, 0.0)],
            starts: || grid(&[&ladder(0.03, 0.8, 5), &[-0.5, 2.0]]),
            ..Spec::new("pneumatic-lag", ("faster-under-pressure", "before the hysteresis, faster under pressure"), Place::Flow)
        }
    }
    leads_input!(|self, parameters, run| {
        let faster = parameters[1];
        let at_half = if faster > 0.0 { 1.0 + 0.5 * faster } else { 1.0 / (1.0 - 0.5 * faster) };
        Condensing { time_s: parameters[0] * at_half, faster, step_s: run.period_s / LOOKS as f64 }
    });
}

/// What [`Changing`] does to the input.
#[derive(PartialEq)]
struct Condensing {
    time_s: f64,
    faster: f64,
    step_s: f64,
}

impl Filter<2> for Condensing {
    fn begin(&self, first: f64) -> [f64; 2] {
        [first; 2]
    }
    #[inline(always)]
    fn step(&self, [state, last]: &mut [f64; 2], value: f64) -> f64 {
        follow([state, last], value, self.step_s, |between, state| {
            let slows = 1.0 - self.faster * state;
            self.time_s * if self.faster > 0.0 { 1.0 / (1.0 + 0.5 * self.faster * (between + state)).max(0.1) } else { slows.max(0.1) }
        })
    }
}

/// An orifice: the flow grows with a power of the difference of pressures.
pub struct Orifice;

/// It as a form.
pub static ORIFICE: Orifice = Orifice;

/// One is laminar flow, a half turbulent.
pub const POWER: Parameter = Parameter { name: "flow_power", quantity: Quantity::Ratio, low: 0.4, high: 1.2, logarithmic: false };

/// Difference, in spans, at which the power law has the time constant of its parameter.
const TOLD_AT: f64 = 0.1;

/// Smallest difference that the power law is followed to.
const LAMINAR: f64 = 1e-3;

impl Form for Orifice {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[TIME, POWER],
            starts: || grid(&[&ladder(0.03, 0.6, 5), &[0.75]]),
            simpler_at: &[(1, 1.0)],
            ..Spec::new("pneumatic-lag", ("orifice", "an orifice before the hysteresis, flow with a power of the difference"), Place::Flow)
        }
    }
    leads_input!(|self, parameters, run| Flow { time_s: parameters[0], power: parameters[1], step_s: run.period_s / LOOKS as f64 });
}

/// What [`Orifice`] does to the input.
#[derive(PartialEq)]
struct Flow {
    time_s: f64,
    power: f64,
    step_s: f64,
}

impl Filter<2> for Flow {
    fn begin(&self, first: f64) -> [f64; 2] {
        [first; 2]
    }
    #[inline(always)]
    fn step(&self, [state, last]: &mut [f64; 2], value: f64) -> f64 {
        follow([state, last], value, self.step_s, |between, state| through_orifice_s(self.time_s, between - state, self.power))
    }
}

/// Time constant of a flow that grows with a power of the difference of pressures, s, where the difference is this one.
#[inline(always)]
pub fn through_orifice_s(time_s: f64, difference: f64, power: f64) -> f64 {
    time_s * elementary::power(difference.abs().max(LAMINAR) / TOLD_AT, 1.0 - power)
}

/// Leads a state one sample on, in steps of `step_s` over which the time constant that `time_s` has for the mean input and the state stands still.
#[inline(always)]
fn follow([state, last]: [&mut f64; 2], value: f64, step_s: f64, time_s: impl Fn(f64, f64) -> f64) -> f64 {
    let slope = (value - *last) / LOOKS as f64;
    for _ in 0..LOOKS {
        let now = *last + slope;
        let (keep, of_now, of_last) = lag_coefficients(time_s(0.5 * (*last + now), *state), step_s);
        *state = keep * *state + of_now * now + of_last * *last;
        *last = now;
    }
    *state
}

/// Steps inside a sample, over which the time constant stands still.
const LOOKS: usize = 2;

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Recording, Signal};
    use std::path::Path;

    fn run(input: Vec<f64>) -> Run {
        let time_s: Vec<f64> = (0..input.len()).map(|sample| sample as f64 * 0.02).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        Session::new(&[recording.expect("a recording")], &[]).expect("a session").runs[0].clone()
    }

    #[test]
    fn the_lag_of_a_held_command_begins_a_sample_after_its_step() {
        let run = run((0..1000).map(|sample| if sample < 500 { 0.0 } else { 1.0 }).collect());
        let mut path = run.input.clone();
        HELD.input(&[0.1], &run, &mut path);
        assert_eq!(path[500], 0.0);
        for sample in 501..520_u32 {
            let exact = 1.0 - (-f64::from(sample - 500) * 0.02 / 0.1).exp();
            assert!((path[sample as usize] - exact).abs() < 1e-12, "sample {sample}");
        }
    }

    #[test]
    fn every_form_follows_a_slow_ramp_by_its_time_constant_later_at_half_the_span() {
        const TIME_S: f64 = 0.3;
        let run = run((0..20_001).map(|sample| f64::from(sample) / 20_000.0).collect());
        let slope_per_s = 1.0 / 400.0;
        let linear: [(&dyn Form, &[f64]); 6] = [
            (&BEFORE, &[TIME_S]),
            (&TWO_POLES, &[TIME_S, 0.2]),
            (&Beside, &[TIME_S, 0.15, 0.4]),
            (&Changing, &[TIME_S, 3.0]),
            (&Changing, &[TIME_S, -2.0]),
            (&ORIFICE, &[TIME_S, 1.0]),
        ];
        for (form, parameters) in linear {
            let mut path = run.input.clone();
            form.input(parameters, &run, &mut path);
            let late_s = (run.input[10_000] - path[10_000]) / slope_per_s;
            assert!((late_s / TIME_S - 1.0).abs() < 5e-3, "{}: {late_s} s", form.form());
        }
    }

    #[test]
    fn a_muscle_that_grows_slows_its_own_filling() {
        let (time_s, slower) = (0.15, 0.8);
        let run = run((0..1000).map(|sample| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * 0.8 * f64::from(sample) * 0.02).cos()).collect());
        let mut path = run.input.clone();
        Changing.input(&[time_s * (1.0 + 0.5 * slower), -slower], &run, &mut path);
        let mut state = run.input[0];
        for (sample, value) in path.iter().enumerate().skip(1) {
            for look in 0..2000 {
                let share = (f64::from(look) + 0.5) / 2000.0;
                let u = run.input[sample - 1] + share * (run.input[sample] - run.input[sample - 1]);
                state += 1e-5 * (u - state) / (time_s * (1.0 + slower * state));
            }
            assert!((value - state).abs() < 2e-3, "sample {sample}: {value} and {state}");
        }
    }

    #[test]
    fn an_orifice_fills_as_small_steps_of_its_law_do() {
        let (time_s, power) = (0.15, 0.6);
        let run = run((0..1000).map(|sample| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * 0.8 * f64::from(sample) * 0.02).cos()).collect());
        let mut path = run.input.clone();
        ORIFICE.input(&[time_s, power], &run, &mut path);
        let mut state = run.input[0];
        for (sample, value) in path.iter().enumerate().skip(1) {
            for look in 0..2000 {
                let share = (f64::from(look) + 0.5) / 2000.0;
                let missing = run.input[sample - 1] + share * (run.input[sample] - run.input[sample - 1]) - state;
                state += 1e-5 / time_s * 0.1 * missing.signum() * (missing.abs() / 0.1).powf(power);
            }
            assert!((value - state).abs() < 5e-3, "sample {sample}: {value} and {state}");
        }
    }

    #[test]
    fn a_dense_tube_follows_the_difference_of_squares() {
        let (time_s, faster) = (0.2, 3.0);
        let run = run((0..1000).map(|sample| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * 0.8 * f64::from(sample) * 0.02).cos()).collect());
        let mut path = run.input.clone();
        Changing.input(&[time_s / (1.0 + 0.5 * faster), faster], &run, &mut path);
        // T v' = c / 2 ((u + 1/c)^2 - (v + 1/c)^2), in small steps of Euler's.
        let mut state = run.input[0];
        for (sample, value) in path.iter().enumerate().skip(1) {
            for look in 0..2000 {
                let share = (f64::from(look) + 0.5) / 2000.0;
                let u = run.input[sample - 1] + share * (run.input[sample] - run.input[sample - 1]);
                state += 1e-5 / time_s * 0.5 * faster * ((u + 1.0 / faster).powi(2) - (state + 1.0 / faster).powi(2));
            }
            assert!((value - state).abs() < 2e-3, "sample {sample}: {value} and {state}");
        }
    }
}
