//! Physics models and their files: what identification writes, and what everything else reads.
//!
//! An identified model is a [`PhysicsModel`]; a weighted sum of columns, as `catheter fit` finds it, is a [`FittedModel`]. Both are TOML with units
//! and provenance, run freely from the equilibrium of the first sample, and know nothing of how they were found. [`chip`] turns the second
//! into the first where the microcontroller's front end has a form for it.

pub mod chip;
mod expected;
pub mod fitted;
mod input_path;
mod model;
pub mod nuisance;
mod points;
mod stages;

pub use expected::{Calibrated, Expected};
pub use fitted::FittedModel;
pub use input_path::input_path;
pub(crate) use model::range;
pub use model::{ChannelRange, CreepFilters, Curve, FORMAT_VERSION, InputPath, Kind, ModelError, PhysicsModel, Provenance, Source};
pub use points::Points;
pub use stages::{Filter, Flow, Stages, ThresholdGrowth};
