//! What a device tells of its adaptation: zero and gain of the estimate, and why they stand still if they do.
//!
//! # Example
//! ```
//! use model_export::link::adaptation::{AdaptationReport, Adapting};
//!
//! let report = AdaptationReport { adapting: Adapting::ZeroOnly, zero_mm: -0.25, gain: 1.0, updates: 70_000 };
//! assert_eq!(Adapting::ALL[2], report.adapting);
//! ```

use serde::{Deserialize, Serialize};

/// What adaptation did in the last window. The order is the wire format: append, never insert.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Adapting {
    /// It is switched off.
    #[default]
    Off,
    /// Zero and gain followed the laser.
    Both,
    /// Only the zero did: the tip moves too little to tell a gain.
    ZeroOnly,
    /// Frozen: the device does not run.
    NotRunning,
    /// Frozen: the limiter held the output back.
    Limited,
    /// Frozen: the laser is lost, rejected, saturated or stands still.
    NoLaser,
    /// Frozen: there is no estimate.
    NoEstimate,
    /// Frozen: the model's input is outside of what it was trained on.
    OutsideDomain,
    /// Frozen: laser and adapted estimate differ by more than the gate.
    Implausible,
}

impl Adapting {
    /// All, in the order of their wire numbers.
    pub const ALL: [Self; 9] = [
        Self::Off,
        Self::Both,
        Self::ZeroOnly,
        Self::NotRunning,
        Self::Limited,
        Self::NoLaser,
        Self::NoEstimate,
        Self::OutsideDomain,
        Self::Implausible,
    ];
}

/// What adaptation learned since it was reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AdaptationReport {
    /// What the last window did.
    pub adapting: Adapting,
    /// What is added to the estimate at the pivot, mm.
    pub zero_mm: f32,
    /// Factor on the estimate's distance from the pivot.
    pub gain: f32,
    /// Windows that were learned from.
    pub updates: u32,
}
