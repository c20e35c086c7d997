//! What reading a recording found and did, in words for a person.

/// What a note is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Subject {
    /// How the text is laid out: separator, title lines, decimal commas.
    Layout,
    /// The clock comes from a rate, not from a column.
    Rate,
    /// Time stamps were repaired.
    ClockRepaired,
    /// The clock logs events: samples stand only where something changed.
    EventClock,
    /// Samples are missing.
    Gap,
    /// The recording was put onto an even clock.
    Resampled,
    /// An input is a staircase that refreshes at a fixed period.
    SampleAndHold,
    /// A channel has coarse steps.
    Quantised,
    /// A channel rests at its extreme.
    Clipped,
    /// A channel does not change for a long time, or never.
    Constant,
    /// A unit does not go with the values.
    Unit,
    /// Values were converted into another unit.
    Converted,
    /// Samples at the start were left out, or the zero of the output was moved.
    Prepared,
    /// The output's zero jumps and the input does not explain it.
    Step,
    /// The output's zero moves slowly and the input does not explain it.
    Drift,
}

/// One finding or deed of reading, said once.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Note {
    /// What it is about.
    pub subject: Subject,
    /// How often it was found; 1 for what holds for the whole recording.
    pub count: usize,
    /// The first line of the file it concerns, where there is one.
    pub line: Option<u64>,
    /// A sentence or two.
    pub text: String,
}

impl Note {
    /// A note on the whole recording.
    #[must_use]
    pub fn new(subject: Subject, text: impl Into<String>) -> Self {
        Self { subject, count: 1, line: None, text: text.into() }
    }

    /// A note on `count` places, the first at `line`.
    #[must_use]
    pub fn counted(subject: Subject, count: usize, line: u64, text: impl Into<String>) -> Self {
        Self { subject, count, line: Some(line), text: text.into() }
    }
}
