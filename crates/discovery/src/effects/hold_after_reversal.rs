//! `hold-after-reversal`: a regulator passes no flow for a time after a reversal of the command; otherwise `T dv/dt = u - v`, within a limit of
//! the rate. A command that turns again while it holds changes nothing, or begins the time anew. A command that is far enough away ends the hold before
//! its time, or alone, as play in a linkage that snaps over.

use crate::chain::columns::Filter;
use crate::chain::filters::{ladder, lag_coefficients};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::chain::side_by_side::leads_input;
use crate::chain::steps::Steps;
use crate::data::session::{Run, Session};
use crate::effects::slew_limit;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&ONCE, &ANEW, &ONCE_FROM_REST, &ANEW_FROM_REST];

struct Held {
    form: Told,
    /// Whether each reversal begins the time anew.
    anew: bool,
    /// Whether a command that first rises turns: what vented before the recording began fell.
    from_rest: bool,
}

static ONCE: Held = Held { form: ("for-a-time", "holds for a time, then catches up"), anew: false, from_rest: false };

static ANEW: Held =
    Held { form: ("for-a-time-anew", "holds for a time, anew with each reversal, then catches up"), anew: true, from_rest: false };

static ONCE_FROM_REST: Held = Held {
    form: ("for-a-time-from-rest", "holds for a time, when the command first rises too, then catches up"),
    anew: false,
    from_rest: true,
};

static ANEW_FROM_REST: Held = Held {
    form: ("for-a-time-anew-from-rest", "holds for a time, anew with each reversal and when the command first rises, then catches up"),
    anew: true,
    from_rest: true,
};

/// A time constant that is none, s.
const AT_ONCE_S: f64 = 1e-3;

/// A limit of the rate that is none, spans per s.
const ANY_RATE: f64 = 200.0;

/// A hold that only an error ends, s, and an error that ends none, spans.
const FOR_EVER_S: f64 = 5.0;
const ANY_ERROR: f64 = 5.0;

/// Motion back from an extremum that counts as a reversal, spans: more than the rounding of a recorded command.
const BACK: f64 = 1e-3;

impl Form for Held {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "hold", quantity: Quantity::Time, low: 0.02, high: FOR_EVER_S, logarithmic: true },
                Parameter { name: "catch_up_time_constant", quantity: Quantity::Time, low: AT_ONCE_S, high: 2.0, logarithmic: true },
                Parameter { name: "catch_up_rate", quantity: Quantity::InputRate, low: 0.2, high: ANY_RATE, logarithmic: true },
                // A regulator that vents by another valve than it fills by need not hold at both ends.
                Parameter { name: "trough_over_peak", quantity: Quantity::Ratio, low: 0.0, high: 3.0, logarithmic: false },
                Parameter { name: "error_that_ends_it", quantity: Quantity::Input, low: 0.02, high: ANY_ERROR, logarithmic: true },
            ],
            // Without a hold, a pressure that lags within a limit.
            nested_limits: |of| vec![(&slew_limit::Lagging, vec![of[2], of[1], 1.0])],
            simpler_at: &[(0, FOR_EVER_S), (1, AT_ONCE_S), (2, ANY_RATE), (3, 1.0), (3, 0.0), (4, ANY_ERROR)],
            ..Spec::new("hold-after-reversal", self.form, Place::Supply)
        }
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        // Where the command turns again while it holds, another hold is another path: the valleys are narrow.
        let catching_up = [[0.02, ANY_RATE], [0.08, ANY_RATE], [AT_ONCE_S, 3.0], [AT_ONCE_S, 1.0]];
        let of = |[hold, trough, error]: [f64; 3]| catching_up.map(|[time, rate]| vec![hold, time, rate, trough, error]);
        let for_a_time = ladder(0.08, 1.5, 16).into_iter().flat_map(|hold| [[hold, 1.0, ANY_ERROR], [hold, 0.0, ANY_ERROR]]);
        // Without a time of its own, whether it begins anew makes no difference.
        let ways = if self.anew { Vec::new() } else { ladder(0.04, 0.4, 72) };
        let for_a_way = ways.into_iter().map(|error| [FOR_EVER_S, 1.0, error]);
        let steps = Steps::new(session, residual, |run| run.input.clone());
        let change = |parameters: &[f64], run: &Run, path: &mut [f64]| Regulator::new(parameters, self, run).run(path);
        let best = |grid: Vec<[f64; 3]>| steps.best(grid.into_iter().flat_map(of), change);
        [best(for_a_time.collect()), best(for_a_way.collect())].concat()
    }
    leads_input!(|self, parameters, run| Regulator::new(parameters, self, run));
}

/// What [`Held`] does to the input.
#[derive(PartialEq)]
struct Regulator {
    hold_s: f64,
    /// The same at a trough.
    trough_s: f64,
    catch_up_s: f64,
    rate_per_s: f64,
    most_error: f64,
    anew: bool,
    from_rest: bool,
    period_s: f64,
    /// Coefficients of the lag over a whole sample.
    lag: (f64, f64, f64),
}

