//! The clock of a recording: its period, and where samples are missing.
//!
//! Terms. The *typical step* at a place is what nine of ten steps around it do not exceed: that of an even clock for an even clock, a long
//! one where the clock logs events or varies. The *bow* of a channel over a time is how far it leaves the straight line between two of its
//! samples that far apart: what interpolation would miss. A *gap* is a step that is longer than typical and over which the recording's own
//! bow, seen everywhere else in it, would matter. So a lost sample of a slow sine is none, and one of a fast sine is.
//!
//! An *event clock* logs a sample when something changes. Its long steps say that nothing happened, so a step counts only when more changed
//! across it than one event changes.

use super::extremes::{bounds, step_bounds};

/// No logger of a rig is faster than ten million samples a second; a clock that is has its times in another unit.
pub const SHORTEST_PERIOD_S: f64 = 1e-7;
/// A step up to this many typical steps is jitter, whatever happened: measured 100 Hz files reach 1.27 of them.
const JITTER: f64 = 1.3;
/// Times that are looked at without a stop between them.
const BLOCK: usize = 2048;
/// Steps on each side of a step that make its typical step.
const NEIGHBOURS: usize = 32;
/// A bow above this share of a channel's range matters.
const SHARE: f64 = 0.05;
/// Windows that the bow is taken over, at most.
const MOST_WINDOWS: usize = 1000;
/// With fewer windows of that length the recording cannot tell what could have happened.
const FEWEST_WINDOWS: usize = 8;
/// Steps of three medians that make a clock of events, at least.
const FEWEST_LONG: usize = 5;
/// The rate across long steps over that across short ones, below which nothing happened in the long ones.
const AT_REST: f64 = 0.3;
/// A channel whose bends are this share of those of white noise of its own spread says nothing about movement. A sine has it at five samples
/// a period.
const WHITE: f64 = 0.6;

/// The sample period of strictly increasing times in s: the mean step where the clock is even (which undoes the rounding of printed
/// times), else the median step.
#[must_use]
pub fn sample_period_s(time_s: &[f64]) -> f64 {
    if time_s.len() < 2 {
        return 0.0;
    }
    let mean = (time_s[time_s.len() - 1] - time_s[0]) / (time_s.len() - 1) as f64;
    // A clock is even when every time lies within 5 % of a period of the straight line: then printed times are only rounded.
    let is_even = |begin: usize, times_s: &[f64]| {
        // The whole of it is looked at: that is several at a time.
        let far = |(index, time): (u32, &f64)| (time - time_s[0] - (begin as f64 + f64::from(index)) * mean).abs() >= 0.05 * mean;
        (0..).zip(times_s).map(far).fold(true, |even, far| even & !far)
    };
    let even = time_s.chunks(BLOCK).enumerate().all(|(block, times_s)| is_even(block * BLOCK, times_s));
    // Nine digits: files of one clock get the same period although each file's rounding differs.
    significant(if even { mean } else { quantile(steps(time_s), 0.5) }, 9)
}

/// Index of the first sample after each gap; `channels` are the inputs and the output.
#[must_use]
pub fn gaps(time_s: &[f64], channels: &[&[f64]]) -> Vec<usize> {
    gaps_with(step_bounds(time_s), time_s, channels)
}

/// The same where the shortest and the longest step are known.
pub(super) fn gaps_with((shortest, longest): (f64, f64), time_s: &[f64], channels: &[&[f64]]) -> Vec<usize> {
    if time_s.len() < 3 || longest <= JITTER * shortest {
        return Vec::new();
    }
    let steps = steps(time_s);
    let candidates: Vec<usize> = (0..steps.len()).filter(|&index| steps[index] > JITTER * typical(&steps, index)).collect();
    if candidates.is_empty() {
        return Vec::new();
    }
    let mut moving: Vec<&[f64]> = channels.iter().copied().filter(|values| moves(values)).collect();
    if moving.is_empty() {
        // Nothing tells what could have happened but how long the step is.
        moving = channels.to_vec();
    }
    if logs_events_with((shortest, longest), time_s, &moving) {
        return candidates
            .into_iter()
            .filter(|&index| moving.iter().any(|values| more_than_an_event(values, index)))
            .map(|i| i + 1)
            .collect();
    }
    let mut bows = Bows { time_s, channels: &moving, known: Vec::new() };
    candidates.into_iter().filter(|&index| bows.matter(steps[index])).map(|index| index + 1).collect()
}

/// Whether the clock logs events: many long steps, across which the channels changed far less than their rate elsewhere would have made
/// them.
#[must_use]
pub fn logs_events(time_s: &[f64], channels: &[&[f64]]) -> bool {
    logs_events_with(step_bounds(time_s), time_s, channels)
}

