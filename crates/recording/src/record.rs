//! A recording in memory: its channels, its clock, its gaps.

use std::path::{Path, PathBuf};

use crate::clock;
use crate::error::RecordingError;
use crate::extremes;
use crate::note::Note;

/// Name and unit of one channel.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Signal {
    /// Quantity, for example `pressure`.
    pub quantity: String,
    /// Unit, for example `bar`.
    pub unit: String,
}

impl Signal {
    /// The input of our own files, pressure in bar.
    #[must_use]
    pub fn pressure_bar() -> Self {
        Self { quantity: "pressure".into(), unit: "bar".into() }
    }

    /// The output of our own files, displacement in mm.
    #[must_use]
    pub fn displacement_mm() -> Self {
        Self { quantity: "displacement".into(), unit: "mm".into() }
    }

    /// The name of this signal's column: `quantity_unit`.
    #[must_use]
    pub fn column(&self) -> String {
        format!("{}_{}", self.quantity, self.unit)
    }
}

/// An input beside the first.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// What it is.
    pub signal: Signal,
    /// One value a sample.
    pub values: Vec<f64>,
}

/// One more column of a recording, carried along unchanged.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtraColumn {
    /// Its header, for example `temperature_c`.
    pub name: String,
    /// One value a sample.
    pub values: Vec<f64>,
}

/// One run: input and output at common times, free of non-finite values.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Where it came from; also its name in reports. A part of a file has the part's name after a `#`; see [`Recording::file`].
    pub path: PathBuf,
    /// Family of excitation, for example `a`; taken from the file name.
    pub family: String,
    /// Recordings of one group (a day, a load, an amplitude) are left out together in cross-validation; empty where nothing shows groups.
    pub group: String,
    /// What the input is.
    pub input_signal: Signal,
    /// What the output is.
    pub output_signal: Signal,
    /// Sample times in s, strictly increasing.
    pub time_s: Vec<f64>,
    /// First input, one value a sample.
    pub input: Vec<f64>,
    /// The inputs beside the first.
    pub more_inputs: Vec<Channel>,
    /// Output, one value a sample.
    pub output: Vec<f64>,
    /// Sample period in s: the mean step where the clock is even (which undoes the rounding of printed times), else the median step.
    pub sample_period_s: f64,
    /// Index of the first sample after each gap.
    pub gaps: Vec<usize>,
    /// Optional columns of our own files (`pressure_measured_bar`, `sequence`, `temperature_c`, `session_time_s`).
    pub extra: Vec<ExtraColumn>,
    /// What reading found and did.
    pub notes: Vec<Note>,
    /// SHA-256 of the file's bytes in hexadecimal; empty for a recording that never was a file.
    pub sha256: String,
}

/// How even a recording's clock is.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Timing {
    /// Median step in s.
    pub median_step_s: f64,
    /// Shortest step in s.
    pub shortest_step_s: f64,
    /// Longest step in s, gaps included.
    pub longest_step_s: f64,
    /// Share of steps that differ from the median by more than 5 %.
    pub uneven_share: f64,
    /// Number of gaps.
    pub gaps: usize,
}

impl Recording {
    /// Makes a recording from samples in memory: checks them, finds the period and the gaps; `path` gives the name and the family.
    ///
    /// # Errors
    /// When the lengths differ, there are fewer than two samples, a value is not finite, or a time does not increase. The line named
    /// is that of a file with one header line.
    pub fn new(
        path: &Path,
        input_signal: Signal,
        output_signal: Signal,
        time_s: Vec<f64>,
        input: Vec<f64>,
        output: Vec<f64>,
    ) -> Result<Self, RecordingError> {
        let line_of = |index: usize| index as u64 + 2;
        if time_s.len() != input.len() || time_s.len() != output.len() {
            return Err(RecordingError::Lengths { path: path.into(), time: time_s.len(), input: input.len(), output: output.len() });
        }
        let columns = [("time_s".to_owned(), &time_s), (input_signal.column(), &input), (output_signal.column(), &output)];
        for (column, values) in &columns {
            if let Some(index) = values.iter().position(|value| !value.is_finite()) {
                let text = values[index].to_string();
                return Err(RecordingError::NotFinite { path: path.into(), line: line_of(index), column: column.clone(), text });
            }
        }
        if let Some(index) = (1..time_s.len()).find(|&index| time_s[index] <= time_s[index - 1]) {
            let (previous_s, time_s) = (time_s[index - 1], time_s[index]);
            return Err(RecordingError::TimeNotIncreasing { path: path.into(), line: line_of(index), previous_s, time_s });
        }
        if time_s.len() < 2 {
            return Err(RecordingError::TooShort { path: path.into(), rows: time_s.len() });
        }
        let steps = extremes::step_bounds(&time_s);
        Self::of_checked(path, (input_signal, output_signal), (time_s, input, output), steps)
    }

