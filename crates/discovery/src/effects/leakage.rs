//! `leakage`: what is held trickles away: strokes pass, the level decays, `dv/dt = du/dt - v / T`, never below zero, or either way; or, with a regulator
//! that slowly fills up again, decays towards a share of the command, `dv/dt = du/dt - (v - k u) / T`, and perhaps leaks
//! above a pressure only, at which a lip lifts, `P`: then `v` in the leak is `max(v - P, 0)`; or through a hole in which the flow
//! is turbulent, `dv/dt = du/dt - v^n / T`: `n` is one for laminar flow and one half for a wide hole. Where the valve goes on filling through
//! a restriction, `T dv/dt = u - v - L sqrt(v)`; a laminar leak there is nothing but a shorter lag and a smaller gain.

use crate::chain::columns::Filter;
use crate::chain::elementary;
use crate::chain::filters::{grid, ladder, lag_coefficients};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::chain::side_by_side::leads_input;
use crate::data::session::{Run, Session};
use crate::effects::pneumatic_lag;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&HOLE, &REFILLED, &Turbulent, &Filling, &EITHER_WAY];

struct Hole {
    form: Told,
    /// The time constant, and the share of the command that a regulator keeps, where there is one.
    parameters: &'static [Parameter],
    /// Whether the pressure may fall below that of the room, as far as the input tells it.
    below_zero: bool,
}

struct Turbulent;

struct Filling;

static HOLE: Hole = Hole { form: ("linear", "held pressure decays"), parameters: &[TIME], below_zero: false };

/// Where zero of the input is not the room's pressure: air comes back through the hole when a stroke ends below where the leak has led.
static EITHER_WAY: Hole = Hole { form: ("linear-both-ways", "held pressure decays, and comes back from below"), below_zero: true, ..HOLE };

static REFILLED: Hole = Hole {
    form: ("refilled", "held pressure decays to a share of the command"),
    parameters: &[
        TIME,
        Parameter { name: "kept_share", quantity: Quantity::Ratio, low: 0.0, high: 0.95, logarithmic: false },
        Parameter { name: "lifts_at", quantity: Quantity::Input, low: 0.0, high: 0.9, logarithmic: false },
    ],
    below_zero: false,
};

const TIME: Parameter = Parameter { name: "time_constant", quantity: Quantity::Time, low: 0.5, high: 500.0, logarithmic: true };

/// Lets `path` decay towards `kept` times itself, not below `floor`; what a lip holds that lifts at a pressure does not leak below it.
fn leak(path: &mut [f64], time_s: f64, [kept, lifts]: [f64; 2], period_s: f64, floor: f64) {
    let keeps = [(-period_s / time_s).exp(), (-period_s * kept / time_s).exp()];
    let mut state = path[0];
    let mut last = path[0];
    for value in path {
        let command = 0.5 * (*value + last);
        let (rest, keep) = if lifts == 0.0 || state > lifts { (lifts + kept * (command - lifts), keeps[0]) } else { (command, keeps[1]) };
        state = (rest + keep * (state - rest) + 0.5 * (1.0 + keep) * (*value - last)).max(floor);
        last = *value;
        *value = state;
    }
}

impl Form for Hole {
    fn spec(&self) -> Spec {
        let simpler_at: &[(usize, f64)] = if self.parameters.len() > 2 { &[(2, 0.0)] } else { &[] };
        Spec { parameters: self.parameters, simpler_at, ..Spec::new("leakage", self.form, Place::Tube) }
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        if self.parameters.len() == 1 {
            return grid(&[&ladder(2.0, 100.0, 7)]);
        }
        grid(&[&ladder(2.0, 30.0, 4), &[0.15, 0.5], &[0.0, 0.4]])
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        // A unipolar line cannot go below the room's pressure.
        let floor = if self.below_zero || run.input.iter().any(|&value| value < -0.05) { f64::MIN } else { 0.0 };
        leak(path, parameters[0], [1, 2].map(|at| parameters.get(at).copied().unwrap_or(0.0)), run.period_s, floor);
    }
}

impl Form for Turbulent {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[TIME, Parameter { name: "pressure_power", quantity: Quantity::Ratio, low: 0.4, high: 1.6, logarithmic: true }],
            starts: || ladder(2.0, 60.0, 4).into_iter().map(|value| vec![value, 0.7]).collect(),
            ..Spec::new("leakage", ("turbulent", "held pressure decays with a power of itself"), Place::Tube)
        }
    }
    leads_input!(|self, parameters, run| Draining { share: run.period_s / parameters[0], power: parameters[1] });
}

/// What [`Turbulent`] does to the input.
#[derive(PartialEq)]
struct Draining {
    /// Share of the pressure, at one, that a sample takes away.
    share: f64,
    power: f64,
}

impl Filter<2> for Draining {
    fn begin(&self, first: f64) -> [f64; 2] {
        [first.max(0.0), first]
    }
    #[inline(always)]
    fn step(&self, [state, last]: &mut [f64; 2], value: f64) -> f64 {
        // The stroke passes; what it fills leaks for half of the sample's time, what there was for all of it.
        let middle = (*state + 0.5 * (value - *last)).max(0.0);
        *state = (*state + value - *last - self.share * elementary::power(middle, self.power)).max(0.0);
        *last = value;
        *state
    }
}

