//! What whoever opens a session brings to it.

use calibration::step::Finding;

use crate::calibrate::Change;

/// A controller that can be chosen.
#[derive(Clone, Copy, Debug)]
pub struct Controller {
    /// Its name.
    pub name: &'static str,
    /// `control.feed_forward`.
    pub feed_forward: u32,
    /// `control.sensor`.
    pub sensor: u32,
}

/// What a session offers beyond the link; it comes from whoever opens it.
#[derive(Clone, Copy)]
pub struct Offers {
    /// Controllers.
    pub controllers: &'static [Controller],
    /// Names of the references.
    pub references: &'static [&'static str],
    /// Time between two points of a reference, s; whole milliseconds.
    pub reference_period_s: f64,
    /// Points of a reference by name, within a lowest and a highest displacement, mm, with a seed.
    pub reference: fn(&str, [f64; 2], u64) -> Option<Vec<f64>>,
    /// The printable page of a calibration: board, firmware, whether it is saved, findings and changed settings.
    pub calibration_page: fn(&str, &str, bool, &[Finding], &[Change]) -> String,
}
