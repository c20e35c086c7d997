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
//!
//! # Example
//! ```
//! use calibration::line::Line;
//!
//! // A laser at four distances of a target: volts at millimetres.
//! let laser = Line::through(&[(0.0, 0.502), (5.0, 1.499), (10.0, 2.501), (15.0, 3.498)])?;
//! assert!((laser.zero().value - 0.5).abs() < 0.01);
//! assert!((laser.span().value - 0.2).abs() < 0.001);
//! // Back from a reading to the distance.
//! assert!((laser.reference(2.0).value - 7.5).abs() < 0.05);
//! # Ok::<(), calibration::CalibrationError>(())
//! ```

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
