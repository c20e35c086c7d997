//! Recordings made ready for discovery: common scales, rest, roles, outliers.
//!
//! Terms. *Role*: what a sample is used for: fitting, selecting between effects, neither until the figures at the end (kept out), or nothing.
//! *Rest*: a stretch at least 0.6 s long in which the input does not move. *Mask*: samples taken out as outliers.

use std::sync::Arc;

use recording::Signal;

use crate::data::turning::remember;

/// What a sample is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Parameters and weights are fitted to it.
    Fit,
    /// Effects are chosen by it.
    Select,
    /// Nobody looks at it until the end.
    Test,
    /// Nothing: when in it the command stepped, nobody has recorded.
    Nothing,
}

impl Role {
    /// Whether it is fitted to or chosen by.
    #[must_use]
    pub fn is_worked_with(self) -> bool {
        matches!(self, Self::Fit | Self::Select)
    }
}

/// One recording, normalised.
#[derive(Clone, Debug)]
pub struct Run {
    /// Name in reports.
    pub name: String,
    /// Name of its file.
    pub file: String,
    /// Number in the session, by start.
    pub index: usize,
    /// Which recording it is, of those given and then of those kept, and its first sample there.
    pub source: (usize, usize),
    /// SHA-256 of its file; empty where it never was one.
    pub sha256: String,
    /// Which stretch between gaps of its recording it is.
    pub part: usize,
    /// Sample period, s.
    pub period_s: f64,
    /// Input over the session's input span.
    pub input: Vec<f64>,
    /// Further inputs, each over its own span.
    pub others: Vec<Vec<f64>>,
    /// Output over the session's output span.
    pub output: Vec<f64>,
    /// Time since the session began, s.
    pub session_s: Vec<f64>,
    /// Time since the recording began, s.
    pub time_s: Vec<f64>,
    /// Role of each sample.
    pub role: Vec<Role>,
    /// Whether each sample counts.
    pub keep: Vec<bool>,
    /// Whether it takes part in the first, coarse look at every effect.
    pub screens: bool,
    /// Stretches of rest.
    pub rest: Vec<std::ops::Range<usize>>,
    /// Turning points of the input before this recording, oldest first.
    pub history: Vec<f64>,
    /// What the operators know when it begins, where a file tells; else it follows from the recordings before.
    pub beginning: Option<Beginning>,
    /// What the recordings before left in the material, where a file tells; else it follows from these recordings.
    pub earlier: Option<Earlier>,
    /// All recordings of the session (the first `index` are the earlier ones), for stages that change the input with a memory of their own:
    /// a stroke that was the widest for the command need not be the widest for what a slow valve makes of it.
    pub session: Arc<Vec<Run>>,
}

/// What operators know when a recording begins.
#[derive(Clone, Debug, PartialEq)]
pub enum Beginning {
    /// Turning points of the input as they see it, oldest first.
    After(Vec<f64>),
    /// Their states, where these hang on how fast they went.
    From(Vec<f64>),
}

/// What the input of a session's earlier recordings left in the material when a recording begins.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Earlier {
    /// How far the input has travelled, normalised.
    pub travelled: f64,
    /// The highest input, normalised.
    pub highest: f64,
    /// What lags of the input hold, normalised, for each time constant of creep: with pauses at the next start, then with pauses at the last end.
    pub creeping: Vec<f64>,
    /// Where the input of the recording before turned last, normalised, oldest first.
    #[serde(default)]
    pub turns: Vec<f64>,
}

/// Most further inputs.
pub const MOST_OTHERS: usize = 3;

/// A further input: what it is, its value that is zero and its span.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OtherInput {
    /// Quantity and unit.
    pub signal: Signal,
    /// Value that is zero in normalised units.
    pub offset: f64,
    /// Span that is one.
    pub scale: f64,
}

impl OtherInput {
    /// Values of it, normalised.
    #[must_use]
    pub fn normalised(&self, values: &[f64]) -> Vec<f64> {
        values.iter().map(|value| (value - self.offset) / self.scale).collect()
    }
}