    /// The same of samples that are known to be finite, two at least, with times that increase by these steps at least and at most.
    pub(super) fn of_checked(
        path: &Path,
        (input_signal, output_signal): (Signal, Signal),
        (time_s, input, output): (Vec<f64>, Vec<f64>, Vec<f64>),
        steps: (f64, f64),
    ) -> Result<Self, RecordingError> {
        let sample_period_s = clock::sample_period_s(&time_s);
        if sample_period_s < clock::SHORTEST_PERIOD_S {
            let (period_s, rate_hz) = (sample_period_s, 1.0 / sample_period_s);
            return Err(RecordingError::TooFast { path: path.into(), period_s, rate_hz });
        }
        let gaps = clock::gaps_with(steps, &time_s, &[&input, &output]);
        let family = family(path);
        let path = path.to_path_buf();
        Ok(Self {
            path,
            family,
            group: String::new(),
            input_signal,
            output_signal,
            time_s,
            input,
            more_inputs: Vec::new(),
            output,
            sample_period_s,
            gaps,
            extra: Vec::new(),
            notes: Vec::new(),
            sha256: String::new(),
        })
    }

    /// Adds inputs beside the first; the gaps are found anew.
    #[must_use]
    pub fn with_more_inputs(mut self, more_inputs: Vec<Channel>) -> Self {
        if !more_inputs.is_empty() {
            self.more_inputs = more_inputs;
            let mut channels = self.inputs();
            channels.push(&self.output);
            self.gaps = clock::gaps(&self.time_s, &channels);
        }
        self
    }

    /// All inputs, the first one first.
    #[must_use]
    pub fn inputs(&self) -> Vec<&[f64]> {
        std::iter::once(&self.input).chain(self.more_inputs.iter().map(|channel| &channel.values)).map(Vec::as_slice).collect()
    }

    /// The file that the recording was read from: its path without the name of a part.
    #[must_use]
    pub fn file(&self) -> PathBuf {
        let text = self.path.to_string_lossy();
        match text.rsplit_once('#') {
            Some((file, _)) if !self.path.exists() => PathBuf::from(file),
            _ => self.path.clone(),
        }
    }

    /// Makes gaps of the jumps of the `sequence` column, where there is one: the device says that samples are missing there.
    pub fn mark_lost_samples(&mut self) {
        let Some(sequence) = self.extra.iter().find(|column| column.name == "sequence") else { return };
        let lost = (1..sequence.values.len()).filter(|&index| sequence.values[index] > sequence.values[index - 1] + 1.0);
        let lost: Vec<usize> = lost.collect();
        self.gaps.extend(lost);
        self.gaps.sort_unstable();
        self.gaps.dedup();
    }

    /// The recording with input and output exchanged, for training an inverse: beside each sample of what was the input stands what became
    /// of it `look_ahead_s` later. The end of each stretch, whose consequences were not recorded, is left out.
    ///
    /// # Errors
    /// When no stretch is longer than that.
    pub fn exchanged(&self, look_ahead_s: f64) -> Result<Self, RecordingError> {
        let ahead = (look_ahead_s / self.sample_period_s).round().max(0.0) as usize;
        let kept: Vec<usize> = self.segments().into_iter().flat_map(|segment| segment.start..segment.end.saturating_sub(ahead)).collect();
        let pick = |values: &[f64], ahead: usize| kept.iter().map(|index| values[index + ahead]).collect();
        let (input, output) = (self.output_signal.clone(), self.input_signal.clone());
        let mut exchanged = Self::new(&self.path, input, output, pick(&self.time_s, 0), pick(&self.output, ahead), pick(&self.input, 0))?;
        exchanged.sha256.clone_from(&self.sha256);
        exchanged.group.clone_from(&self.group);
        Ok(exchanged)
    }

    /// The first `count` samples; `None` when fewer than two are left.
    #[must_use]
    pub fn until(&self, count: usize) -> Option<Self> {
        let count = count.min(self.len());
        if count < 2 {
            return None;
        }
        let mut head = self.clone();
        head.time_s.truncate(count);
        head.input.truncate(count);
        head.output.truncate(count);
        head.more_inputs.iter_mut().for_each(|channel| channel.values.truncate(count));
        head.extra.iter_mut().for_each(|column| column.values.truncate(count));
        head.gaps.retain(|&gap| gap < count);
        Some(head)
    }

    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Whether there is no sample; never the case for a recording that was read.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// The stretches between gaps as index ranges, in order; one stretch when there is no gap.
    #[must_use]
    pub fn segments(&self) -> Vec<std::ops::Range<usize>> {
        let starts = std::iter::once(0).chain(self.gaps.iter().copied());
        let ends = self.gaps.iter().copied().chain(std::iter::once(self.len()));
        starts.zip(ends).map(|(start, end)| start..end).collect()
    }

    /// How even the clock is.
    #[must_use]
    pub fn timing(&self) -> Timing {
        let mut steps: Vec<f64> = self.time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_unstable_by(f64::total_cmp);
        let median = steps.get(steps.len() / 2).copied().unwrap_or(self.sample_period_s);
        let uneven = steps.iter().filter(|&&step| (step - median).abs() > 0.05 * median).count();
        Timing {
            median_step_s: median,
            shortest_step_s: steps.first().copied().unwrap_or(median),
            longest_step_s: steps.last().copied().unwrap_or(median),
            uneven_share: uneven as f64 / steps.len().max(1) as f64,
            gaps: self.gaps.len(),
        }
    }
}

/// The family of a file: the leading word of its name, without a running number. `a_03.csv` and `a3.csv` are of family `a`.
fn family(path: &Path) -> String {
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let word = stem.split(['_', ' ', '.']).next().unwrap_or_default();
    let bare = word.trim_end_matches(|character: char| character.is_ascii_digit());
    if bare.len() == 1 { bare.to_owned() } else { word.to_owned() }
}
