//! How recordings are to be read: what the user said about their columns and their clock, and what is done before anybody sees them.

/// What [`super::load_with`] needs to know beside the paths.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// The text of a [`super::ColumnMap`]; absent for our own files.
    pub columns: Option<String>,
    /// Sampling rate in Hz: the clock is made from it and no time column is read.
    pub rate_hz: Option<f64>,
    /// Keeps the units of the file where a map would convert them.
    pub keep_units: bool,
    /// What is done to each recording.
    pub prepare: Prepare,
}

/// What is done to each recording after reading: first the clock, then the start, then the zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Prepare {
    /// Puts recordings onto an even clock.
    pub resample: Option<Resample>,
    /// Seconds that are left out at the start of each recording.
    pub skip_s: f64,
    /// Sets the zero of the output to its mean over so many seconds at the (remaining) start of each recording; 0 takes the first sample.
    pub tare_s: Option<f64>,
}

/// Onto which clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Resample {
    /// The period that suits most samples of all recordings.
    Common,
    /// This period, in s.
    Period(f64),
}

impl ReadOptions {
    /// Options with a map of columns only.
    #[must_use]
    pub fn columns(columns: Option<&str>) -> Self {
        Self { columns: columns.map(str::to_owned), ..Self::default() }
    }
}
