//! `sample-and-hold`: the command is looked at once in a period and held until the next look, `v(t) = u(t_k)` with `t_k = (k + a) P <= t`,
//! and followed at once or like a volume behind a restriction.

use crate::chain::filters::best_starts;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::data::phasors::spacing_hz;
use crate::data::session::{Role, Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Held];

struct Held;

/// Time constant of what follows the held command; as short as can be it follows at once.
const FOLLOWS: Parameter = Parameter { name: "follow_time_constant", quantity: Quantity::Time, low: 1e-3, high: 0.3, logarithmic: true };

/// Longest period that is looked for, s.
const LONGEST_S: f64 = 0.6;

/// Fewest samples in a period that is looked for: with fewer, a dead time of half of it does as well.
const FEWEST_SAMPLES: f64 = 3.0;

/// Places of the first look that are looked at, over the period.
const FIRST_LOOKS: [f64; 4] = [0.0, 0.25, 0.5, 0.75];

/// Starts that are made finer.
const BEST: usize = 8;

impl Form for Held {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "period", quantity: Quantity::Time, low: 1e-3, high: LONGEST_S, logarithmic: true },
                Parameter { name: "first_look", quantity: Quantity::Ratio, low: 0.0, high: 1.0, logarithmic: false },
                FOLLOWS,
            ],
            steps: &[2e-4, 0.05, 0.3],
            simpler_at: &[(2, FOLLOWS.low)],
            ..Spec::new(
                "sample-and-hold",
                ("of-each-recording", "held for a period, counted from the start of each recording"),
                Place::Supply,
            )
        }
    }
    /// What holding does to the steps of the command against what the model misses of those of the output.
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let runs: Vec<&Run> = session.runs.iter().filter(|run| run.role.contains(&Role::Fit)).step_by(3).collect();
        let score = |parameters: &Vec<f64>| {
            let (mut cross, mut energy) = (0.0, 1e-30);
            for run in &runs {
                let mut path = run.input.clone();
                self.input(parameters, run, &mut path);
                let behind: Vec<f64> = path.iter().zip(&run.input).map(|(after, before)| after - before).collect();
                for (behind, missed) in behind.windows(2).zip(residual[run.index].windows(2)) {
                    let (x, y) = (behind[1] - behind[0], missed[1] - missed[0]);
                    cross += x * y;
                    energy += x * x;
                }
            }
            cross / energy.sqrt()
        };
        let (slowest_hz, fastest_hz) = (1.0 / LONGEST_S, 1.0 / (FEWEST_SAMPLES * session.runs[0].period_s));
        let spacing_hz = spacing_hz(session);
        let count = ((fastest_hz - slowest_hz) / spacing_hz).max(0.0) as usize;
        let of = |step: usize| {
            let period_s = 1.0 / (slowest_hz + step as f64 * spacing_hz);
            FIRST_LOOKS.into_iter().map(move |first| vec![period_s, first, FOLLOWS.low])
        };
        let best = best_starts((0..count).flat_map(of), score, BEST);
        // Finer steps about each, until a period is as near as a recording can tell.
        let finer = |start: Vec<f64>| {
            let around = |step: i32| 1.0 / (1.0 / start[0] + 0.1 * f64::from(step) * spacing_hz);
            let places = (-5..=5).flat_map(|step| (-2..=2).map(move |late| (around(step), 0.06 * f64::from(late))));
            let all = places.map(|(period_s, late)| vec![period_s, (start[1] + late).rem_euclid(1.0), FOLLOWS.low]);
            best_starts(all, score, 1)
        };
        best.into_iter().flat_map(finer).flat_map(|start| [start.clone(), vec![start[0], start[1], 0.02]]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let samples = parameters[0] / run.period_s;
        let before = path.to_vec();
        let is_followed = parameters[2] > FOLLOWS.low;
        let keep = |samples: f64| (-samples * run.period_s / parameters[2]).exp();
        let (mut held, mut state) = (before[0], before[0]);
        for (sample, value) in path.iter_mut().enumerate() {
            // A look at the moment of a sample counts.
            let look = (sample as f64 / samples - parameters[1] + 1e-9).floor() + parameters[1];
            let place = (look * samples).clamp(0.0, sample as f64);
            let below = place as usize;
            let share = place - below as f64;
            let looked_at = before[below] + share * (before[(below + 1).min(sample)] - before[below]);
            // The last look is some time ago, and until then the one before it counted.
            let since = (sample as f64 - place).min(1.0);
            state = held + (state - held) * keep(1.0 - since);
            state = looked_at + (state - looked_at) * keep(since);
            held = looked_at;
            *value = if is_followed { state } else { looked_at };
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use recording::{Recording, Signal};
    use std::path::Path;

    fn session(input_hz: &[f64]) -> Session {
        let of = |hz: &f64| {
            let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
            let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (TAU * hz * time).cos()).collect();
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input)
        };
        let recordings: Vec<Recording> = input_hz.iter().map(|hz| of(hz).expect("a recording")).collect();
        Session::new(&recordings, &[]).expect("a session")
    }

    #[test]
    fn what_was_looked_at_last_is_held() {
        let session = session(&[0.3]);
        let run = &session.runs[0];
        let (period_s, first) = (0.137, 0.3);
        let mut path = run.input.clone();
        Held.input(&[period_s, first, FOLLOWS.low], run, &mut path);
        // The last of all looks before each sample, found by counting them.
        let looks: Vec<f64> = (0..150).map(|look| (f64::from(look) + first) * period_s).collect();
        for (time_s, value) in run.time_s.iter().zip(path) {
            let look_s = looks.iter().copied().take_while(|look| look <= time_s).last().unwrap_or(0.0);
            let exact = 0.5 - 0.5 * (TAU * 0.3 * look_s).cos();
            // Straight lines between samples miss a sine by (omega dt)^2 / 16.
            assert!((value - exact).abs() < 1e-4, "at {time_s} s: {value} instead of {exact}");
        }
    }

    #[test]
    fn what_follows_a_held_command_comes_up_to_it_exponentially() {
        let session = session(&[0.3]);
        let run = &session.runs[0];
        let (period_s, first, follows_s) = (0.137, 0.3, 0.05);
        let through = |follows_s: f64| {
            let mut path = run.input.clone();
            Held.input(&[period_s, first, follows_s], run, &mut path);
            path
        };
        let mut state = run.input[0];
        for (sample, value) in through(follows_s).iter().enumerate().skip(1) {
            for look in 0..1000 {
                let time_s = run.time_s[sample - 1] + (f64::from(look) + 0.5) * 1e-3 * run.period_s;
                let look_s = (((time_s / period_s - first).floor() + first) * period_s).max(0.0);
                let held = 0.5 - 0.5 * (TAU * 0.3 * look_s).cos();
                state += 1e-3 * run.period_s / follows_s * (held - state);
            }
            assert!((value - state).abs() < 1e-3, "sample {sample}: {value} instead of {state}");
        }
    }

    #[test]
    fn period_and_first_look_are_found_in_what_a_smooth_model_misses() {
        for (period_s, first) in [(0.0712, 0.9), (0.21, 0.4), (0.43, 0.2)] {
            let input_hz = [0.2, 0.37, 0.61, 0.8, 0.2, 0.37];
            let session = session(&input_hz);
            // A delay of half a period is what a smooth model makes of it.
            let of = |(run, hz): (&Run, f64)| -> Vec<f64> {
                let u = |time_s: f64| 0.5 - 0.5 * (TAU * hz * time_s).cos();
                let look_s = |time_s: f64| (((time_s / period_s - first).floor() + first) * period_s).max(0.0);
                run.time_s.iter().map(|&time_s| u(look_s(time_s)) - u(time_s - 0.5 * period_s)).collect()
            };
            let residual: Vec<Vec<f64>> = session.runs.iter().zip(input_hz).map(of).collect();
            let starts = Held.starts(&session, &residual);
            let near = |start: &&Vec<f64>| (start[0] / period_s - 1.0).abs() < 1e-3 && (start[1] - first).abs() < 0.05;
            assert!(starts.iter().any(|start| near(&start)), "{period_s} s, {first}: {starts:?}");
        }
    }
}
