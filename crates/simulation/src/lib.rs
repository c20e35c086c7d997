//! Data without a rig: [`excitation`] makes pressures over time, [`plant`] turns them into recordings.
//!
//! # Example
//! ```
//! use simulation::excitation::{ExcitationConfig, Limits, Segment, Signal};
//!
//! let hold = Segment { duration_s: 0.1, signal: Signal::Hold { pressure_bar: 1.5 } };
//! let excitation = ExcitationConfig { sample_period_s: 0.02, noise_bar: 0.0, seed: 1, segments: vec![hold] };
//! let samples = excitation.sample_within(&Limits::default()).expect("within 0 to 3 bar");
//! assert!(samples.pressure_bar.iter().all(|pressure_bar| *pressure_bar == 1.5));
//!
//! let too_high = Limits { maximum_bar: 1.0, ..Limits::default() };
//! assert!(excitation.sample_within(&too_high).is_err());
//! ```

pub mod excitation;
pub mod plant;
