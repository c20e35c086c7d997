//! Fitting networks to recordings: data preparation, schedules, checkpoints.
//!
//! [`train`] does all of it; [`config::TrainConfig`] has every setting.

pub mod augment;
mod barrier;
pub mod batch;
pub mod blocks;
mod budget;
pub mod checkpoint;
pub mod config;
pub mod eigenbasis;
mod fit;
pub mod front_end;
mod hybrid;
pub mod optimizer;
pub mod quantised;
mod report;
mod run;
pub mod shares;
pub mod split;
pub mod stability;
mod start;
pub mod team;
pub mod tracks;
mod validation;

pub use checkpoint::CheckpointPlan;
pub use config::{PRESETS, TrainConfig};
pub use fit::{train, train_split};
pub use report::{Ended, Milestone, Progress, TrainError, TrainReport};

#[cfg(test)]
use start::starting_network;

#[cfg(test)]
mod tests;
