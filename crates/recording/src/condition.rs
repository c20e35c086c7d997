//! What a recording's samples show by themselves: gaps, event clocks, staircases, resolution, clipping, constant stretches, units.

use std::collections::HashSet;

use super::extremes::Extremes;
use super::row_lines::RowLines;
use super::{Note, Recording, Signal, Subject, clock, held};

/// A resolution finer than this share of the range is not worth a word.
const COARSE: f64 = 1.0 / 400.0;
/// Samples in a row at the very end of the range that are called clipped, and the least share of all samples.
const CLIPPED_RUN: usize = 8;
const CLIPPED_SHARE: f64 = 0.01;
/// A stretch without change over this share of a recording is worth a word.
const CONSTANT_SHARE: f64 = 0.25;
/// Places in which such a stretch is looked for; closer to each other than it is long.
const PROBES: u32 = 5;
/// Pressures above this are suspicious: muscles burst and regulators end below it.
const MOST_BAR: f64 = 20.0;
/// Displacements above this are suspicious: no catheter bends so far.
const MOST_MM: f64 = 1000.0;
/// A sample less often than this is suspicious: milliseconds or microseconds are easily taken for seconds.
const LONGEST_PERIOD_S: f64 = 5.0;

/// Everything worth saying; `steps` are the shortest and the longest of the clock, `extremes` those of [`channels`], `lines` those of the samples
/// in the file.
pub(super) fn notes(recording: &Recording, steps: (f64, f64), extremes: &[Extremes], lines: &RowLines) -> Vec<Note> {
    let mut notes = clock_notes(recording, steps, lines);
    for ((role, signal, values), extremes) in channels(recording).into_iter().zip(extremes) {
        let name = format!("The {role} `{}`", signal.quantity);
        if extremes.range() == 0.0 {
            notes.push(Note::new(
                Subject::Constant,
                format!("{name} never changes: it is {} throughout.", with_unit(values[0], &signal.unit)),
            ));
            continue;
        }
        if role.starts_with("input")
            && let Some(hold) = held::hold_with(extremes.changes, &recording.time_s, values)
        {
            let when = hold
                .period_s
                .map_or_else(|| "at no fixed period".to_owned(), |period_s| format!("every {} s or a multiple", short(period_s)));
            notes.push(Note {
                count: hold.changes,
                ..Note::new(Subject::SampleAndHold, format!("{name} is a staircase that changes {when}."))
            });
        } else if let Some(step) = coarse_resolution(values, extremes.range()) {
            let text = format!("{name} has a coarse resolution: steps of {}.", with_unit(step, &signal.unit));
            notes.push(Note::new(Subject::Quantised, text));
        }
        notes.extend(clipped(&name, signal, values, extremes, lines));
        notes.extend(constant(&name, recording, values, lines));
        notes.extend(unit(&name, signal, extremes.most()));
    }
    notes
}

/// Inputs and output with their roles.
pub(super) fn channels(recording: &Recording) -> Vec<(String, &Signal, &[f64])> {
    let more = recording.more_inputs.iter().enumerate();
    let more = more.map(|(index, channel)| (format!("input{}", index + 2), &channel.signal, channel.values.as_slice()));
    let first = ("input".to_owned(), &recording.input_signal, recording.input.as_slice());
    let output = ("output".to_owned(), &recording.output_signal, recording.output.as_slice());
    std::iter::once(first).chain(more).chain([output]).collect()
}

fn clock_notes(recording: &Recording, steps: (f64, f64), lines: &RowLines) -> Vec<Note> {
    let mut notes = Vec::new();
    if let Some(&first) = recording.gaps.first() {
        let count = recording.gaps.len();
        let longest_s = recording.gaps.iter().map(|&gap| recording.time_s[gap] - recording.time_s[gap - 1]).fold(0.0, f64::max);
        let text =
            format!("{count} gap(s) in time, the longest {} s: too much could have happened there to go on across.", short(longest_s));
        notes.push(Note::counted(Subject::Gap, count, lines.line(first), text));
    }
    let period_s = recording.sample_period_s;
    if period_s > LONGEST_PERIOD_S {
        notes.push(Note::new(Subject::Unit, format!("A sample every {} s. Is the time in ms or us?", short(period_s))));
    }
    let values: Vec<&[f64]> = channels(recording).into_iter().map(|(_, _, values)| values).collect();
    if clock::logs_events_with(steps, &recording.time_s, &values) {
        notes.push(Note::new(Subject::EventClock, "The clock logs events: long steps stand where nothing changed, and are no gaps."));
    }
    notes
}

/// As [`resolution`], where the steps are wide. Nine in ten of the gaps between levels are a step or more: many levels cannot be coarse, and most
/// recordings show them in their first samples.
fn coarse_resolution(values: &[f64], range: f64) -> Option<f64> {
    let most = (1.0 / (0.9 * COARSE)) as usize + 2;
    let mut levels = HashSet::new();
    // A zero has one level whatever its sign.
    if values.iter().any(|value| levels.insert((value + 0.0).to_bits()) && levels.len() > most) {
        return None;
    }
    resolution(values).filter(|step| *step > COARSE * range)
}

