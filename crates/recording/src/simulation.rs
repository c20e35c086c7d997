//! What a simulation meets of a recording: its place in a session, a start-up stretch of measured output, an even clock.
//!
//! A model runs freely, from the input alone. What a recording has of its own (a zero, a phase) it may read from a *start-up stretch* at the
//! start of each stretch between gaps; that stretch then counts in no figure.

use std::ops::Range;

use super::{Recording, resample};

/// Sample periods that differ by more than this share are different; the median step of a measured clock strays by less.
pub const PERIOD_TOLERANCE: f64 = 0.05;
/// Steps may be off by this share of a period: printed times are rounded.
const EVEN: f64 = 0.25;

/// What surrounds an input: where in a session it was recorded, and what the start-up stretch measured.
#[derive(Clone, Copy, Debug, Default)]
pub struct Context<'a> {
    /// Name of the recording.
    pub name: &'a str,
    /// SHA-256 of its file; empty where it never was one.
    pub sha256: &'a str,
    /// Time since the session began, s, one value a sample; absent where nobody wrote it down.
    pub session_time_s: Option<&'a [f64]>,
    /// Measured output, of which a model may read the start-up stretch alone; empty where nothing is measured.
    measured: &'a [f64],
    /// Length of the start-up stretch, s.
    start_up_s: f64,
}

impl<'a> Context<'a> {
    /// That of a recording, with a start-up stretch of so many seconds.
    #[must_use]
    pub fn of(recording: &'a Recording, start_up_s: f64) -> Self {
        let clock = recording.extra.iter().find(|column| column.name == "session_time_s");
        Self {
            name: recording.path.file_name().and_then(|name| name.to_str()).unwrap_or_default(),
            sha256: &recording.sha256,
            session_time_s: clock.map(|column| &column.values[..]),
            measured: if start_up_s > 0.0 { &recording.output } else { &[] },
            start_up_s,
        }
    }

    /// What the start-up of a stretch of samples measured; nothing behind it is shown.
    #[must_use]
    pub fn start_up(&self, stretch: Range<usize>, period_s: f64) -> &'a [f64] {
        let count = (self.start_up_s / period_s - 1e-6).max(0.0).ceil() as usize;
        let end = stretch.end.min(stretch.start + count);
        self.measured.get(stretch.start..end).unwrap_or_default()
    }
}

/// Whether a recording's sample period is another than a model's, both in s.
#[must_use]
pub fn differs(model_s: f64, recording_s: f64) -> bool {
    // In this order a period that is not a number differs.
    let same = (recording_s - model_s).abs() <= PERIOD_TOLERANCE * model_s;
    !same
}

/// Whether the steps between gaps are so even that samples may stand for times.
#[must_use]
pub fn is_even(recording: &Recording) -> bool {
    let period_s = recording.sample_period_s;
    recording.segments().iter().all(|segment| {
        let times = &recording.time_s[segment.clone()];
        times.iter().enumerate().all(|(index, time)| (time - times[0] - index as f64 * period_s).abs() <= EVEN * period_s)
    })
}

/// What `simulate` makes of a recording on an even clock of `period_s`, back at the recording's times. Each stretch between the recording's
/// gaps is put onto a clock of its own; memory starts anew at those in `gaps`.
///
/// # Errors
/// Those of `simulate`.
pub fn on_even_clock<E>(
    recording: &Recording,
    gaps: &[usize],
    period_s: f64,
    start_up_s: f64,
    simulate: impl FnOnce(&Context<'_>, &[&[f64]], &[usize]) -> Result<Vec<f64>, E>,
) -> Result<Vec<f64>, E> {
    let even = resample::uniform(recording, period_s);
    let reset = if gaps.is_empty() { &[][..] } else { &even.gaps };
    let predicted = simulate(&Context::of(&even, start_up_s), &even.inputs(), reset)?;
    if even.len() == recording.len() && even.time_s == recording.time_s {
        return Ok(predicted);
    }
    let pairs = recording.segments().into_iter().zip(even.segments());
    Ok(pairs.flat_map(|(own, grid)| interpolate(&even.time_s[grid.clone()], &predicted[grid], &recording.time_s[own])).collect())
}

/// The values at `wanted` times by straight lines between samples; both times ascend, outside the ends the end value holds.
#[must_use]
pub fn interpolate(times: &[f64], values: &[f64], wanted: &[f64]) -> Vec<f64> {
    let mut right = 0;
    wanted
        .iter()
        .map(|&time| {
            while right < times.len() && times[right] < time {
                right += 1;
            }
            if right == 0 {
                return values[0];
            }
            if right == times.len() {
                return values[values.len() - 1];
            }
            let share = (time - times[right - 1]) / (times[right] - times[right - 1]);
            values[right - 1] + share * (values[right] - values[right - 1])
        })
        .collect()
}

/// First sample behind so many seconds from a recording's start.
#[must_use]
pub fn first_behind(recording: &Recording, start_s: f64) -> usize {
    // Half a millionth of a period: times in print are rounded.
    let end_s = recording.time_s[0] + start_s - 0.5e-6 * recording.sample_period_s;
    recording.time_s.partition_point(|&time_s| time_s < end_s)
}

/// Shifts a prediction so that its mean over the first seconds is that of the measurement: a start-up calibration.
pub fn set_zero(predicted: &mut [f64], recording: &Recording, calibrate_s: f64) {
    let seen = first_behind(recording, calibrate_s);
    let sum: f64 = recording.output[..seen].iter().zip(&*predicted).map(|(measured, predicted)| measured - predicted).sum();
    predicted.iter_mut().for_each(|value| *value += sum / seen.max(1) as f64);
}
