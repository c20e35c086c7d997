//! Models of a plant and what is known of them.
//!
//! Recordings go in. [`identify`] finds physics, [`train`] a [`network`], [`fit`] the whole ladder from a polynomial to both, [`discover`] the effect
//! that physics lacks, [`import`] takes networks trained elsewhere. [`physics`] holds their files, [`model`] is what all of them have in common, [`evaluate`] judges them by one rule,
//! and [`export`] takes them to the microcontroller and to C.
//!
//! # Example
//! ```
//! use modelling::identify::{FitConfig, fit};
//! use simulation::excitation::Limits;
//! use simulation::excitation::sets::SetConfig;
//! use simulation::plant::dataset::{Dataset, SetKind};
//! use simulation::plant::{Plant, PlantConfig};
//!
//! // Recordings of a simulated actuator, and the play operators identified from them.
//! let plant = Plant::new(PlantConfig::default()).expect("a plant");
//! let set = Dataset::simulate(SetKind::Paper, &SetConfig::default(), &Limits::default(), &plant, std::path::Path::new("set")).expect("a set");
//! let training: Vec<_> = set.part("train").cloned().collect();
//! let found = fit(&training, &FitConfig::default())?;
//! assert_eq!(found.model.thresholds.len(), 5, "the plant has five play operators");
//! assert!(found.rmse < 1e-10, "in mm, without noise");
//! # Ok::<(), modelling::identify::IdentifyError>(())
//! ```

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
