//! Recordings on an even clock.
//!
//! Each stretch between gaps gets a clock of its own that starts at its first sample. Outputs and continuous inputs are interpolated by
//! straight lines; where the new period is two steps or longer they are averaged over it, so that noise does not fold down. An input that
//! holds its value between refreshes keeps the newest one. A stretch that is even already keeps its samples as they are.

use super::{Channel, ExtraColumn, Note, Recording, RecordingError, Subject, clock, held};

/// An even clock may be off by this share of a period: printed times are rounded.
const EVEN: f64 = 0.05;
/// A clock of events gets at most so many even samples for each recorded one.
const MOST_MORE: f64 = 8.0;

/// How the samples of a channel become values at other times.
#[derive(Clone, Copy, PartialEq)]
enum Method {
    Line,
    Mean,
    Hold,
}

/// An even clock with more samples than this, and with more than [`MOST_TIMES`] the recorded ones, is a slip.
const MANY: f64 = 2e7;
const MOST_TIMES: f64 = 20.0;

/// Whether a recording may be put onto a clock of `period_s`.
///
/// # Errors
/// When the period is none, is longer than the recording, or makes far more samples than were recorded.
pub fn check(recording: &Recording, period_s: f64) -> Result<(), RecordingError> {
    let length_s: f64 =
        recording.segments().iter().map(|segment| recording.time_s[segment.end - 1] - recording.time_s[segment.start]).sum();
    let samples = length_s / period_s;
    let sensible =
        period_s > 0.0 && samples >= 1.0 && (samples <= 1e6 || (samples <= MANY && samples <= MOST_TIMES * recording.len() as f64));
    match sensible {
        true => Ok(()),
        false => Err(RecordingError::Resample { path: recording.path.clone(), period_s, samples, recorded: recording.len() }),
    }
}

/// The recording on a clock of `period_s`; a note says how.
///
/// # Panics
/// Never for a period above zero.
#[must_use]
pub fn uniform(recording: &Recording, period_s: f64) -> Recording {
    assert!(period_s > 0.0 && period_s.is_finite(), "a period above zero is wanted");
    let segments = recording.segments();
    let even = segments.iter().all(|segment| is_even(&recording.time_s[segment.clone()], period_s));
    let clocks: Vec<Vec<f64>> = segments.iter().map(|segment| grid(&recording.time_s[segment.clone()], period_s, even)).collect();
    let typical_s = clock::quantile(clock::steps(&recording.time_s), 0.5);
    let smooth = if period_s >= 1.9 * typical_s { Method::Mean } else { Method::Line };
    let on = |values: &[f64], method: Method| -> Vec<f64> {
        if even {
            return values.to_vec();
        }
        let parts = segments.iter().zip(&clocks);
        parts
            .flat_map(|(segment, clock)| at(&recording.time_s[segment.clone()], &values[segment.clone()], clock, period_s, method))
            .collect()
    };
    let input_method = |values: &[f64]| if held::hold(&recording.time_s, values).is_some() { Method::Hold } else { smooth };
    let held_inputs = recording.inputs().into_iter().filter(|values| input_method(values) == Method::Hold).count();
    let mut result = recording.clone();
    result.input = on(&recording.input, input_method(&recording.input));
    result.more_inputs = (recording.more_inputs.iter())
        .map(|channel| Channel { signal: channel.signal.clone(), values: on(&channel.values, input_method(&channel.values)) })
        .collect();
    result.output = on(&recording.output, smooth);
    // A sequence number counts recorded samples; a flag is set or not.
    let extra = recording.extra.iter().filter(|column| even || column.name != "sequence");
    result.extra = extra
        .map(|column| {
            let method = if column.name == "limited" || column.name == "sequence" { Method::Hold } else { Method::Line };
            ExtraColumn { name: column.name.clone(), values: on(&column.values, method) }
        })
        .collect();
    let mut starts = clocks.iter().scan(0, |total, clock| {
        let start = *total;
        *total += clock.len();
        Some(start)
    });
    starts.next();
    result.gaps = starts.collect();
    result.time_s = clocks.concat();
    result.sample_period_s = period_s;
    if !even {
        let how = if smooth == Method::Mean { "means over each period" } else { "straight lines between samples" };
        let held = if held_inputs > 0 { format!(", {held_inputs} input(s) held between refreshes") } else { String::new() };
        let text = format!("Put onto an even clock of {period_s} s by {how}{held}.");
        result.notes.push(Note::new(Subject::Resampled, text));
    }
    result
}

