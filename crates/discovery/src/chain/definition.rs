//! An effect as a laboratory writes it down in a TOML file.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// What kind of law it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    /// A curve without memory.
    StaticMap,
    /// A first-order differential equation.
    FirstOrder,
    /// A law of the operators' thresholds.
    Threshold,
    /// A further column of the output.
    Column,
}

/// On which side of the hysteresis it acts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Side {
    /// Before it.
    #[default]
    Pressure,
    /// Behind it.
    Displacement,
}

/// What a parameter is measured in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Unit {
    /// A number.
    #[default]
    Ratio,
    /// Time, s.
    S,
    /// Frequency, Hz.
    Hz,
    /// A share of the input's span, reported in the input's unit.
    Input,
    /// A share of the output's span, reported in the output's unit.
    Output,
}

/// The range of a parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
    /// Unit.
    #[serde(default)]
    pub unit: Unit,
}

/// An effect as a laboratory writes it down.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Definition {
    /// Name in results, in lower case with hyphens.
    pub name: String,
    /// What tells this form from others of the same name.
    #[serde(default = "of_a_file")]
    pub form: String,
    /// Kind of law.
    pub shape: Shape,
    /// Side of the hysteresis; a threshold law has none, a column is on the displacement's.
    #[serde(default)]
    pub side: Side,
    /// The law.
    pub law: String,
    /// Its parameters.
    #[serde(default)]
    pub parameters: BTreeMap<String, Range>,
}

fn of_a_file() -> String {
    "of a file".to_owned()
}
