//! The steps of a calibration, each a sequence of instructions and what came of them. No input or output happens here.
//!
//! ```text
//! Step::new(kind, plan) ─► explanation() ─► next() ─► Instruction ─► (somebody carries it out) ─► take(Measurement) ─► next() ... ─► finding()
//! ```
//!
//! What a step measures above the ceiling is nothing: pressures are approached from below, each level only as far as the gauge's readings so far
//! say that the true pressure stays below [`Plan::highest_share`] of the ceiling, and a reading above the ceiling ends the step.

mod finding;
mod findings;
mod kind;
mod plan;
mod sequence;

pub use finding::{Curve, Finding, Quantity};
pub use kind::Kind;
pub use plan::{Instruction, Measurement, Plan, Sample, SensorMap};
pub use sequence::Step;
