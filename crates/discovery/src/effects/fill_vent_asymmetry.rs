//! `fill-vent-asymmetry`: filling and venting have their own time constants: by which of command and pressure is higher, by which way the
//! command goes, with a flow that fades as what drives it does, or with one that grows with a power of the difference of pressures.

use crate::chain::columns::Filter;
use crate::chain::filters::{grid, ladder, lag_coefficients};
use crate::chain::form::{Form, Limits, Parameter, Place, Quantity, Spec, Told};
use crate::chain::side_by_side;
use crate::data::session::{Run, Session};
use crate::effects::pneumatic_lag::{self, POWER, through_orifice_s};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&TWO_LAGS, &TWO_LAGS_HELD, &COMMANDED, &COMMANDED_HELD, &DRIVEN, &DRIVEN_HELD, &ORIFICE];

/// What decides which time constant it is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Law {
    /// Which of command and pressure is higher.
    Error,
    /// Which way the command goes.
    Command,
    /// As [`Self::Error`], and flow fades with the pressure that drives it.
    Drive,
    /// As [`Self::Error`], and the flow grows with a power of the difference of pressures: one is laminar, a half turbulent.
    Orifice,
}

/// A lag with two time constants.
struct TwoLags {
    form: Told,
    law: Law,
    /// Whether the command holds from one sample to the next, as behind a converter, instead of going straight.
    held: bool,
}

const fn lags(form: Told, law: Law, held: bool) -> TwoLags {
    TwoLags { form, law, held }
}

static TWO_LAGS: TwoLags = lags(("by-error", "two time constants"), Law::Error, false);

static TWO_LAGS_HELD: TwoLags = lags(("by-error-held", "two time constants, of a command that holds between samples"), Law::Error, true);
static COMMANDED: TwoLags = lags(("by-command", "two time constants, by which way the command goes"), Law::Command, false);

static COMMANDED_HELD: TwoLags =
    lags(("by-command-held", "two time constants, by which way a command goes that holds between samples"), Law::Command, true);
static DRIVEN: TwoLags =
    lags(("fading", "two time constants, filling slower near the supply's pressure and venting slower near the room's"), Law::Drive, false);

static DRIVEN_HELD: TwoLags = lags(
    (
        "fading-held",
        "two time constants, filling slower near the supply's pressure and venting slower near the room's, of a command that holds between \
         samples",
    ),
    Law::Drive,
    true,
);

static ORIFICE: TwoLags = lags(("orifices", "two orifices, flow with a power of the difference"), Law::Orifice, false);

const FILL: Parameter = Parameter { name: "fill_time_constant", quantity: Quantity::Time, low: 2e-3, high: 2.0, logarithmic: true };

const VENT: Parameter = Parameter { name: "vent_time_constant", ..FILL };

const FADING: Parameter = Parameter { name: "fading", quantity: Quantity::Ratio, low: 0.0, high: 0.95, logarithmic: false };

/// A valve that is never open in full.
const NEVER_FULL: f64 = 10.0;

const FULL: Parameter =
    Parameter { name: "error_that_opens_in_full", quantity: Quantity::Input, low: 0.02, high: NEVER_FULL, logarithmic: true };

/// Logarithm of the ratio of time constants up to which they are tried as one.
const ALIKE: f64 = 0.4;

