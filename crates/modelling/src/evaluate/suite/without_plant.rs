//! The suite on a measured rig: nobody knows the truth for new signals, so the model is held against itself.

use anyhow::{Context, Result};

use super::report::{Criterion, HOLD_S, Hold, LONG_RUN, Request, SEED_OFFSET, SuiteReport, at_hold_times, largest, output_range, span};
use crate::evaluate::compare::growth;
use crate::evaluate::metrics::root_mean_square;
use crate::evaluate::{for_each, metrics};
use recording::Recording;
use simulation::excitation::{ExcitationConfig, Segment, Signal};

/// Levels of the holds, spread evenly over the range.
const HOLDS: usize = 11;
/// Time that a ramp takes from one signal to the next, in s.
const RAMP_S: f64 = 1.0;
/// Time into a hold from which the output must rest, in s.
const SETTLED_S: f64 = 10.0;
/// Random histories before the same signal, and their length in s.
const HISTORIES: usize = 8;
const HISTORY_S: f64 = 10.0;
/// Longest part of a recording that is repeated, in samples: the long run has three passes at least.
const LONGEST_PASS: usize = LONG_RUN / 4;

/// Adds every criterion that needs no truth; gives the input of the long run.
pub(super) fn run(request: &Request<'_>, report: &mut SuiteReport) -> Result<Vec<f64>> {
    let widest = widest(request.recordings).context("no recordings")?;
    let period_s = request.model.description().sample_period_s.unwrap_or(widest.sample_period_s);
    let signal = &widest.input[..widest.len().min(LONGEST_PASS)];
    let range = output_range(request);
    let why = "there is no plant that gives the truth for new signals; name one with --plant";
    report.not_judged.push(format!("half amplitude, noise-free and new signals: {why}"));
    holds(request, signal, period_s, range, report)?;
    histories(request, signal, period_s, range, report)?;
    long_run(request, signal, period_s, range, report)
}

/// The recording whose input moves over the widest range.
fn widest(recordings: &[Recording]) -> Option<&Recording> {
    recordings.iter().max_by(|first, second| metrics::range(&first.input).total_cmp(&metrics::range(&second.input)))
}

fn samples(duration_s: f64, period_s: f64) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of samples")]
    let count = (duration_s / period_s).round() as usize;
    count
}

/// A straight line from one value to another, without either end.
fn ramp(from: f64, to: f64, period_s: f64) -> impl Iterator<Item = f64> {
    let count = samples(RAMP_S, period_s).max(2);
    (1..count).map(move |index| from + (to - from) * index as f64 / count as f64)
}

fn holds(request: &Request<'_>, signal: &[f64], period_s: f64, range: f64, report: &mut SuiteReport) -> Result<()> {
    let (low, high) = span(signal).context("an empty recording")?;
    let levels: Vec<f64> = (0..HOLDS).map(|index| low + (index as f64 + 0.5) / HOLDS as f64 * (high - low)).collect();
    let last = signal[signal.len() - 1];
    report.holds = for_each(&levels, request.threads, |&level| {
        let mut input = signal.to_vec();
        input.extend(ramp(last, level, period_s));
        let start = input.len();
        input.extend(std::iter::repeat_n(level, samples(HOLD_S, period_s)));
        let held = request.model.predict(&input, &[])?.split_off(start);
        let reference = held[samples(SETTLED_S, period_s).min(held.len() - 1)];
        let changes: Vec<f64> = held.iter().map(|value| value - reference).collect();
        let settled = changes.iter().skip(samples(SETTLED_S, period_s)).copied();
        Ok(Hold { level, max_abs: largest(settled), errors: at_hold_times(&changes, period_s) })
    })?;
    let worst = largest(report.holds.iter().map(|hold| hold.max_abs));
    let what = format!(
        "largest change of the output from {SETTLED_S} s to {HOLD_S} s of {HOLDS} holds over the whole range (the rig's own creep counts)"
    );
    let limit = request.limits.hold_drift * range;
    report.criteria.push(Criterion::at_most("holds", what, worst, limit, &request.model.description().output.unit));
    Ok(())
}

/// A signal that sweeps the whole range wipes the memory of anything that moved within it: behind it, every history gives the same.
fn histories(request: &Request<'_>, signal: &[f64], period_s: f64, range: f64, report: &mut SuiteReport) -> Result<()> {
    let half = signal.len() / 2;
    let (low, high) = span(&signal[..half]).context("an empty recording")?;
    if high <= low {
        report.not_judged.push("histories: the first half of the recording never moves".to_owned());
        return Ok(());
    }
    let numbers: Vec<u64> = (0..HISTORIES as u64).collect();
    let ends = for_each(&numbers, request.threads, |&index| {
        let random_points = Signal::RandomPoints {
            minimum_bar: low,
            maximum_bar: high,
            slowest_bar_per_s: 0.05 * (high - low),
            fastest_bar_per_s: 1.2 * (high - low),
            hold_share: 0.25,
            longest_hold_s: 2.0,
            start_bar: None,
            end_bar: None,
        };
        let excitation = ExcitationConfig {
            sample_period_s: period_s,
            noise_bar: 0.0,
            seed: request.seed.wrapping_add(SEED_OFFSET).wrapping_add(2000 + index),
            segments: vec![Segment { duration_s: HISTORY_S, signal: random_points }],
        };
        let mut input = excitation.sample().context("a history of the suite")?.pressure_bar;
        let end = input[input.len() - 1];
        input.extend(ramp(end, signal[0], period_s));
        let start = input.len();
        input.extend_from_slice(signal);
        Ok(request.model.predict(&input, &[])?.split_off(start + half))
    })?;
    let spread = |end: &Vec<f64>| root_mean_square(end.iter().zip(&ends[0]).map(|(value, first)| value - first));
    let what = format!("largest RMS difference between {HISTORIES} random starting histories, behind a recording that wipes them out");
    let limit = request.limits.signals * range;
    let worst = largest(ends.iter().map(spread));
    report.criteria.push(Criterion::at_most("histories", what, worst, limit, &request.model.description().output.unit));
    Ok(())
}

/// The same signal again and again: from the second pass on a model that neither drifts nor diverges repeats itself.
fn long_run(request: &Request<'_>, signal: &[f64], period_s: f64, range: f64, report: &mut SuiteReport) -> Result<Vec<f64>> {
    let mut pass = signal.to_vec();
    pass.extend(ramp(signal[signal.len() - 1], signal[0], period_s));
    let input: Vec<f64> = pass.iter().copied().cycle().take(LONG_RUN).collect();
    let predicted = request.model.predict(&input, &[])?;
    let passes: Vec<&[f64]> = predicted.chunks_exact(pass.len()).skip(1).collect();
    let change = |later: &&[f64]| root_mean_square(later.iter().zip(passes[0]).map(|(value, second)| value - second));
    report.long_run = passes.iter().map(change).collect();
    let unit = &request.model.description().output.unit;
    let limit = request.limits.signals * range;
    let what = format!("largest RMS change between repetitions of a recording over {LONG_RUN} samples");
    report.criteria.push(Criterion::at_most("long-run", what, largest(report.long_run.iter().copied()), limit, unit));
    let what = "growth of that change from the first to the last repetitions".to_owned();
    report.criteria.push(Criterion::at_most("long-run-growth", what, growth(&report.long_run), 0.25 * limit, unit));
    Ok(input)
}