impl Regulator {
    fn new(parameters: &[f64], form: &Held, run: &Run) -> Self {
        let [hold_s, catch_up_s, rate_per_s] = [if parameters[0] < FOR_EVER_S { parameters[0] } else { 1e9 }, parameters[1], parameters[2]];
        let (trough_s, lag) = (parameters[3] * hold_s, lag_coefficients(catch_up_s, run.period_s));
        let (most_error, period_s) = (parameters[4], run.period_s);
        Self { hold_s, trough_s, catch_up_s, rate_per_s, most_error, anew: form.anew, from_rest: form.from_rest, period_s, lag }
    }
}

impl Filter<8> for Regulator {
    fn begin(&self, first: f64) -> [f64; 8] {
        [first, first, first, if self.from_rest { -1.0 } else { 0.0 }, 0.0, 0.0, 0.0, 0.0]
    }
    #[inline(always)]
    fn step(&self, [state, last, farthest, direction, since_s, left_s, step, early_s]: &mut [f64; 8], value: f64) -> f64 {
        let onward = (value - *farthest) * *direction;
        if onward >= 0.0 {
            if value != *farthest && *direction == 0.0 {
                *direction = (value - *farthest).signum();
            }
            (*step, *farthest, *since_s) = (value - *last, value, 0.0);
        } else {
            if *since_s == 0.0 {
                // The turn lies where a parabola through the samples about the farthest has its top; a command that rested turns as it leaves.
                let back = value - *farthest;
                *early_s = if *step * *direction > 0.0 { -0.5 * self.period_s * (*step + back) / (*step - back) } else { 0.0 };
            }
            *since_s += self.period_s;
            if onward < -BACK {
                // What turns while it holds goes on holding.
                let ago_s = *since_s + *early_s;
                let hold_s = if *direction > 0.0 { self.hold_s } else { self.trough_s };
                let again_s = hold_s - ago_s + self.period_s;
                *left_s = if !self.anew && *left_s - self.period_s + ago_s > 0.0 { *left_s } else { again_s.max(*left_s) };
                (*step, *farthest, *direction, *since_s) = (value - *last, value, -*direction, 0.0);
            }
        }
        let beyond = (value - *state).abs() - self.most_error;
        if *left_s > 0.0 && beyond > 0.0 {
            *left_s = left_s.min(self.period_s * (1.0 - beyond / (value - *last).abs().max(beyond)));
        }
        let open_s = self.period_s - left_s.clamp(0.0, self.period_s);
        *left_s -= self.period_s;
        if open_s > 0.0 {
            let (keep, now, then) = if open_s < self.period_s { lag_coefficients(self.catch_up_s, open_s) } else { self.lag };
            let caught_up = keep * *state + now * value + then * (value - (value - *last) * open_s / self.period_s);
            let most = self.rate_per_s * open_s;
            *state = caught_up.clamp(*state - most, *state + most);
        }
        *last = value;
        *state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::session::Session;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn it_holds_at_a_peak_and_catches_up_exponentially() {
        // A triangle of 4 s, turning on samples: u = 1 - (t - 2) / 2 behind its peak.
        let (hold_s, catch_up_s, period_s) = (0.53, 0.1, 0.02);
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * period_s).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 1.0 - (1.0 - (time / 2.0) % 2.0).abs()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s.clone(), input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let mut path = run.input.clone();
        ONCE.input(&[hold_s, catch_up_s, ANY_RATE, 1.0, ANY_ERROR], run, &mut path);
        // T v' = u - v: on a ramp of slope a it follows a T behind, and from any other place exponentially.
        let slope = 0.5;
        let top = 1.0 - slope * catch_up_s;
        for (time, value) in time_s.iter().zip(&path).take(200) {
            let exact = if *time <= 2.0 {
                slope * (time - catch_up_s * (1.0 - (-time / catch_up_s).exp()))
            } else if *time <= 2.0 + hold_s {
                top
            } else {
                let open_s = time - 2.0 - hold_s;
                let behind = 1.0 - slope * (hold_s - catch_up_s);
                behind - slope * open_s + (top - behind) * (-open_s / catch_up_s).exp()
            };
            assert!((value - exact).abs() < 1e-6, "at {time} s: {value} instead of {exact}");
        }
        // The next reversal, at the bottom, holds again.
        assert!(path[201..226].windows(2).all(|pair| (pair[1] - pair[0]).abs() < 1e-9), "{:?}", &path[200..230]);
    }

    #[test]
    fn without_a_hold_it_is_the_slew_limit_that_it_is_compared_with() {
        let session = crate::tests::session_of(600, 0.02, |time_s| 0.5 - 0.5 * (4.0 * time_s).cos());
        let run = &session.runs[0];
        // The fastest stroke is at two spans a second.
        let held = [0.0, 0.03, 1.2, 1.0, ANY_ERROR];
        let through = |form: &dyn Form, parameters: &[f64]| {
            let mut path = run.input.clone();
            form.input(parameters, run, &mut path);
            path
        };
        let apart = |one: &[f64], other: &[f64]| one.iter().zip(other).map(|(one, other)| (one - other).abs()).fold(0.0, f64::max);
        let limits = ONCE.nested_limits(&held);
        let (limit, at) = &limits[0];
        assert_eq!((limits.len(), limit.name()), (1, "slew-limit"));
        let (with, without) = (through(&ONCE, &held), through(*limit, at));
        assert!(apart(&with, &without) < 5e-3 && apart(&without, &run.input) > 0.1, "{}", apart(&with, &without));
    }