impl Form for TwoLags {
    fn spec(&self) -> Spec {
        let parameters: &'static [Parameter] = match self.law {
            Law::Error | Law::Command => &[FILL, VENT],
            Law::Drive => &[FILL, VENT, FADING, FULL],
            Law::Orifice => &[FILL, VENT, POWER],
        };
        Spec {
            parameters,
            simpler_at: if self.law == Law::Drive { &[(3, NEVER_FULL)] } else { &[] },
            // With like time constants a held command is a lag and half a sample of delay: it must not pass for a lag.
            cost: Some(parameters.len() + usize::from(self.held)),
            ..Spec::new("fill-vent-asymmetry", self.form, Place::Flow)
        }
    }
    fn nested_limits(&self, parameters: &[f64]) -> Limits {
        let [fill_s, vent_s] = [parameters[0], parameters[1]];
        let lag: &'static dyn Form =
            if self.law == Law::Orifice { &pneumatic_lag::ORIFICE } else { pneumatic_lag::FORMS[usize::from(self.held)] };
        let rest = if self.law == Law::Orifice { &parameters[2..] } else { &[] };
        if (fill_s / vent_s).ln().abs() < ALIKE { vec![(lag, [&[(fill_s * vent_s).sqrt()], rest].concat())] } else { Vec::new() }
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let times = ladder(0.03, 0.5, 4);
        let third = if self.law == Law::Orifice { 0.75 } else { 0.5 };
        let of = |pair: &Vec<f64>| [pair[0], pair[1], third, NEVER_FULL][..self.spec().parameters.len()].to_vec();
        // Open in full at a small error, it follows a small one soon.
        let soon = |pair: &Vec<f64>| vec![0.1 * pair[0], 0.1 * pair[1], 0.9, 0.1];
        let pairs: Vec<Vec<f64>> = grid(&[&times, &times]).into_iter().filter(|pair| pair[0] != pair[1]).collect();
        let opened = pairs.iter().filter(|_| self.law == Law::Drive).map(soon);
        pairs.iter().map(of).chain(opened).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        match self.law {
            Law::Error => Following::<ERROR>::new(parameters, run, self.held).run(path),
            Law::Command => Following::<COMMAND>::new(parameters, run, self.held).run(path),
            Law::Drive => Following::<DRIVE>::new(parameters, run, self.held).run(path),
            Law::Orifice => Following::<POWER_LAW>::new(parameters, run, self.held).run(path),
        }
    }
    fn inputs(&self, parameters: &[f64], runs: &[&Run], paths: &mut [Vec<f64>]) {
        match self.law {
            Law::Error => side_by_side::filter(runs, paths, |run| Following::<ERROR>::new(parameters, run, self.held)),
            // So little to do that bringing them side by side takes longer.
            Law::Command => runs.iter().zip(paths).for_each(|(run, path)| self.input(parameters, run, path)),
            Law::Drive => side_by_side::filter(runs, paths, |run| Following::<DRIVE>::new(parameters, run, self.held)),
            Law::Orifice => side_by_side::filter(runs, paths, |run| Following::<POWER_LAW>::new(parameters, run, self.held)),
        }
    }
}

/// [`Law`] as the compiler knows it: a choice that never changes inside a loop is made before it.
const ERROR: usize = 0;

const COMMAND: usize = 1;

const DRIVE: usize = 2;

const POWER_LAW: usize = 3;

/// What [`TwoLags`] does to the input by one law.
#[derive(PartialEq)]
struct Following<const LAW: usize> {
    times_s: [f64; 2],
    /// Fading or power of the flow, where the law has one.
    third: f64,
    /// The error at which the valve is open in full.
    full: f64,
    /// Coefficients of the two lags.
    lags: [(f64, f64, f64); 2],
    period_s: f64,
    held: bool,
}

impl<const LAW: usize> Following<LAW> {
    fn new(parameters: &[f64], run: &Run, held: bool) -> Self {
        let times_s = [parameters[0], parameters[1]];
        let lags = times_s.map(|time_s| lag_coefficients(time_s, run.period_s));
        let [third, full] = [(2, 0.0), (3, NEVER_FULL)].map(|(at, none)| parameters.get(at).copied().unwrap_or(none));
        Self { times_s, third, full, lags, period_s: run.period_s, held }
    }
}

