//! How recordings are read: the options that every command with recordings takes, and what it says about its choices.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use super::lab;
use crate::recording::{self, Prepare, ReadOptions, Recording, Resample, Subject};
use crate::{output, say};

/// What columns mean, and what is done to recordings before they are used.
#[derive(Args, Clone, Debug, Default)]
pub struct Reading {
    /// Column names of foreign files, for example `time=t_s,input=voltage_V,output=displacement_um`. A unit behind a colon becomes bar, mm
    /// or s (`input=P:kPa`); so does a calibration (`output=laser:mA@4..20=0..50mm`). `own` are our own names, where `catheter.toml` has others.
    #[arg(long, value_name = "MAP", help_heading = READING)]
    pub columns: Option<String>,
    /// Sampling rate of files without a time column.
    #[arg(long, value_name = "HZ", help_heading = READING)]
    pub rate_hz: Option<f64>,
    /// Keep the units of the files, whatever stands behind a colon.
    #[arg(long, help_heading = READING)]
    pub keep_units: bool,
    /// Leave the first seconds of each recording out. `identify` and `evaluate` still let the model see them.
    #[arg(long, value_name = "S", value_parser = seconds, help_heading = READING)]
    pub skip_s: Option<f64>,
    /// Set the zero of each recording's output at its start, by its first sample that counts or by the mean over S seconds from there.
    /// `evaluate` shifts the prediction instead.
    #[arg(long, value_name = "S", num_args = 0..=1, require_equals = true, default_missing_value = "0", value_parser = seconds, help_heading = READING)]
    pub tare: Option<f64>,
    /// Put recordings onto an even clock: of S seconds, or of the period that suits them; `evaluate` takes the model's period.
    #[arg(long, value_name = "S", num_args = 0..=1, require_equals = true, default_missing_value = "auto", value_parser = period, help_heading = READING)]
    pub resample: Option<Period>,
}

/// Heading of these options in the help.
const READING: &str = "How recordings are read";

/// An even clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Period(pub Resample);

/// Zero or more seconds.
///
/// # Errors
/// For anything else.
pub fn seconds(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| value.is_finite() && *value >= 0.0);
    value.ok_or_else(|| "zero or a positive number of seconds is wanted".to_owned())
}

fn period(text: &str) -> Result<Period, String> {
    if text == "auto" {
        return Ok(Period(Resample::Common));
    }
    let value = text.parse().ok().filter(|value: &f64| value.is_finite() && *value > 0.0);
    value.map(|value| Period(Resample::Period(value))).ok_or_else(|| "a positive number of seconds is wanted, or nothing".to_owned())
}

impl Reading {
    /// What was given here, else what the lab's `catheter.toml` says.
    ///
    /// # Errors
    /// When that file is none.
    pub fn or_lab(&self) -> Result<Self> {
        let Some(lab) = lab::find()? else { return Ok(self.clone()) };
        let lab = lab.recordings;
        // A map of columns and the rate that replaces its clock belong together.
        let (columns, rate_hz) = match (&self.columns, self.rate_hz) {
            (None, None) => (lab.columns, lab.rate_hz),
            (columns, rate_hz) => (columns.clone(), rate_hz),
        };
        Ok(Self {
            columns,
            rate_hz,
            keep_units: self.keep_units || lab.keep_units,
            skip_s: self.skip_s.or(lab.skip_s),
            tare: self.tare.or(lab.tare_s),
            resample: self.resample.or(lab.resample_s.map(|period_s| Period(Resample::Period(period_s)))),
        })
    }

    /// How the recordings are to be read, for a command that leaves nothing else to do.
    ///
    /// # Errors
    /// As [`Self::or_lab`].
    pub fn options(&self) -> Result<ReadOptions> {
        let reading = self.or_lab()?;
        let prepare = Prepare {
            resample: reading.resample.map(|Period(resample)| resample),
            skip_s: reading.skip_s.unwrap_or(0.0),
            tare_s: reading.tare,
        };
        Ok(ReadOptions { columns: reading.columns, rate_hz: reading.rate_hz, keep_units: reading.keep_units, prepare })
    }