impl Form for Filling {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "fill_time_constant", quantity: Quantity::Time, low: 5e-3, high: 2.0, logarithmic: true },
                Parameter { name: "leak", quantity: Quantity::Ratio, low: 0.01, high: 1.0, logarithmic: true },
            ],
            starts: || grid(&[&ladder(0.03, 0.4, 3), &[0.04, 0.15]]),
            // With no leak it is the lag by which it fills.
            nested_limits: |of| vec![(pneumatic_lag::FORMS[0], of[..1].to_vec())],
            ..Spec::new("leakage", ("behind-restriction", "a hole behind the restriction that fills"), Place::Tube)
        }
    }
    leads_input!(|self, parameters, run| Filled { time_s: parameters[0], leak: parameters[1], step_s: run.period_s / LOOKS as f64 });
}

/// What [`Filling`] does to the input.
#[derive(PartialEq)]
struct Filled {
    time_s: f64,
    leak: f64,
    step_s: f64,
}

impl Filled {
    /// Where filling and leak balance: `e + L sqrt(e) = u`.
    #[inline(always)]
    fn balance(&self, command: f64) -> f64 {
        let root = (0.25 * self.leak * self.leak + command.max(0.0)).sqrt() - 0.5 * self.leak;
        if command > 0.0 { root * root } else { command }
    }
}

impl Filter<2> for Filled {
    fn begin(&self, first: f64) -> [f64; 2] {
        [self.balance(first), first]
    }
    #[inline(always)]
    fn step(&self, [state, last]: &mut [f64; 2], value: f64) -> f64 {
        // `u - v - L sqrt(v)` is `(e - v) (1 + L / (sqrt(e) + sqrt(v)))`: a lag towards the balance that is faster near zero, and stays
        // stable there.
        let mut before = self.balance(*last);
        for look in 1..=LOOKS {
            let now = self.balance(*last + (value - *last) * look as f64 / LOOKS as f64);
            let roots = (0.5 * (before + now)).max(0.0).sqrt() + state.max(0.0).sqrt();
            let (keep, of_now, of_before) = lag_coefficients(self.time_s / (1.0 + self.leak / roots.max(1e-3)), self.step_s);
            *state = keep * *state + of_now * now + of_before * before;
            before = now;
        }
        *last = value;
        *state
    }
}

/// Steps inside a sample, over which the time constant stands still.
const LOOKS: usize = 2;

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn air_comes_back_through_the_hole_where_the_room_is_not_at_zero() {
        // A ramp up and down within two seconds, then rest: what leaked out on the way is missing, and comes back. Closed form of
        // v' = u' - v / T with u' of one slope up and of the same slope down.
        let (slope, leak_s) = (0.8, 3.0);
        let times_s: Vec<f64> = (0..400).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = times_s.iter().map(|&time| slope * time.min(2.0 - time).max(0.0)).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), times_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let mut path = run.input.clone();
        EITHER_WAY.input(&[leak_s], run, &mut path);
        let slope = slope / session.input_scale;
        let top = slope * leak_s * (1.0 - (-1.0 / leak_s).exp());
        let end = -slope * leak_s + (top + slope * leak_s) * (-1.0 / leak_s).exp();
        assert!(end < -0.1);
        for (sample, after_s) in [(50, None), (100, Some(0.0)), (250, Some(3.0))] {
            let exact = after_s.map_or(top, |after_s: f64| end * (-after_s / leak_s).exp());
            assert!((path[sample] - exact).abs() < 1e-3, "sample {sample}: {} instead of {exact}", path[sample]);
        }
        let mut floored = run.input.clone();
        HOLE.input(&[leak_s], run, &mut floored);
        assert!(floored.iter().all(|value| *value >= 0.0));
    }

    #[test]
    fn the_hole_behind_the_restriction_follows_its_equation() {
        let (time_s, leak) = (0.12, 0.2);
        let times_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = times_s.iter().map(|time| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * 0.6 * time).cos()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), times_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let mut path = run.input.clone();
        Filling.input(&[time_s, leak], run, &mut path);
        let mut state = 0.0_f64;
        for (sample, value) in path.iter().enumerate().skip(1) {
            for look in 0..2000 {
                let share = (f64::from(look) + 0.5) / 2000.0;
                let command = run.input[sample - 1] + share * (run.input[sample] - run.input[sample - 1]);
                state = (state + 1e-5 / time_s * (command - state - leak * state.max(0.0).sqrt())).max(0.0);
            }
            assert!((value - state).abs() < 3e-3, "sample {sample}: {value} and {state}");
        }
        // Next to no leak leaves the lag that it comes near.
        let [mut leaking, mut lagging] = [(); 2].map(|()| run.input.clone());
        Filling.input(&[time_s, 1e-9], run, &mut leaking);
        let near = Filling.nested_limits(&[time_s, 1e-9]);
        near[0].0.input(&near[0].1, run, &mut lagging);
        assert!(near[0].0.name() == "pneumatic-lag" && leaking.iter().zip(&lagging).all(|(x, y)| (x - y).abs() < 3e-3));
    }
}
