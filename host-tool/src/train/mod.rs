//! Fitting networks to recordings: data preparation, schedules, checkpoints.

mod barrier;
pub mod optimizer;
pub mod team;
