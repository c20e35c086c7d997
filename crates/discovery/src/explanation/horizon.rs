//! The memory horizon: how much of the input's past the output needs.
//!
//! For a window of length `L` the predictor sees nothing but the input of the last `L` seconds: play operators that begin fresh at the
//! window's start, and first-order lags cut off there, with weights fitted by least squares on one half of the recordings. Its error on the
//! other half, against `L`, falls until `L` holds all that the plant remembers. A model that sees less (a network with a window of 50
//! samples) cannot be better than the error at its length; play operators and recurrent networks see everything.

use pulp::{Arch, Simd, WithSimd};
use serde::Serialize;

use crate::data::session::{Role, Run, Session};
use crate::model::least_squares::Gram;

/// Windows that are tried, s; those that no recording is twice as long as are left out.
const WINDOWS_S: [f64; 8] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0];

/// Thresholds of the operators, over the span.
const THRESHOLDS: [f64; 12] = [0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.27, 0.35, 0.45, 0.6, 0.8];

/// Time constants of the lags, s.
const LAGS_S: [f64; 5] = [0.03, 0.1, 0.3, 1.0, 4.0];

/// Samples that are looked at: more would not narrow the intervals, which come from recordings.
const MOST_SAMPLES: usize = 6000;

/// The error of a window.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Window {
    /// Its length, s.
    pub window_s: f64,
    /// RMSE on recordings that selected, output units.
    pub rmse: f64,
    /// Where that lies with 95 %, by the scatter from recording to recording.
    pub interval: [f64; 2],
}

/// Errors of windows of growing length; nothing when recordings are too few or too short to tell.
#[must_use]
pub fn horizon(session: &Session) -> Vec<Window> {
    let usable = |run: &&Run| run.is_worked_with() && run.input.len() > 20;
    let runs: Vec<&Run> = session.runs.iter().filter(usable).collect();
    let length_s = |run: &&Run| run.input.len() as f64 * run.period_s;
    let shortest_s = runs.iter().map(length_s).fold(f64::MAX, f64::min);
    let samples: usize = runs.iter().map(|run| run.input.len()).sum();
    if runs.iter().filter(|run| run.role.contains(&Role::Select)).count() < 3 {
        return Vec::new();
    }
    let stride = samples.div_ceil(MOST_SAMPLES);
    // Every window is judged by the same samples: those that the longest one has a whole past for.
    let windows: Vec<f64> = WINDOWS_S.into_iter().filter(|window_s| 2.0 * window_s <= shortest_s).collect();
    let Some(&longest_s) = windows.last() else { return Vec::new() };
    let scale = session.output_scale.abs();
    let scaled = |found: Window| Window { rmse: found.rmse * scale, interval: found.interval.map(|value| value * scale), ..found };
    windows.iter().filter_map(|&window_s| error(&runs, window_s, longest_s, stride).map(scaled)).collect()
}

fn error(runs: &[&Run], window_s: f64, longest_s: f64, stride: usize) -> Option<Window> {
    let columns = 2 + THRESHOLDS.len() + LAGS_S.len();
    let mut gram = Gram::new(columns);
    let mut row = vec![0.0; columns];
    let places = |run: &Run, role: Role| {
        let first = (longest_s / run.period_s).round() as usize;
        let run_roles: Vec<usize> = (first..run.input.len()).step_by(stride).filter(|&at| run.role[at] == role && run.keep[at]).collect();
        run_roles
    };
    for run in runs {
        for at in places(run, Role::Fit) {
            features(run, at, window_s, &mut row);
            for (one, &left) in row.iter().enumerate() {
                for (sum, right) in gram.products[one * columns..].iter_mut().zip(&row) {
                    *sum += left * right;
                }
                gram.target[one] += left * run.output[at];
            }
            gram.energy += run.output[at].powi(2);
            gram.samples += 1.0;
        }
    }
    if gram.samples < 4.0 * columns as f64 {
        return None;
    }
    let weights = gram.solve(&vec![true; columns], &[]);
    // Mean square and samples of each recording.
    let mut judged: Vec<(f64, f64)> = Vec::new();
    for run in runs {
        let chosen = places(run, Role::Select);
        let square = |at: usize| {
            features(run, at, window_s, &mut row);
            let predicted: f64 = row.iter().zip(&weights).map(|(value, weight)| value * weight).sum();
            (run.output[at] - predicted).powi(2)
        };
        if !chosen.is_empty() {
            let count = chosen.len() as f64;
            judged.push((chosen.into_iter().map(square).sum::<f64>() / count, count));
        }
    }
    let total: f64 = judged.iter().map(|one| one.1).sum();
    let mean = judged.iter().map(|one| one.0 * one.1).sum::<f64>() / total;
    // The ratio of two sums over recordings (Cochran 1977, section 6.4).
    let count = judged.len() as f64;
    let scatter = judged.iter().map(|one| (one.1 * (one.0 - mean)).powi(2)).sum::<f64>() / (count - 1.0);
    let reach = 1.96 * (count * scatter).sqrt() / total;
    (count > 2.0).then(|| Window { window_s, rmse: mean.sqrt(), interval: [(mean - reach).max(0.0).sqrt(), (mean + reach).sqrt()] })
}

