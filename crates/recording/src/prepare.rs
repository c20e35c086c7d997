//! What is done to recordings before anything is fitted to them: an even clock, a start that is left out, a zero.

use super::condition::short;
use super::resample;
use super::{Note, Prepare, Recording, RecordingError, Resample, Subject};

/// Does to each recording what the user asked for, and notes it.
///
/// # Errors
/// When nothing is left of a recording, or an even clock would need far more samples than there are.
pub fn prepare(recordings: Vec<Recording>, wanted: &Prepare) -> Result<Vec<Recording>, RecordingError> {
    if *wanted == Prepare::default() || recordings.is_empty() {
        return Ok(recordings);
    }
    let common_s = resample::common_period_s(&recordings);
    let period_s = wanted.resample.map(|resample| match resample {
        Resample::Common => common_s,
        Resample::Period(period_s) => period_s,
    });
    let one = |mut recording: Recording| {
        if let Some(period_s) = period_s {
            resample::check(&recording, period_s)?;
            recording = resample::uniform(&recording, period_s);
        }
        if wanted.skip_s > 0.0 {
            recording = skipped(recording, wanted.skip_s)?;
        }
        if let Some(tare_s) = wanted.tare_s {
            tare(&mut recording, 0.0, tare_s);
        }
        Ok(recording)
    };
    recordings.into_iter().map(one).collect()
}

/// Without its first seconds; times stay as they are.
fn skipped(mut recording: Recording, skip_s: f64) -> Result<Recording, RecordingError> {
    let start_s = recording.time_s[0];
    let first = recording.time_s.partition_point(|&time_s| time_s < start_s + skip_s);
    if recording.len() < first + 2 {
        let length_s = recording.time_s[recording.len() - 1] - start_s;
        return Err(RecordingError::Skipped { path: recording.path, length_s, skip_s });
    }
    let more = recording.more_inputs.iter_mut().map(|channel| &mut channel.values);
    let extra = recording.extra.iter_mut().map(|column| &mut column.values);
    for values in more.chain(extra).chain([&mut recording.time_s, &mut recording.input, &mut recording.output]) {
        values.drain(..first);
    }
    recording.gaps = recording.gaps.iter().filter(|&&gap| gap > first).map(|gap| gap - first).collect();
    recording.notes.push(Note::new(Subject::Prepared, format!("The first {} s, {first} samples, are left out.", short(skip_s))));
    Ok(recording)
}

/// Moves the output so that its mean over `tare_s` is zero, from `from_s` after the start on; over one sample at least.
pub fn tare(recording: &mut Recording, from_s: f64, tare_s: f64) {
    let begin_s = recording.time_s[0] + from_s;
    let first = recording.time_s.partition_point(|&time_s| time_s < begin_s).min(recording.len() - 1);
    let count = recording.time_s[first..].partition_point(|&time_s| time_s < begin_s + tare_s).max(1);
    let zero = recording.output[first..first + count].iter().sum::<f64>() / count as f64;
    recording.output.iter_mut().for_each(|value| *value -= zero);
    let unit = &recording.output_signal.unit;
    let text = format!("The output is told from its mean over the first {count} sample(s) that count, {} {unit}.", short(zero));
    recording.notes.push(Note::new(Subject::Prepared, text));
}