    /// Seconds at the start that do not count, for a command whose model sees them.
    ///
    /// # Errors
    /// As [`Self::or_lab`].
    pub fn skipped_s(&self) -> Result<f64> {
        Ok(self.or_lab()?.skip_s.unwrap_or(0.0))
    }

    /// Reads recordings, and says what was chosen and what is odd about them.
    ///
    /// # Errors
    /// The first problem of the first bad file.
    pub fn load(&self, paths: &[PathBuf]) -> Result<Vec<Recording>> {
        self.load_as(paths, &self.options()?)
    }

    /// The same for a command that handles start and zero itself: both are as they were recorded.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_whole(&self, paths: &[PathBuf]) -> Result<Vec<Recording>> {
        let mut options = self.options()?;
        // The command knows better which period is wanted.
        let resample = options.prepare.resample.filter(|resample| *resample != Resample::Common);
        options.prepare = Prepare { resample, ..Prepare::default() };
        self.load_as(paths, &options)
    }

    fn load_as(&self, paths: &[PathBuf], options: &ReadOptions) -> Result<Vec<Recording>> {
        let given = lab::find()?.and_then(|lab| lab.paths.recordings).filter(|_| paths.is_empty());
        let paths = match &given {
            Some(path) => std::slice::from_ref(path),
            None => paths,
        };
        anyhow::ensure!(!paths.is_empty(), "--data is missing: name recordings, or their folder; or let `catheter init` write it down");
        let recordings = recording::load_with(paths, options)?;
        for one in &recordings {
            output::detail!("read {}: {} samples, {} s apart", one.path.display(), one.len(), one.sample_period_s);
        }
        tell(&recordings);
        Ok(recordings)
    }
}

/// Whether every command tells what reading chose or found; `check` tells the rest.
pub(super) fn is_told(subject: Subject) -> bool {
    let chosen = matches!(subject, Subject::Rate | Subject::Converted | Subject::Prepared | Subject::Resampled);
    chosen || matches!(subject, Subject::ClockRepaired | Subject::Unit | Subject::Clipped)
}

/// Says what reading chose and found, each sentence once.
fn tell(recordings: &[Recording]) {
    /// Sentences that are worth a line of every command; `check` tells all.
    const MOST: usize = 12;
    let mut sentences: Vec<(&str, usize)> = Vec::new();
    for note in recordings.iter().flat_map(|recording| &recording.notes).filter(|note| is_told(note.subject)) {
        match sentences.iter_mut().find(|(text, _)| *text == note.text) {
            Some((_, count)) => *count += 1,
            None => sentences.push((&note.text, 1)),
        }
    }
    for (text, count) in sentences.iter().take(MOST) {
        let share = if *count == recordings.len() { String::new() } else { format!(" ({count} of {} recordings)", recordings.len()) };
        say!("read: {text}{share}");
    }
    if sentences.len() > MOST {
        say!("read: {} more notes; `catheter check` tells them", sentences.len() - MOST);
    }
}

/// Recordings on the command line, and how they are read.
#[derive(Args, Clone, Debug)]
pub struct Data {
    /// A recording (CSV, gzipped CSV, NPZ, MAT, MCAP) or a folder of them; may be repeated. Without it, those that `catheter.toml` names.
    #[arg(long = "data", num_args = 1.., value_name = "PATH")]
    pub data: Vec<PathBuf>,
    /// How they are read.
    #[command(flatten)]
    pub reading: Reading,
}

impl Data {
    /// How the recordings are to be read.
    ///
    /// # Errors
    /// As [`Reading::or_lab`].
    pub fn options(&self) -> Result<ReadOptions> {
        self.reading.options()
    }

    /// Reads the recordings and does to them what was asked for.
    ///
    /// # Errors
    /// The first problem of the first bad file.
    pub fn load(&self) -> Result<Vec<Recording>> {
        self.reading.load(&self.data)
    }
}