/// What a window of the input ending at sample `at` shows: a constant, the input, operators and lags.
fn features(run: &Run, at: usize, window_s: f64, row: &mut [f64]) {
    let first = at - ((window_s / run.period_s).round() as usize).min(at);
    let window = &run.input[first..=at];
    row[0] = 1.0;
    row[1] = window[window.len() - 1];
    let shares = LAGS_S.map(|time_s| 1.0 - (-run.period_s / time_s).exp());
    let (operators, lags) = Arch::new().dispatch(States { window, shares });
    row[2..2 + THRESHOLDS.len()].copy_from_slice(&operators);
    row[2 + THRESHOLDS.len()..].copy_from_slice(&lags);
}

/// Operators and lags at the end of a window, side by side.
struct States<'a> {
    window: &'a [f64],
    /// What a lag closes of its distance in a sample.
    shares: [f64; LAGS_S.len()],
}

impl WithSimd for States<'_> {
    type Output = ([f64; THRESHOLDS.len()], [f64; LAGS_S.len()]);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Self::Output {
        let (mut operators, mut lags) = ([0.0_f64; THRESHOLDS.len()], [self.window[0]; LAGS_S.len()]);
        for &input in self.window {
            for (state, threshold) in operators.iter_mut().zip(THRESHOLDS) {
                *state = (input - threshold).max((input + threshold).min(*state));
            }
            for (state, share) in lags.iter_mut().zip(self.shares) {
                *state += share * (input - *state);
            }
        }
        (operators, lags)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Recording, Signal};
    use std::path::Path;

    /// Recordings of 30 s at 50 Hz, in which the output is made from the input by `plant`.
    fn session(plant: impl Fn(&[f64]) -> Vec<f64>) -> Session {
        let record = |index: u32| {
            let time_s: Vec<f64> = (0..1500).map(|sample| f64::from(sample) * 0.02).collect();
            // Levels that come and stay for a second and a half, joined by ramps of half a second.
            let level = |step: u32| f64::from((step.wrapping_mul(2_654_435_761) ^ index.wrapping_mul(40_503)) % 1000) / 1000.0;
            let input: Vec<f64> = time_s
                .iter()
                .map(|time| {
                    let (step, within) = ((time / 1.5) as u32, time % 1.5);
                    level(step) + (level(step + 1) - level(step)) * (within / 0.5).min(1.0)
                })
                .collect();
            let output = plant(&input);
            let path = format!("run{index}.csv");
            Recording::new(Path::new(&path), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output).expect("a recording")
        };
        Session::new(&(0..8).map(record).collect::<Vec<_>>(), &[]).expect("a session")
    }

    #[test]
    fn a_moving_mean_of_a_second_needs_a_second_and_no_more() {
        let session = session(|input| {
            (0..input.len())
                .map(|at| {
                    let window = &input[at.saturating_sub(49)..=at];
                    2.0 * window.iter().sum::<f64>() / window.len() as f64
                })
                .collect()
        });
        let found = horizon(&session);
        let of = |window_s: f64| found.iter().find(|window| window.window_s == window_s).expect("tried").rmse;
        assert!(of(0.2) > 3.0 * of(2.0), "{found:?}");
        assert!(of(10.0) > 0.8 * of(2.0), "{found:?}");
        assert!(found.iter().all(|window| window.interval[0] <= window.rmse && window.rmse <= window.interval[1]));
    }

    #[test]
    fn a_wide_play_operator_needs_more_than_a_network_of_fifty_samples_sees() {
        let session = session(|input| {
            let mut state = 0.0_f64;
            input
                .iter()
                .map(|value| {
                    state = (value - 0.15).max((value + 0.15).min(state));
                    state
                })
                .collect()
        });
        let found = horizon(&session);
        let of = |window_s: f64| found.iter().find(|window| window.window_s == window_s).expect("tried").rmse;
        assert!(of(0.5) > 2.0 * of(10.0) && of(1.0) > 1.5 * of(10.0), "{found:?}");
    }

    #[test]
    fn what_answers_at_once_needs_no_past() {
        let found = horizon(&session(<[f64]>::to_vec));
        assert!(found.iter().all(|window| window.rmse < 1e-3), "{found:?}");
    }
}
