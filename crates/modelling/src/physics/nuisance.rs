//! Nuisances by name: what moved the output of recordings and is no part of the model.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Kinds of nuisances.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A constant of each recording.
    Zero,
    /// A zero that moves evenly with session time, or from recording to recording.
    Drift,
    /// A zero that answers to the temperature.
    Temperature,
    /// A zero that changes at one place in a recording.
    Step,
}

impl fmt::Display for Kind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Zero => "zero of each recording",
            Self::Drift => "drift",
            Self::Temperature => "temperature",
            Self::Step => "step in a recording",
        })
    }
}

/// What a nuisance was in one recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Value {
    /// File name of the recording.
    pub recording: String,
    /// How far it moves this recording's output above the model's, in the output's unit; of a step: what lies behind it above what lies
    /// before it.
    pub value: f64,
    /// Where: time of a step in s; mean session time or temperature of the recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at: Option<f64>,
}

/// One nuisance: decided by the data, listed, and no part of the simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Nuisance {
    /// Which.
    pub kind: Kind,
    /// Unit of `mean`, `spread` and the values: the output's.
    pub unit: String,
    /// Of zeros: their mean, which is the model's constant. Of the others: what they move the mean recording by, which is nothing but for
    /// steps.
    pub mean: f64,
    /// Standard deviation of the values over the recordings.
    pub spread: f64,
    /// What one unit of session time or temperature moves the output by.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub per: Option<Slope>,
    /// One value a recording; of steps, those recordings that have one.
    pub values: Vec<Value>,
}

/// A coefficient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Slope {
    /// The coefficient.
    pub slope: f64,
    /// Its unit.
    pub unit: String,
    /// Value of session time in h, temperature, or number of the recording where the model stands.
    pub about: f64,
}

impl Nuisance {
    /// What it is, in one sentence without a full stop.
    #[must_use]
    pub fn sentence(&self) -> String {
        let number = |value: f64| output::text::number(value, 3);
        let unit = &self.unit;
        match (self.kind, &self.per) {
            (Kind::Zero, _) => {
                format!(
                    "each recording has a zero of its own: standard deviation {} {unit} about the model\u{2019}s {} {unit}",
                    number(self.spread),
                    number(self.mean)
                )
            }
            (kind, Some(per)) => {
                let what = if kind == Kind::Temperature { "the zero answers to the temperature" } else { "the zero drifts" };
                format!("{what}: {} {}, and the model stands at {}", number(per.slope), per.unit, number(per.about))
            }
            (_, None) => {
                let each: Vec<String> = (self.values.iter())
                    .map(|one| format!("{} by {} {unit} at {} s", one.recording, number(one.value), number(one.at.unwrap_or(0.0))))
                    .collect();
                format!("the zero steps in the middle of {} recording(s): {}", each.len(), each.join(", "))
            }
        }
    }
}
