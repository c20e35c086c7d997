//! From a trained `f32` model to the fixed-point blob, with proof and error report.
//!
//! [`export`] runs the calibration data through an `f64` reference of the model to learn the ranges and second moments that each layer
//! meets, quantises in both ways that [`model_export::quantise`] offers and keeps the closer one, adds golden vectors from the
//! reference, and measures the finished blob, as the firmware's estimator runs it, against the `f32` model.

mod blob;
pub mod c;
mod calibrate;
mod error;
mod forms;
mod report;
mod single;
mod summary;
#[cfg(test)]
mod tests;
mod work;

pub mod reference;

pub use blob::{Export, as_the_model_sees, export, export_told, export_with};
pub use calibrate::Calibration;
pub use error::ExportError;
pub use forms::{float_network, from_fitted, from_physics};
pub use report::{Comparison, LayerReport, SignalReport};
pub use summary::{Summary, hexadecimal};