    #[test]
    fn each_form_is_what_small_steps_make_of_its_law() {
        let period_s = 0.02;
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * period_s).collect();
        // Triangles that turn on samples, every second one before the last hold is over.
        let lengths: [f64; 8] = [0.9, 1.0, 0.2, 1.1, 0.16, 0.8, 1.2, 0.24];
        let mut input = vec![0.0; 20];
        while input.len() < time_s.len() {
            for (length, slope) in lengths.iter().zip([0.7, -0.5].into_iter().cycle()) {
                let from = input[input.len() - 1];
                let samples = (length / period_s).round() as u32;
                input.extend((1..=samples).map(|sample| from + slope * period_s * f64::from(sample)));
            }
        }
        input.truncate(time_s.len());
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let ends = [[0.3, ANY_ERROR], [0.3, 0.12], [FOR_EVER_S, 0.12]];
        let forms = [&ONCE, &ANEW, &ONCE_FROM_REST, &ANEW_FROM_REST];
        for (form, [hold_s, most_error]) in forms.into_iter().flat_map(|form| ends.map(|end| (form, end))) {
            let [catch_up_s, rate_per_s, trough] = [0.02, 1.5, 0.4];
            let mut path = run.input.clone();
            form.input(&[hold_s, catch_up_s, rate_per_s, trough, most_error], run, &mut path);
            let (mut state, mut rises, mut left_s) = (run.input[0], if form.from_rest { Some(false) } else { None }, 0.0_f64);
            let (mut worst, steps) = (0.0_f64, 400);
            for (sample, found) in path.iter().enumerate().skip(1) {
                let (before, after) = (run.input[sample - 1], run.input[sample]);
                if after != before && rises != Some(after > before) {
                    let of_turn = if after > before { trough * hold_s } else { hold_s };
                    if rises.is_some() && (form.anew || left_s <= 0.0) {
                        left_s = left_s.max(of_turn);
                    }
                    rises = Some(after > before);
                }
                for step in 1..=steps {
                    let value = before + (after - before) * f64::from(step) / f64::from(steps);
                    let step_s = period_s / f64::from(steps);
                    left_s = if (value - state).abs() > most_error { 0.0 } else { left_s - step_s };
                    if left_s <= 0.0 {
                        state += step_s * ((value - state) / catch_up_s).clamp(-rate_per_s, rate_per_s);
                    }
                }
                worst = worst.max((found - state).abs());
            }
            // Where the limit of the rate ends inside a sample, a sample is off by a part of it.
            assert!(worst < 0.01, "{}: {worst}", form.form.0);
        }
    }

    #[test]
    fn a_hold_and_where_it_holds_come_first_among_the_starts() {
        let input: Vec<f64> = (0..1000).map(|sample| 0.5 - 0.5 * (f64::from(sample) * 0.02 * 2.0).cos()).collect();
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let starts = |parameters: [f64; 5]| {
            let missed = |run: &Run| {
                let mut path = run.input.clone();
                ONCE.input(&parameters, run, &mut path);
                path.iter().zip(&run.input).map(|(held, command)| held - command).collect()
            };
            let residual: Vec<Vec<f64>> = session.runs.iter().map(missed).collect();
            ONCE.starts(&session, &residual)
        };
        for (hold_s, trough) in [(0.2, 1.0), (0.2, 0.0), (0.6, 1.0), (0.6, 0.0)] {
            let starts = starts([hold_s, 0.02, ANY_RATE, trough, ANY_ERROR]);
            // A tenth is half a step of the ladder.
            assert!((starts[0][0] / hold_s).ln().abs() < 0.11 && starts[0][3] == trough, "{hold_s} s, {trough}: {starts:?}");
        }
        for error in [0.1, 0.25] {
            let starts = starts([FOR_EVER_S, 0.02, ANY_RATE, 1.0, error]);
            let first = starts.iter().find(|start| start[4] < ANY_ERROR).expect("one of them");
            assert!((first[4] / error).ln().abs() < 0.017, "{error}: {first:?}");
        }
    }

    #[test]
    fn a_command_that_does_not_turn_is_only_followed() {
        let input: Vec<f64> = (0..1000).map(|sample| f64::from(sample / 50) * 0.05).collect();
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let (mut path, mut lagging) = (run.input.clone(), run.input.clone());
        ONCE.input(&[1.0, 0.1, ANY_RATE, 1.0, ANY_ERROR], run, &mut path);
        crate::chain::filters::lag(&mut lagging, 0.1, run.period_s);
        assert!(path.iter().zip(&lagging).all(|(x, y)| (x - y).abs() < 1e-12));
    }
}
