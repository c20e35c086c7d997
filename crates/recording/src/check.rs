//! What there is to say about recordings before anything is fitted to them: clock, channels, zero, and what the rig repeats.

use std::path::PathBuf;

use serde::Serialize;

use super::condition::{self, short};
use super::drift::{self, Moved, Offsets};
use super::held::{self, Hold};
use super::repeatability::{self, Repeatability};
use super::{Note, Recording, Subject, Timing, clock, groups, resample};

/// What was found out about a set of recordings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// Each recording.
    pub recordings: Vec<Checked>,
    /// The period that a fit would put all of them on, in s.
    pub common_period_s: f64,
    /// Sensor noise, and what the rig repeats.
    pub repeatability: Repeatability,
    /// How the recordings would be left out for cross-validation.
    pub splits: String,
    /// What the input leaves unexplained in each recording; absent for less than three.
    pub offsets: Option<Offsets>,
}

/// What was found out about one recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Checked {
    /// The recording, with the name of its part.
    pub path: PathBuf,
    /// Its group, where something shows one.
    pub group: String,
    /// Number of samples.
    pub samples: usize,
    /// From the first to the last sample, in s.
    pub duration_s: f64,
    /// How even the clock is.
    pub clock: Timing,
    /// What a fit would do to the clock, in words.
    pub resampling: String,
    /// Inputs and output.
    pub channels: Vec<CheckedChannel>,
    /// Columns that are carried along.
    pub carried: Vec<String>,
    /// A step or drift of the zero that the input does not explain, where it is clear.
    pub moved: Option<Moved>,
    /// What reading and looking found.
    pub notes: Vec<Note>,
}

/// One input, or the output.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckedChannel {
    /// `input`, `input2`, ..., `output`.
    pub role: String,
    /// Quantity.
    pub quantity: String,
    /// Unit.
    pub unit: String,
    /// Smallest value.
    pub minimum: f64,
    /// Largest value.
    pub maximum: f64,
    /// Step size, where the values lie on a grid.
    pub resolution: Option<f64>,
    /// The staircase, where an input is one.
    pub hold: Option<Hold>,
}

/// Looks at recordings; all have the same inputs.
#[must_use]
pub fn check(recordings: &[Recording]) -> Check {
    let common_period_s = resample::common_period_s(recordings);
    Check {
        recordings: recordings.iter().map(|recording| checked(recording, common_period_s)).collect(),
        common_period_s,
        repeatability: repeatability::estimate(recordings),
        splits: groups::splits(recordings),
        offsets: drift::across(recordings),
    }
}

fn checked(recording: &Recording, period_s: f64) -> Checked {
    let moved = drift::within(recording);
    let mut notes = recording.notes.clone();
    notes.extend(moved.map(|moved| moved_note(recording, moved)));
    let resampling = match resample::check(recording, period_s) {
        Ok(()) => {
            let resampled = resample::uniform(recording, period_s);
            let note = resampled.notes.iter().find(|note| note.subject == Subject::Resampled && !recording.notes.contains(note));
            note.map_or_else(|| "The clock is even; nothing is resampled.".to_owned(), |note| note.text.clone())
        }
        Err(_) => format!("An even clock of {} s would need far more samples than there are.", short(period_s)),
    };
    Checked {
        path: recording.path.clone(),
        group: recording.group.clone(),
        samples: recording.len(),
        duration_s: recording.time_s[recording.len() - 1] - recording.time_s[0],
        clock: recording.timing(),
        resampling,
        channels: condition::channels(recording)
            .into_iter()
            .map(|(role, signal, values)| channel(recording, role, signal, values))
            .collect(),
        carried: recording.extra.iter().map(|column| column.name.clone()).collect(),
        moved,
        notes,
    }
}

fn channel(recording: &Recording, role: String, signal: &super::Signal, values: &[f64]) -> CheckedChannel {
    let minimum = values.iter().copied().fold(f64::INFINITY, f64::min);
    CheckedChannel {
        hold: if role == "output" { None } else { held::hold(&recording.time_s, values) },
        role,
        quantity: signal.quantity.clone(),
        unit: signal.unit.clone(),
        minimum,
        maximum: minimum + clock::range(values),
        resolution: condition::resolution(values),
    }
}

