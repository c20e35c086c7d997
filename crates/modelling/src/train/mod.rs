//! Fitting networks to recordings: data preparation, schedules, checkpoints.
//!
//! [`train`] does all of it; [`config::TrainConfig`] has every setting.

pub mod augment;
mod barrier;
pub mod blocks;
pub mod checkpoint;
pub mod config;
pub mod eigenbasis;
mod fit;
pub mod front_end;
mod hybrid;
pub mod optimizer;
pub mod quantised;
pub mod split;
pub mod stability;
pub mod team;
pub mod tracks;
mod validation;

pub use checkpoint::CheckpointPlan;
pub use config::{PRESETS, TrainConfig};
pub use fit::{Ended, Milestone, Progress, TrainError, TrainReport, train, train_split};

#[cfg(test)]
use fit::starting_network;

#[cfg(test)]
mod tests;
