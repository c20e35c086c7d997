//! `sample-and-hold`: the command is looked at once in a period and held until the next look, `v(t) = u(t_k)` with `t_k = (k + a) P <= t`,
//! and followed at once or like a volume behind a restriction.

use std::f64::consts::TAU;

use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::data::phasors::{spacing_hz, transform};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Held];

struct Held;

/// Time constant of what follows the held command; as short as can be it follows at once.
const FOLLOWS: Parameter = Parameter { name: "follow_time_constant", quantity: Quantity::Time, low: 1e-3, high: 0.3, logarithmic: true };

/// Longest period that is looked for, s.
const LONGEST_S: f64 = 0.6;

/// Fewest samples in a period that is looked for: with fewer, a dead time of half of it does as well.
const FEWEST_SAMPLES: f64 = 3.0;

/// Periods that are tried.
const PEAKS: usize = 8;

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
    /// Behind a held command the output misses `u' (t - t_k - P / 2)` of a smooth one, a sawtooth: its product with `u'` has a line at `1 / P`.
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let period_s = session.runs[0].period_s;
        let of = |run: &Run| -> Vec<f64> {
            let counts = |sample: usize| run.keep[sample] && run.role[sample].is_worked_with();
            let slope = |sample: usize| run.input[(sample + 1).min(run.input.len() - 1)] - run.input[sample.saturating_sub(1)];
            // A step between two samples says nothing of a period and would outweigh all that moves.
            let moves = |sample: usize| slope(sample).abs() <= 2.0 * run.period_s * session.fastest_per_s;
            let slopes: Vec<f64> =
                (0..run.input.len()).map(|sample| if counts(sample) && moves(sample) { slope(sample) } else { 0.0 }).collect();
            // The mean delay goes first: with it the command's own lines would show.
            let squares = slopes.iter().map(|slope| slope * slope).sum::<f64>().max(1e-30);
            let delay = residual[run.index].iter().zip(&slopes).map(|(missed, slope)| missed * slope).sum::<f64>() / squares;
            residual[run.index].iter().zip(&slopes).map(|(missed, slope)| (missed - delay * slope) * slope).collect()
        };
        let products: Vec<Vec<f64>> = session.worked().map(of).collect();
        let sums = |frequencies_hz: &[f64]| -> Vec<[f64; 2]> {
            let all: Vec<[Vec<f64>; 2]> = products.iter().map(|values| transform(values, 0.0, period_s, frequencies_hz)).collect();
            (0..frequencies_hz.len()).map(|at| [0, 1].map(|part: usize| all.iter().map(|one| one[part][at]).sum())).collect()
        };
        let power = |[re, im]: &[f64; 2]| re * re + im * im;
        let spacing_hz = spacing_hz(session);
        let count = ((1.0 / (FEWEST_SAMPLES * period_s) - 1.0 / LONGEST_S) / spacing_hz).max(0.0) as usize;
        let frequencies: Vec<f64> = (0..count).map(|step| 1.0 / LONGEST_S + step as f64 * spacing_hz).collect();
        let powers: Vec<f64> = sums(&frequencies).iter().map(power).collect();
        let mut peaks: Vec<usize> = (1..count.saturating_sub(1)).filter(|&at| powers[at] >= powers[at - 1].max(powers[at + 1])).collect();
        peaks.sort_by(|x, y| powers[*y].total_cmp(&powers[*x]));
        let tuned = |at: usize| {
            let mut best = ([0.0; 2], frequencies[at]);
            for finer in [0.1, 0.01] {
                let comb: Vec<f64> = (-10..=10).map(|step| best.1 + finer * f64::from(step) * spacing_hz).collect();
                best = sums(&comb).into_iter().zip(comb).fold(best, |best, one| if power(&one.0) > power(&best.0) { one } else { best });
            }
            // The sawtooth is `-sum sin(2 pi k (t - t_0) / P) P / (pi k)`.
            let first = best.0[1].atan2(best.0[0]) / TAU - 0.25;
            // It comes out early by as much as strokes bend within a period.
            let of = |late: f64, follows_s: f64| vec![1.0 / best.1, (first + late).rem_euclid(1.0), follows_s];
            [of(0.0, FOLLOWS.low), of(0.05, FOLLOWS.low), of(0.0, 0.02)]
        };
        peaks.into_iter().take(PEAKS).flat_map(tuned).collect()
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
