//! Recordings as a fit takes them: one even clock for all, the same channels, and stretches between gaps.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use identification::{Covariate, LinearModel, Series};

use crate::physics::{ChannelRange, PhysicsModel, Source, chip};
use recording::{Recording, Signal, Subject, repeatability, resample};

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

/// Outputs that differ by less than this share of the sensor's noise are one recording, saved twice.
const SAME_NOISE: f64 = 0.1;
/// What saving again may change an input by, as a share of its range.
const RESAVED: f64 = 1e-3;
/// Samples below which nothing can be left out.
const FEWEST: usize = 60;

/// Puts recordings onto one clock.
///
/// # Errors
/// When there are none, their channels differ, they are too short, or a channel never moves.
pub fn prepare(recordings: &[Recording]) -> Result<Prepared> {
    let (recordings, mut notes) = without_copies(recordings);
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
    notes.extend(repeated(&even));
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
    let noise = repeatability::noise(recordings);
    // A part of a recording is a copy of the whole.
    let mut longest: Vec<&Recording> = recordings.iter().collect();
    longest.sort_by_key(|recording| std::cmp::Reverse(recording.len()));
    let mut dropped: Vec<&Path> = Vec::new();
    for (index, recording) in longest.iter().enumerate() {
        let whole = |other: &&&Recording| !dropped.contains(&other.path.as_path()) && is_copy(other, recording, noise);
        if let Some(twin) = longest[..index].iter().find(whole) {
            notes.push(format!("{} is left out: it is a copy of {}", name_of(&recording.path), name_of(&twin.path)));
            dropped.push(&recording.path);
        }
    }
    kept.extend(recordings.iter().filter(|recording| !dropped.contains(&recording.path.as_path())).cloned());
    (kept, notes)
}

/// Whether a recording is the beginning of another, up to far less than the sensor's noise: two runs of one excitation differ by more.
fn is_copy(whole: &Recording, part: &Recording, noise: f64) -> bool {
    let count = part.len();
    if 2 * count < whole.len() || whole.more_inputs.len() != part.more_inputs.len() {
        return false;
    }
    let same = |one: &[f64], other: &[f64], within: f64| {
        let squares: f64 = one[..count].iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum();
        squares <= within * within * count as f64
    };
    let inputs = || whole.inputs().into_iter().zip(part.inputs()).all(|(one, other)| same(one, other, RESAVED * width(one)));
    same(&whole.output, &part.output, SAME_NOISE * noise) && inputs()
}

fn width(values: &[f64]) -> f64 {
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)));
    high - low
}

/// What `check` says of recordings and a fit should be taken with, one line a subject.
fn repeated(recordings: &[Recording]) -> Vec<String> {
    let told = [Subject::Constant, Subject::Clipped, Subject::Gap, Subject::ClockRepaired, Subject::Resampled, Subject::Unit];
    let line = |subject: Subject| {
        let noted = |recording: &&Recording| recording.notes.iter().any(|note| note.subject == subject);
        let concerned: Vec<&Recording> = recordings.iter().filter(noted).collect();
        let first = concerned.first()?;
        let text = first.notes.iter().find(|note| note.subject == subject)?.text.trim_end_matches('.');
        let more = if concerned.len() > 1 { format!(" ({} recordings have such a note)", concerned.len()) } else { String::new() };
        Some(format!("{}: {text}{more}", name_of(&first.path)))
    };
    told.into_iter().filter_map(line).collect()
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

/// Quantity, unit and range of a channel over some recordings.
fn range<'a>(signal: &Signal, values: impl Iterator<Item = &'a [f64]>) -> ChannelRange {
    let (minimum, maximum) =
        values.flatten().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)));
    ChannelRange { quantity: signal.quantity.clone(), unit: signal.unit.clone(), minimum, maximum }
}

/// Names in reports: the file name, with the part behind `#` where a file holds several recordings.
pub(super) fn name_of(path: &Path) -> String {
    path.file_name().map_or_else(|| PathBuf::from(path).display().to_string(), |name| name.to_string_lossy().into_owned())
}

impl Prepared {
    /// A sum of columns in the form that has a front end on the chip, in the units of the data; `None` when there is none.
    #[must_use]
    pub fn on_chip(&self, model: &LinearModel) -> Option<PhysicsModel> {
        chip::of_sum(model, &self.inputs, &self.output, &self.sources)
    }
}
