//! What a step found: figures with their intervals, settings, curves.

use serde::Serialize;

use super::kind::Kind;
use crate::Estimate;

/// A figure that was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quantity {
    /// What it is.
    pub name: &'static str,
    /// Its value and interval.
    #[serde(flatten)]
    pub estimate: Estimate,
    /// Its unit.
    pub unit: &'static str,
}

/// A curve to draw: dots that were measured, and the line through them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    /// What it shows.
    pub title: &'static str,
    /// Quantity and unit to the right.
    pub horizontal: &'static str,
    /// Quantity and unit upwards.
    pub vertical: &'static str,
    /// What was measured.
    pub measured: Vec<(f64, f64)>,
    /// The line through it.
    pub fitted: Vec<(f64, f64)>,
    /// Measured less fitted, at the same places.
    pub residuals: Vec<(f64, f64)>,
}

/// What came of a step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What was calibrated.
    pub kind: Kind,
    /// The figures.
    pub quantities: Vec<Quantity>,
    /// Settings of the device by name, and what they should be.
    pub settings: Vec<(&'static str, f64)>,
    /// The curves.
    pub curves: Vec<Curve>,
    /// What the person at the rig should know.
    pub warnings: Vec<String>,
}

impl Finding {
    /// A figure by name.
    #[must_use]
    pub fn quantity(&self, name: &str) -> Option<&Quantity> {
        self.quantities.iter().find(|quantity| quantity.name == name)
    }
}