/// The same where the shortest and the longest step are known.
pub(super) fn logs_events_with((shortest, longest): (f64, f64), time_s: &[f64], channels: &[&[f64]]) -> bool {
    // Then none is longer than three medians.
    if time_s.len() < 21 || longest <= 3.0 * shortest {
        return false;
    }
    let steps = steps(time_s);
    let long_from = 3.0 * quantile(steps.clone(), 0.5);
    let long = steps.iter().filter(|&&step| step > long_from).count();
    if long < FEWEST_LONG {
        return false;
    }
    let rate = |values: &[f64], wanted_long: bool| {
        let chosen = steps.iter().enumerate().filter(|(_, step)| (**step > long_from) == wanted_long);
        let (change, time) =
            chosen.fold((0.0, 0.0), |(change, time), (index, step)| (change + (values[index + 1] - values[index]).abs(), time + step));
        change / time
    };
    !channels.is_empty() && channels.iter().all(|values| rate(values, true) < AT_REST * rate(values, false))
}

/// What nine of ten steps around step `index`, itself left out, do not exceed.
pub(super) fn typical(steps: &[f64], index: usize) -> f64 {
    let around = index.saturating_sub(NEIGHBOURS)..steps.len().min(index + NEIGHBOURS + 1);
    let others: Vec<f64> = around.filter(|&other| other != index).map(|other| steps[other]).collect();
    quantile(others, 0.9)
}

/// Whether more changed across step `index` than one logged event changes.
fn more_than_an_event(values: &[f64], index: usize) -> bool {
    let changes: Vec<f64> = values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    changes[index] > 5.0 * quantile(changes.clone(), 0.9)
}

/// The bows of the channels by duration, each computed once.
struct Bows<'a> {
    time_s: &'a [f64],
    channels: &'a [&'a [f64]],
    /// Duration in s up to which, and whether a step of that duration matters.
    known: Vec<(f64, bool)>,
}

impl Bows<'_> {
    /// Whether something that matters could have happened in a step of this duration.
    fn matter(&mut self, duration_s: f64) -> bool {
        // Durations within a tenth are one: what matters does not change faster.
        if let Some((_, matters)) = self.known.iter().find(|(known_s, _)| (duration_s / known_s - 1.0).abs() < 0.1) {
            return *matters;
        }
        let matters = self.channels.iter().any(|values| match self.bow(values, duration_s) {
            Some(bow) => bow > SHARE * range(values),
            None => true,
        });
        self.known.push((duration_s, matters));
        matters
    }

    /// The bow that 95 of 100 windows of this duration do not exceed; none when the recording has too few such windows.
    fn bow(&self, values: &[f64], duration_s: f64) -> Option<f64> {
        let time_s = self.time_s;
        let stride = (time_s.len() / MOST_WINDOWS).max(1);
        let mut bows = Vec::new();
        let mut end = 0;
        let median = quantile(steps(time_s), 0.5);
        for start in (0..time_s.len()).step_by(stride) {
            end = end.max(start);
            while end < time_s.len() && time_s[end] - time_s[start] < duration_s * (1.0 - 1e-9) {
                end += 1;
            }
            if end == time_s.len() {
                break;
            }
            let inner = end - start - 1;
            // A window that is mostly a hole has not seen what happened in it.
            if inner == 0 || (inner as f64) < 0.5 * (duration_s / median - 1.0) {
                continue;
            }
            let slope = (values[end] - values[start]) / (time_s[end] - time_s[start]);
            let off = |index: usize| (values[index] - values[start] - slope * (time_s[index] - time_s[start])).abs();
            bows.push((start + 1..end).map(off).fold(0.0, f64::max));
        }
        (bows.len() >= FEWEST_WINDOWS).then(|| quantile(bows, 0.95))
    }
}

/// The steps between times.
pub(super) fn steps(time_s: &[f64]) -> Vec<f64> {
    time_s.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

/// The value that this share of the values does not exceed; 0 of none.
pub(super) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index: 0 to the length")]
    let index = ((values.len() as f64 * share) as usize).min(values.len() - 1);
    *values.select_nth_unstable_by(index, f64::total_cmp).1
}

/// Largest less smallest value.
pub(super) fn range(values: &[f64]) -> f64 {
    let (low, high) = bounds(values);
    if values.is_empty() { 0.0 } else { high - low }
}

/// Whether a channel is more than noise around one value.
fn moves(values: &[f64]) -> bool {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let spread = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
    let bends = values.windows(3).map(|three| (three[0] - 2.0 * three[1] + three[2]).powi(2)).sum::<f64>();
    (bends / count / 6.0).sqrt() < WHITE * spread
}

/// `value` rounded to so many significant decimal digits.
fn significant(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}
