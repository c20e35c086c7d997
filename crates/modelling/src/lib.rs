//! Models of a plant and what is known of them.
//!
//! Recordings go in. [`identify`] finds physics, [`train`] a [`network`], [`fit`] the whole ladder from a polynomial to both, [`discover`] the effect
//! that physics lacks, [`import`] takes networks trained elsewhere. [`physics`] holds their files, [`model`] is what all of them have in common, [`evaluate`] judges them by one rule,
//! and [`export`] takes them to the microcontroller and to C.

pub mod discover;
pub mod evaluate;
pub mod export;
pub mod fit;
pub mod identify;
pub mod import;
pub mod model;
pub mod network;
mod parallel;
pub mod physics;
pub mod train;