/// The period that suits most samples of all recordings, in s; 0 of none.
#[must_use]
pub fn common_period_s(recordings: &[Recording]) -> f64 {
    let mut periods: Vec<(f64, usize)> = recordings.iter().map(|recording| (own_period_s(recording), recording.len())).collect();
    periods.sort_by(|one, other| one.0.total_cmp(&other.0));
    let half = periods.iter().map(|(_, samples)| samples).sum::<usize>().div_ceil(2);
    let mut passed = 0;
    let median = periods.iter().find(|(_, samples)| {
        passed += samples;
        passed >= half
    });
    median.map_or(0.0, |(period_s, _)| *period_s)
}

/// The even period that a recording's own clock comes nearest to.
fn own_period_s(recording: &Recording) -> f64 {
    let mut channels = recording.inputs();
    channels.push(&recording.output);
    if !clock::logs_events(&recording.time_s, &channels) {
        return recording.sample_period_s;
    }
    // Where things happen the steps are short; where nothing happens a coarser clock loses nothing.
    let short_s = clock::quantile(clock::steps(&recording.time_s), 0.25);
    let span_s = recording.time_s[recording.len() - 1] - recording.time_s[0];
    short_s.max(span_s / (MOST_MORE * recording.len() as f64))
}

/// Whether the times of a stretch are those of an even clock of this period, but for rounding.
fn is_even(time_s: &[f64], period_s: f64) -> bool {
    time_s.iter().enumerate().all(|(index, time)| (time - time_s[0] - index as f64 * period_s).abs() < EVEN * period_s)
}

/// The even times of a stretch.
fn grid(time_s: &[f64], period_s: f64, even: bool) -> Vec<f64> {
    if even {
        return time_s.to_vec();
    }
    // A last sample that rounding has put just before its time still counts.
    let steps = ((time_s[time_s.len() - 1] - time_s[0]) / period_s + EVEN).floor();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of samples, not negative")]
    (0..=steps as usize).map(|index| time_s[0] + index as f64 * period_s).collect()
}

/// Values of one channel of a stretch at ascending times within it.
fn at(time_s: &[f64], values: &[f64], clock: &[f64], period_s: f64, method: Method) -> Vec<f64> {
    let (mut right, mut low, mut high) = (0, 0, 0);
    let value_at = |time: f64| {
        while right < time_s.len() && time_s[right] < time - 1e-9 * period_s {
            right += 1;
        }
        if right == time_s.len() {
            return values[right - 1];
        }
        if right == 0 || (time_s[right] - time).abs() <= 1e-9 * period_s {
            return values[right];
        }
        if method == Method::Hold {
            return values[right - 1];
        }
        if method == Method::Mean {
            while low < time_s.len() && time_s[low] < time - 0.5 * period_s {
                low += 1;
            }
            high = high.max(low);
            while high < time_s.len() && time_s[high] < time + 0.5 * period_s {
                high += 1;
            }
            if high > low {
                return values[low..high].iter().sum::<f64>() / (high - low) as f64;
            }
        }
        let share = (time - time_s[right - 1]) / (time_s[right] - time_s[right - 1]);
        values[right - 1] + share * (values[right] - values[right - 1])
    };
    clock.iter().copied().map(value_at).collect()
}