/// The step size of values that all lie on a grid; none when they do not, or differ too little to tell.
#[must_use]
pub fn resolution(values: &[f64]) -> Option<f64> {
    let mut levels = values.to_vec();
    levels.sort_unstable_by(f64::total_cmp);
    levels.dedup();
    let steps: Vec<f64> = levels.windows(2).map(|pair| pair[1] - pair[0]).collect();
    // Fewer levels than samples: values come again, as on a grid.
    if steps.len() < 4 || levels.len() * 3 > values.len() {
        return None;
    }
    let step = clock::quantile(steps.clone(), 0.1);
    let on_grid = steps.iter().filter(|&&gap| ((gap / step).round() - gap / step).abs() < 0.15).count();
    (on_grid * 10 >= steps.len() * 9).then_some(step)
}

/// Runs at the highest or lowest value.
fn clipped(name: &str, signal: &Signal, values: &[f64], extremes: &Extremes, lines: &RowLines) -> Vec<Note> {
    let enough = |samples: usize| samples as f64 > CLIPPED_SHARE * values.len() as f64;
    let mut notes = Vec::new();
    for (extreme, at_it, which) in [(extremes.low, extremes.at_low, "lowest"), (extremes.high, extremes.at_high, "highest")] {
        // What is there at all, before it is looked for.
        if !enough(at_it) {
            continue;
        }
        let mut runs: Vec<(usize, usize)> = Vec::new();
        let mut start = 0;
        for run in values.chunk_by(|one, other| one == other) {
            if run[0] == extreme && run.len() >= CLIPPED_RUN {
                runs.push((start, run.len()));
            }
            start += run.len();
        }
        // At rest at the start or the end a signal lies at its extreme without being clipped; a zero is a natural end.
        runs.retain(|&(start, length)| start > 0 && start + length < values.len());
        let samples: usize = runs.iter().map(|(_, length)| length).sum();
        if runs.len() >= 2 && extreme != 0.0 && enough(samples) {
            let text = format!(
                "{name} may be clipped: {samples} samples in {} stretches lie at its {which} value, {}.",
                runs.len(),
                with_unit(extreme, &signal.unit)
            );
            notes.push(Note::counted(Subject::Clipped, samples, lines.line(runs[0].0), text));
        }
    }
    notes
}

/// The longest stretch without any change.
fn constant(name: &str, recording: &Recording, values: &[f64], lines: &RowLines) -> Option<Note> {
    let time_s = &recording.time_s;
    let span_s = time_s[values.len() - 1] - time_s[0];
    let mut longest = (0.0, 0, 0);
    // A stretch that is long enough holds one of these samples.
    let probes = (0..=PROBES).map(|probe| time_s[0] + f64::from(probe) / f64::from(PROBES) * span_s);
    for probe_s in probes {
        let at = time_s.partition_point(|time_s| *time_s <= probe_s).saturating_sub(1);
        let same = |value: &&f64| **value == values[at];
        let start = at - values[..at].iter().rev().take_while(same).count();
        let end = at + values[at..].iter().take_while(same).count();
        let length_s = time_s[end - 1] - time_s[start];
        if length_s > longest.0 {
            longest = (length_s, start, end - start);
        }
    }
    let (length_s, start, samples) = longest;
    let text = || format!("{name} does not change for {} s, {samples} samples from line {} on.", short(length_s), lines.line(start));
    (length_s > CONSTANT_SHARE * span_s && samples > 20).then(|| Note::counted(Subject::Constant, samples, lines.line(start), text()))
}

/// A unit that does not go with the values.
fn unit(name: &str, signal: &Signal, most: f64) -> Option<Note> {
    let text = match signal.unit.as_str() {
        "bar" if most > MOST_BAR => format!("{name} reaches {} bar. Is it in kPa or psi?", short(most)),
        "mm" if most > MOST_MM => format!("{name} reaches {} mm. Is it in um?", short(most)),
        "Pa" if most < 1e3 => format!("{name} never exceeds {} Pa. Is it in kPa or bar?", short(most)),
        "m" if most > 100.0 => format!("{name} reaches {} m. Is it in mm?", short(most)),
        "rad" if most > 20.0 => format!("{name} reaches {} rad. Is it in degrees?", short(most)),
        _ => return None,
    };
    Some(Note::new(Subject::Unit, text))
}

/// A value with its unit; a unit of 1 is none.
pub(super) fn with_unit(value: f64, unit: &str) -> String {
    if unit == "1" { short(value) } else { format!("{} {unit}", short(value)) }
}

/// A number of four digits at most, for a sentence.
pub(super) fn short(value: f64) -> String {
    let rounded: f64 = format!("{value:.3e}").parse().unwrap_or(value);
    if rounded == 0.0 || (1e-4..1e6).contains(&rounded.abs()) { rounded.to_string() } else { format!("{rounded:e}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coarse_resolution_is_told_by_few_levels_as_by_all() {
        for (step, digits) in [(0.5, 3.0), (0.05, 3.0), (0.01, 3.0), (0.0049, 3.0), (0.001, 3.0), (1e-9, 3.0), (0.5, 0.0)] {
            let values: Vec<f64> = (0..20_000).map(|index| (digits * (f64::from(index) * 1e-3).sin() / step).round() * step).collect();
            let all = resolution(&values).filter(|found| *found > COARSE * clock::range(&values));
            assert_eq!(coarse_resolution(&values, clock::range(&values)), all, "{step}");
        }
        let coarse: Vec<f64> = (0..20_000).map(|index| (f64::from(index) * 1e-3).sin().round()).collect();
        assert_eq!(coarse_resolution(&coarse, 2.0), None, "three levels are no grid");
    }
}