impl<const LAW: usize> Filter<3> for Following<LAW> {
    fn begin(&self, first: f64) -> [f64; 3] {
        // The last one is positive when the command rose last.
        [first, first, 1.0]
    }
    #[inline(always)]
    fn step(&self, [state, last, rose]: &mut [f64; 3], value: f64) -> f64 {
        let target = if self.held { *last } else { 0.5 * (value + *last) };
        let fills = if LAW == COMMAND {
            let now = if value == *last { *rose } else { value - *last };
            // Until a held command makes its step, the one before counts.
            let counts = if self.held { *rose } else { now };
            *rose = now;
            counts > 0.0
        } else {
            target > *state
        };
        let time_s = if fills { self.times_s[0] } else { self.times_s[1] };
        let (keep, now, before) = match LAW {
            DRIVE => {
                let level = state.clamp(0.0, 1.0);
                let drive = if fills { 1.0 - level } else { level };
                let shut = ((target - *state).abs() / self.full).max(1.0);
                // With all of the drive the time constant is its own, with none of it the flow is less by the fading.
                lag_coefficients(time_s * shut / (1.0 - self.third * (1.0 - drive)), self.period_s)
            }
            POWER_LAW => lag_coefficients(through_orifice_s(time_s, target - *state, self.third), self.period_s),
            _ => {
                let [fill, vent] = self.lags;
                let of = |fill: f64, vent: f64| if fills { fill } else { vent };
                (of(fill.0, vent.0), of(fill.1, vent.1), of(fill.2, vent.2))
            }
        };
        let (now, before) = if self.held { (0.0, now + before) } else { (now, before) };
        *state = keep * *state + now * value + before * *last;
        *last = value;
        *state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn the_laws_agree_on_a_step_where_they_must_and_the_driven_flow_fades() {
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = (0..1000).map(|sample| if (100..550).contains(&sample) { 1.0 } else { 0.0 }).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let through = |form: &dyn Form, parameters: &[f64]| {
            let mut path = run.input.clone();
            form.input(parameters, run, &mut path);
            path
        };
        let two_lags = through(&TWO_LAGS, &[0.3, 0.8]);
        let laminar = through(&ORIFICE, &[0.3, 0.8, 1.0]);
        for (other, name) in [
            (through(&COMMANDED, &[0.3, 0.8]), "commanded"),
            (through(&DRIVEN, &[0.3, 0.8, 0.0, NEVER_FULL]), "driven"),
            (laminar, "orifice"),
        ] {
            for (sample, (x, y)) in two_lags.iter().zip(&other).enumerate() {
                assert!((x - y).abs() < 1e-12, "{name}, sample {sample}: {x} and {y}");
            }
        }
        // v' = sqrt(0.1 (1 - v)) / T fills in the time 2 T / sqrt(0.1); half of it leaves a quarter of the step.
        let turbulent = through(&ORIFICE, &[0.3, 0.8, 0.5]);
        let half_s = 0.3 / 0.1_f64.sqrt();
        let at = 100 + (half_s / 0.02) as usize;
        assert!((turbulent[at] - 0.75).abs() < 0.02, "{}", turbulent[at]);
        // Filling begins as fast and ends slower; venting near the top is as fast, near the room's pressure slower.
        let driven = through(&DRIVEN, &[0.3, 0.8, 0.6, NEVER_FULL]);
        assert!((driven[101] - two_lags[101]).abs() < 0.01 && driven[130] < two_lags[130] - 0.05, "{} {}", driven[130], two_lags[130]);
        assert!((driven[551] - two_lags[551]).abs() < 0.01 && driven[640] > two_lags[640] + 0.05, "{} {}", driven[640], two_lags[640]);
        // Open in full it fills at 0.2 / 0.3 spans per s.
        let full = through(&DRIVEN, &[0.3, 0.8, 0.0, 0.2]);
        assert!((full[110] - full[109] - 0.02 * 0.2 / 0.3).abs() < 2e-3, "{}", full[110] - full[109]);
    }

    #[test]
    fn a_command_that_holds_between_samples_is_followed_as_in_small_steps() {
        let time_s: Vec<f64> = (0..500).map(|sample| f64::from(sample) * 0.02).collect();
        // Ragged on its way up and down, as a command with noise is.
        let input: Vec<f64> =
            (0_u32..500).map(|sample| 0.5 - 0.4 * (f64::from(sample) * 0.05).cos() + 0.02 * f64::from(sample * 7 % 5)).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        for form in [&TWO_LAGS_HELD, &COMMANDED_HELD] {
            let mut path = run.input.clone();
            form.input(&[0.1, 0.3], run, &mut path);
            let (mut state, mut fills) = (run.input[0], true);
            for (sample, &found) in path.iter().enumerate().skip(1) {
                let held = run.input[sample - 1];
                if sample > 1 && held != run.input[sample - 2] {
                    fills = held > run.input[sample - 2];
                }
                for _ in 0..2000 {
                    let fast = if form.law == Law::Command { fills } else { held > state };
                    state += 1e-5 * (held - state) / if fast { 0.1 } else { 0.3 };
                }
                assert!((found - state).abs() < 1e-4, "{}, sample {sample}: {found} and {state}", form.form.1);
            }
        }
    }

    #[test]
    fn like_time_constants_come_near_a_lag_and_unlike_ones_do_not() {
        for form in [&TWO_LAGS, &TWO_LAGS_HELD, &ORIFICE] {
            let near = form.nested_limits(&[0.05, 0.06, 1.0]);
            let [(lag, parameters)] = &near[..] else { panic!("{}", form.form.1) };
            assert_eq!(lag.name(), "pneumatic-lag");
            assert!((parameters[0] - 0.003_f64.sqrt()).abs() < 1e-12, "{parameters:?}");
            assert!(form.nested_limits(&[0.05, 0.1, 1.0]).is_empty(), "{}", form.form.1);
        }
    }
}
