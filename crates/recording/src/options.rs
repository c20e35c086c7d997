//! How recordings are to be read: what the user said about their columns and their clock.

/// What [`super::load_with`] needs to know beside the paths.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// The text of a [`super::ColumnMap`]; absent for our own files.
    pub columns: Option<String>,
    /// Sampling rate in Hz: the clock is made from it and no time column is read.
    pub rate_hz: Option<f64>,
}

impl ReadOptions {
    /// Options with a map of columns only.
    #[must_use]
    pub fn columns(columns: Option<&str>) -> Self {
        Self { columns: columns.map(str::to_owned), rate_hz: None }
    }
}
