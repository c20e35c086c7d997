//! How recordings are to be read: what the user said about their columns and their clock, and what is done before anybody sees them.

use super::{ColumnMap, RecordingError};

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

    /// The map of columns that the options ask for.
    ///
    /// # Errors
    /// When the text is no map, the rate is none, or neither names a clock.
    pub fn map(&self) -> Result<ColumnMap, RecordingError> {
        let mut map = self.columns.as_deref().map_or_else(|| Ok(ColumnMap::own()), ColumnMap::parse)?;
        if self.keep_units {
            map = map.keeping_units();
        }
        if let Some(rate_hz) = self.rate_hz {
            if !(rate_hz.is_finite() && rate_hz > 0.0) {
                return Err(RecordingError::Rate { rate_hz });
            }
            (map.rate_hz, map.unused_time) = (Some(rate_hz), map.time.take().map(|time| time.header));
        } else if map.time.is_none() {
            let text = self.columns.clone().unwrap_or_default();
            let problem = "`time` is missing; name the time column, or say the sampling rate with --rate-hz".to_owned();
            return Err(RecordingError::Columns { text, problem });
        }
        Ok(map)
    }
}
