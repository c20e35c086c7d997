//! What a model promises for the next recording.

use serde::{Deserialize, Serialize};

/// What the next recording may bring, and how it was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expected {
    /// Mean error on recordings that took no part, in the output's unit.
    pub rmse: f64,
    /// Central 95 % prediction interval for the error on the next recording.
    pub interval: [f64; 2],
    /// What was left out, in words.
    pub left_out: String,
    /// The same with the zero set at the start of the recording; absent where blocks were left out, whose starts are no start-up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibrated: Option<Calibrated>,
}

/// What the next recording may bring when its zero is set at its start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibrated {
    /// Seconds at the start that set the zero and do not count.
    pub calibrate_s: f64,
    /// Mean error on recordings that took no part, in the output's unit.
    pub rmse: f64,
    /// Central 95 % prediction interval for the error on the next recording.
    pub interval: [f64; 2],
}