/// A session.
#[derive(Clone, Debug)]
pub struct Session {
    /// Recordings in order of their start.
    pub runs: Vec<Run>,
    /// Input that is zero in normalised units.
    pub input_offset: f64,
    /// Input span.
    pub input_scale: f64,
    /// Further inputs.
    pub others: Vec<OtherInput>,
    /// Output span; negative when the output falls with the input.
    pub output_scale: f64,
    /// Quantity and unit of the input.
    pub input_unit: String,
    /// Unit of the output.
    pub output_unit: String,
    /// Step of a sensor that reads in steps, over the output's span; next to nothing for one that does not.
    pub output_step: f64,
    /// Session time at which the first recording began, s.
    pub origin_s: f64,
    /// Length of the session, s.
    pub length_s: f64,
    /// Whether the recordings told their place in the session.
    pub has_session_time: bool,
    /// Fastest change of the input that is not a step, spans per s.
    pub fastest_per_s: f64,
}

/// What can go wrong with the recordings.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// None at all.
    #[error("there is no recording: give --data a CSV file or a folder of CSV files")]
    Empty,
    /// Too short to learn from.
    #[error("{samples} samples are too few to find an effect in; at least 400 are needed")]
    TooShort {
        /// How many there are.
        samples: usize,
    },
    /// The input does not move.
    #[error("the input is the same everywhere ({value}); a recording with a moving input is needed")]
    StillInput {
        /// Its value.
        value: f64,
    },
    /// Other inputs than the first recording, or too many.
    #[error("{path} has the inputs {found}, the first recording has {expected}; all must have the same, four at most")]
    OtherInputs {
        /// Which.
        path: String,
        /// Its inputs.
        found: String,
        /// Those of the first recording.
        expected: String,
    },
    /// The output does not move.
    #[error("the output is the same everywhere ({value}); is the sensor connected?")]
    StillOutput {
        /// Its value.
        value: f64,
    },
    /// The given model has an effect that is not known.
    #[error("the model to start from cannot be used: {problem}")]
    Model {
        /// Why.
        problem: String,
    },
    /// A model that was found cannot be simulated.
    #[error("the model cannot be simulated on the recordings kept out: {problem}")]
    Simulation {
        /// Why.
        problem: String,
    },
    /// Different sample periods.
    #[error("{path} is sampled every {found_s} s, the others every {expected_s} s; put all onto one clock with --resample")]
    Period {
        /// Which.
        path: String,
        /// Its period.
        found_s: f64,
        /// The others' period.
        expected_s: f64,
    },
}

impl Run {
    /// Whether any of it is fitted to or chosen by.
    #[must_use]
    pub fn is_worked_with(&self) -> bool {
        self.role.iter().any(|role| role.is_worked_with())
    }

    /// Whether a sample counts in any figure.
    #[must_use]
    pub fn counts(&self, sample: usize) -> bool {
        self.keep[sample] && self.role[sample] != Role::Nothing
    }
}

impl Session {
    /// The given predictions, one for each recording and then each kept one, in output units, as one for each run, normalised.
    #[must_use]
    pub fn normalised(&self, predictions: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let of = |run: &Run| {
            let (recording, first) = run.source;
            predictions[recording][first..first + run.input.len()].iter().map(|value| value / self.output_scale).collect()
        };
        self.runs.iter().map(of).collect()
    }

    /// As [`Self::normalised`], where there is a prediction.
    #[must_use]
    pub fn normalised_where(&self, predictions: &[Option<Vec<f64>>]) -> Vec<Option<Vec<f64>>> {
        let of = |run: &Run| {
            let (recording, first) = run.source;
            let values = predictions[recording].as_ref()?.get(first..first + run.input.len())?;
            Some(values.iter().map(|value| value / self.output_scale).collect())
        };
        self.runs.iter().map(of).collect()
    }

    /// Turning points of the input that operators still remember when the session is over.
    #[must_use]
    pub fn memory(&self) -> Vec<f64> {
        let Some(last) = self.runs.last() else { return Vec::new() };
        let mut history = last.history.clone();
        remember(&mut history, &last.input);
        history
    }

    /// Lets all samples count again that are not kept out.
    pub fn unmask(&mut self) {
        for run in &mut self.runs {
            run.keep.iter_mut().zip(&run.role).for_each(|(keep, role)| *keep = *role != Role::Test);
        }
    }

    /// Recordings that are fitted to or chosen by, at least in part.
    pub fn worked(&self) -> impl Iterator<Item = &Run> {
        self.runs.iter().filter(|run| run.is_worked_with())
    }

    /// Number of samples with this role that count.
    #[must_use]
    pub fn count(&self, role: Role) -> usize {
        self.runs.iter().map(|run| run.role.iter().zip(&run.keep).filter(|&(&of, &keep)| keep && of == role).count()).sum()
    }
}
