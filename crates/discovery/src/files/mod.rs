//! The file of a discovered model, and the figures that it reproduces.

pub mod figures;
pub mod file;
pub mod separation;
mod stages;
