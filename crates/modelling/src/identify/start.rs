//! What a fit starts from: rest, dead time, lag, family and thresholds.

use super::bank::{Family, Run, Samples};
use super::config::{Choice, FitConfig, Thresholds};
use super::thresholds::{self, Found, Search};
use crate::physics::{input_path, range};
use recording::Recording;

/// Pressure rests at zero; anything else where the recordings start.
pub(super) fn default_rest(recordings: &[Recording]) -> f64 {
    if recordings[0].input_signal.quantity.starts_with("pressure") {
        return 0.0;
    }
    let mut firsts: Vec<f64> = recordings.iter().map(|recording| recording.input[0]).collect();
    firsts.sort_by(f64::total_cmp);
    firsts[firsts.len() / 2]
}

pub(super) fn runs(recordings: &[Recording], config: &FitConfig, rest_input: f64, dead_time: f64, lag: f64) -> Vec<Run> {
    let run = |recording: &Recording| {
        let mut input = input_path(&recording.input, dead_time, lag);
        input.iter_mut().for_each(|value| *value -= rest_input);
        let begin_s = recording.time_s[0] + config.skip_s;
        let skip = recording.time_s.partition_point(|&time_s| time_s < begin_s);
        Run { input, output: recording.output.clone(), skip }
    };
    recordings.iter().map(run).collect()
}

/// Operators of the bank that judges dead time, lag and family.
const SCOUTS: usize = 16;
/// Samples that are enough to judge them by.
const SCOUT_SAMPLES: usize = 30_000;

/// Dead time in samples and lag coefficient: given, or by turns the best of ever finer grids, judged by the residual of a bank.
pub(super) fn input_path_of(recordings: &[Recording], config: &FitConfig, rest_input: f64, period_s: f64) -> (f64, f64) {
    if let (Choice::Given(dead_time_s), Choice::Given(time_constant_s)) = (config.dead_time_s, config.lag_time_constant_s) {
        return (dead_time_s / period_s, coefficient(period_s, time_constant_s));
    }
    let samples: usize = recordings.iter().map(Recording::len).sum();
    let every = samples.div_ceil(SCOUT_SAMPLES).max(1);
    let some: Vec<Recording> = recordings.iter().step_by(every).cloned().collect();
    let residual = |dead_time: f64, time_constant: f64| {
        let runs = runs(&some, config, rest_input, dead_time, coefficient(period_s, time_constant * period_s));
        let (low, high) = counted_range(&runs, |run| &run.input);
        let scout = FitConfig { thresholds: Thresholds::Grid(SCOUTS), ..config.clone() };
        if high > low { best_family(&runs, &scout, 0.5 * (high - low)).0.squared_residual } else { f64::INFINITY }
    };
    let given = |choice: Choice| match choice {
        Choice::Given(time_s) => Some(time_s / period_s),
        Choice::Auto => None,
    };
    // In samples.
    let mut dead_time = given(config.dead_time_s).unwrap_or(0.0);
    let mut time_constant = given(config.lag_time_constant_s).unwrap_or(0.0);
    let mut best = f64::INFINITY;
    for round in 0..4 {
        let step = 0.5_f64.powi(round);
        if config.lag_time_constant_s == Choice::Auto {
            let candidates: Vec<f64> = match round {
                0 => vec![0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0],
                _ => [-2.0, -1.0, 1.0, 2.0].iter().map(|k| time_constant * (1.0 + 0.25 * k * step)).collect(),
            };
            for candidate in candidates {
                let trial = residual(dead_time, candidate);
                if trial < best {
                    (best, time_constant) = (trial, candidate);
                }
            }
        }
        if config.dead_time_s == Choice::Auto {
            let centre = dead_time;
            let candidates: Vec<f64> = match round {
                0 => (0..=12).map(f64::from).collect(),
                _ => [-2.0, -1.0, 1.0, 2.0].iter().map(|k| (centre + k * step).max(0.0)).collect(),
            };
            for candidate in candidates {
                let trial = residual(candidate, time_constant);
                if trial < best {
                    (best, dead_time) = (trial, candidate);
                }
            }
        }
    }
    (dead_time, coefficient(period_s, time_constant * period_s))
}

/// The thresholds and weights of the family that fits best; play operators and a rising output win a tie.
pub(super) fn best_family(runs: &[Run], config: &FitConfig, largest: f64) -> (Found, Family, f64) {
    let grid = |count: usize| -> Vec<f64> { (0..count).map(|index| largest * index as f64 / count as f64).collect() };
    let samples = |every: usize| runs.iter().map(|run| Samples::of(run, every)).collect::<Vec<_>>();
    let [first, second] = [thresholds::coarse(runs, config.most_equations), thresholds::every(runs, config.most_equations)];
    let coarse = samples(first);
    let search = |family, sign| Search { runs: &coarse, family, sign, offsets: config.offsets, largest };
    let scout = grid(SCOUTS);
    let families = config.family.map_or_else(|| vec![Family::Play, Family::Stop], |family| vec![family]);
    let mut best: Option<(f64, Family, f64)> = None;
    for family in families {
        for (sign, left) in [1.0, -1.0].into_iter().zip(search(family, 1.0).left_of_both_signs(&scout)) {
            if best.is_none_or(|(before, ..)| left < before * (1.0 - 1e-6)) {
                best = Some((left, family, sign));
            }
        }
    }
    // Note(unwrap): there is at least one family.
    let (_, family, sign) = best.expect("a family was tried");
    let search = search(family, sign);
    let all = samples(1);
    let on_all = Search { runs: &all, ..search };
    let found = match &config.thresholds {
        Thresholds::Grid(count) => on_all.project(&grid(*count)),
        Thresholds::Given(thresholds) => on_all.project(thresholds),
        Thresholds::Free(count) if first == 1 => search.run(*count),
        // Their number and a start come from many samples, their place roughly from few and exactly from many: few steps are left then. The
        // weights, and what they leave, are those of all samples.
        Thresholds::Free(count) => {
            let many = samples(second);
            let fine = Search { runs: &many, ..search };
            let near = search.settle(&fine.start(*count)).thresholds;
            on_all.project(&fine.settle(&near).thresholds)
        }
    };
    (found, family, sign)
}

pub(super) fn counted_range(runs: &[Run], signal: impl Fn(&Run) -> &Vec<f64>) -> (f64, f64) {
    runs.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), run| {
        let (lowest, highest) = range(&signal(run)[run.counted()]);
        (low.min(lowest), high.max(highest))
    })
}

pub(super) fn coefficient(period_s: f64, time_constant_s: f64) -> f64 {
    if time_constant_s > 0.0 { -(-period_s / time_constant_s).exp_m1() } else { 1.0 }
}

pub(super) fn time_constant(coefficient: f64, period_s: f64) -> f64 {
    if coefficient < 1.0 { -period_s / (-coefficient).ln_1p() } else { 0.0 }
}
