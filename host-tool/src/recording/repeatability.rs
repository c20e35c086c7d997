//! What a rig repeats: the error that no model of the input's history can get below.

use super::Recording;

/// How well a rig repeats, in the unit of the output.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Repeatability {
    /// Standard deviation of the sensor's noise: what changes from sample to sample.
    pub noise: f64,
    /// Root mean square of what differs when the input's history repeats; absent where nothing repeats.
    pub repeatability: Option<f64>,
    /// The same between groups alone (days, loads), where there are groups.
    pub between_groups: Option<f64>,
    /// How it was found, or why it could not be, in words.
    pub method: String,
    /// Pairs of samples with a like history that were compared.
    pub pairs: usize,
}

/// Estimates noise and repeatability of recordings of one rig.
#[must_use]
pub fn estimate(recordings: &[Recording]) -> Repeatability {
    let _ = recordings;
    Repeatability { noise: 0.0, repeatability: None, between_groups: None, method: "not estimated".to_owned(), pairs: 0 }
}