/// The sentence on a zero that moved.
fn moved_note(recording: &Recording, moved: Moved) -> Note {
    let unit = &recording.output_signal.unit;
    match moved {
        Moved::Step { time_s, by, .. } => {
            let text =
                format!("The output steps by {} {unit} at about {} s, and the input does not explain it.", signed(by), short(time_s));
            Note::new(Subject::Step, text)
        }
        Moved::Drift { by } => {
            let text = format!("The output drifts by {} {unit} from start to end, and the input does not explain it.", signed(by));
            Note::new(Subject::Drift, text)
        }
    }
}

fn signed(value: f64) -> String {
    let text = short(value);
    if value > 0.0 { format!("+{text}") } else { text }
}

impl Checked {
    /// Name and value of each line of the report on this recording, notes last.
    #[must_use]
    pub fn lines(&self) -> Vec<(&'static str, String)> {
        let mut lines = vec![("samples", format!("{} over {} s", self.samples, short(self.duration_s)))];
        let clock = &self.clock;
        let uneven =
            if clock.uneven_share > 0.0 { format!(", {} % of the steps uneven", short(100.0 * clock.uneven_share)) } else { String::new() };
        let (shortest, longest) = (short(1e3 * clock.shortest_step_s), short(1e3 * clock.longest_step_s));
        let steps = if shortest == longest { String::new() } else { format!(" ({shortest} to {longest} ms)") };
        lines.push(("clock", format!("steps of {} ms{steps}{uneven}, {} gap(s)", short(1e3 * clock.median_step_s), clock.gaps)));
        lines.push(("for a fit", self.resampling.clone()));
        for channel in &self.channels {
            let role = match channel.role.as_str() {
                "output" => "output",
                "input" => "input",
                _ => "more input",
            };
            lines.push((role, channel.line()));
        }
        if !self.carried.is_empty() {
            lines.push(("carried", self.carried.join(", ")));
        }
        if !self.group.is_empty() {
            lines.push(("group", self.group.clone()));
        }
        lines.extend(self.notes.iter().map(|note| ("note", note_line(note))));
        lines
    }
}

impl CheckedChannel {
    fn line(&self) -> String {
        let resolution = self.resolution.map_or_else(String::new, |step| format!(", in steps of {}", short(step)));
        let hold = match self.hold {
            Some(Hold { period_s: Some(period_s), .. }) => format!(", a staircase refreshed every {} s or a multiple", short(period_s)),
            Some(Hold { period_s: None, .. }) => ", a staircase without a fixed period".to_owned(),
            None => String::new(),
        };
        format!("{}: {} to {}{resolution}{hold}", self.quantity, short(self.minimum), condition::with_unit(self.maximum, &self.unit))
    }
}

/// A note with its first line.
fn note_line(note: &Note) -> String {
    note.line.map_or_else(|| note.text.clone(), |line| format!("{} First at line {line}.", note.text))
}

impl Check {
    /// Name and value of each line of the report on all recordings together; `unit` is the output's.
    #[must_use]
    pub fn lines(&self, unit: &str) -> Vec<(&'static str, String)> {
        let found = &self.repeatability;
        let mut lines = vec![("noise", format!("{} {unit}, standard deviation from sample to sample", short(found.noise)))];
        lines.push(match found.repeatability {
            Some(rms) => {
                ("repeatability", format!("{} {unit}, root mean square, from {} pairs: {}", short(rms), found.pairs, found.method))
            }
            None => ("repeatability", format!("not known: {}", found.method)),
        });
        if let Some(between) = found.between_groups {
            lines.push(("between groups", format!("{} {unit}, root mean square", short(between))));
        }
        if let Some(offsets) = &self.offsets {
            let drift =
                offsets.drift.map_or_else(String::new, |by| format!("; it drifts by {} {unit} from the first to the last", signed(by)));
            let text =
                format!("{} {unit}, standard deviation of the mean output that the input leaves unexplained{drift}", short(offsets.spread));
            lines.push(("offsets", text));
        }
        lines.push(("period", format!("{} s for all in a fit", short(self.common_period_s))));
        lines.push(("splits", self.splits.clone()));
        lines
    }
}
