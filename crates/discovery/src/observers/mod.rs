//! Observers of what jumps: each sample predicted from those before it.

pub mod jumps;
pub mod law;
pub mod tip_jumps;
pub mod valve_jumps;
