//! Recordings as a fit takes them: one even clock for all, the same channels, and stretches between gaps.

use anyhow::{Result, bail, ensure};
use identification::{Covariate, Series};

use super::file::{name_of, range};
use crate::identify::{ChannelRange, Source};
use crate::recording::{Recording, Signal, resample};

/// Recordings on one clock.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// On the even clock.
    pub recordings: Vec<Recording>,
    /// The same as the fit takes them.
    pub series: Vec<Series>,
    /// Time between samples in s.
    pub period_s: f64,
    /// Length of all recordings in s.
    pub duration_s: f64,
    /// Inputs with their ranges.
    pub inputs: Vec<ChannelRange>,
    /// Output with its range.
    pub output: ChannelRange,
    /// The files.
    pub sources: Vec<Source>,
    /// Slow signals that the zero may answer to, one list of values a recording.
    pub covariates: Vec<Covariate>,
    /// What was left out or changed, in words.
    pub notes: Vec<String>,
}

/// Samples below which nothing can be left out.
const FEWEST: usize = 60;

/// Puts recordings onto one clock.
///
/// # Errors
/// When there are none, their channels differ, they are too short, or a channel never moves.
pub fn prepare(recordings: &[Recording]) -> Result<Prepared> {
    let (recordings, notes) = without_copies(recordings);
    let Some(first) = recordings.first() else { bail!("there are no recordings to fit; give --data a file or a folder of them") };
    let channels = |recording: &Recording| -> Vec<Signal> {
        let more = recording.more_inputs.iter().map(|channel| channel.signal.clone());
        [recording.input_signal.clone(), recording.output_signal.clone()].into_iter().chain(more).collect()
    };
    for recording in &recordings {
        if channels(recording) != channels(first) {
            let words = |recording: &Recording| channels(recording).iter().map(Signal::column).collect::<Vec<_>>().join(", ");
            bail!(
                "{}: measures {}, the first recording measures {}; fit recordings of one kind",
                recording.path.display(),
                words(recording),
                words(first)
            );
        }
    }
    let period_s = resample::common_period_s(&recordings);
    let even: Vec<Recording> = recordings.iter().map(|recording| resample::uniform(recording, period_s)).collect();
    let samples: usize = even.iter().map(Recording::len).sum();
    ensure!(samples >= FEWEST, "the recordings hold {samples} samples in all, at least {FEWEST} are wanted; record longer");
    let signals: Vec<&Signal> =
        std::iter::once(&first.input_signal).chain(first.more_inputs.iter().map(|channel| &channel.signal)).collect();
    let inputs: Vec<ChannelRange> =
        signals.iter().enumerate().map(|(index, signal)| range(signal, even.iter().map(|one| one.inputs()[index]))).collect();
    let output = range(&first.output_signal, even.iter().map(|one| one.output.as_slice()));
    for channel in inputs.iter().chain([&output]) {
        let (name, held) = (&channel.quantity, channel.minimum);
        ensure!(
            channel.maximum > channel.minimum,
            "`{name}` never changes (it is {held} throughout): check the columns, or excite the actuator"
        );
        ensure!(
            (channel.maximum - channel.minimum).is_finite() && channel.maximum.abs() < 1e100,
            "`{name}` reaches {}; check its unit",
            channel.maximum
        );
    }
    let series = even.iter().map(series).collect();
    let source =
        |recording: &Recording| Source { file: name_of(&recording.path), sha256: recording.sha256.clone(), samples: recording.len() };
    Ok(Prepared {
        covariates: super::nuisance::covariates(&even),
        series,
        period_s,
        duration_s: samples as f64 * period_s,
        inputs,
        output,
        sources: recordings.iter().map(source).collect(),
        recordings: even,
        notes,
    })
}

/// Every recording once: a copy that is left out while its twin is fitted would promise an error that no new recording meets.
fn without_copies(recordings: &[Recording]) -> (Vec<Recording>, Vec<String>) {
    let mut kept: Vec<Recording> = Vec::new();
    let mut notes = Vec::new();
    for recording in recordings {
        match kept.iter().find(|other| other.output == recording.output && other.inputs() == recording.inputs()) {
            Some(twin) => notes.push(format!("{} is left out: it is a copy of {}", name_of(&recording.path), name_of(&twin.path))),
            None => kept.push(recording.clone()),
        }
    }
    (kept, notes)
}

fn series(recording: &Recording) -> Series {
    Series {
        name: name_of(&recording.path),
        group: recording.group.clone(),
        inputs: recording.inputs().into_iter().map(<[f64]>::to_vec).collect(),
        output: recording.output.clone(),
        gaps: recording.gaps.clone(),
        skip: 0,
    }
}
