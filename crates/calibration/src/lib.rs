//! Calibration of a rig's sensors and its valve from measurements, and the sequence of steps that makes them.
//!
//! Terms. A *reference* is what is known without the rig: distances of a target, readings of a gauge. A *code* is what the converter gives for a
//! sensor. The *zero* of a sensor is what it reads at a reference of zero, its *span* the reading per reference. The *dead band* of a valve is the
//! drive below which no pressure comes; its *hysteresis* the difference of drive between rising and falling at the same pressure. The *dead time* and
//! *time constant* of a response are those of the first-order response that fits it best.
//!
//! [`step::Step`] does no input or output: it says what to do next ([`step::Instruction`]), takes what came of it, and ends in a
//! [`step::Finding`]. Whoever drives a rig, a command line or a page in a browser, carries the instructions out.
//!
//! Every interval is a 95 % interval by Student's t around least squares; derived quantities get theirs by the delta method.

mod error;
mod estimate;
pub mod least_squares;
pub mod line;
pub mod noise;
pub mod response;
pub mod step;
pub mod valve;

pub use error::CalibrationError;
pub use estimate::Estimate;
