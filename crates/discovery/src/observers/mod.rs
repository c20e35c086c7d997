//! Observers of what jumps: each sample predicted from those before it.

pub mod jumps;
pub mod law;
pub mod stick_slip_filter;
pub mod valve_filter;
