//! Excitation: what is played to the rig, as TOML files, checked against the rig's limits before anything runs.
//!
//! Terms. A *signal* is one shape of pressure over time; a *segment* plays a signal for a time; an *excitation* is a row of segments
//! sampled evenly, plus the uniform noise that the paper adds to its commands. [`Limits`] belong to the rig, not to the file: an
//! excitation cannot raise its own limit.
//!
//! Sampling convention: sample `k` lies at `k` sample periods, so 20 s at 0.02 s are exactly 1000 samples, 0 to 19.98 s, as a sampled
//! system records them (the paper's "1000 data points evenly distributed over 20 s"; the end point belongs to the next sample).

mod config;
mod error;
mod files;
mod limits;
mod path;
pub mod sets;
mod signal;

pub use config::{ExcitationConfig, Samples, Segment};
pub use error::ExcitationError;
pub use files::{read, to_toml};
pub use limits::Limits;
pub use signal::{Anchor, MAX_SAMPLES, Signal};

#[cfg(test)]
mod tests;
