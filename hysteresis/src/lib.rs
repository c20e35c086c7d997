//! Hysteresis operators and the effects that travel with them.
#![no_std]
#![forbid(unsafe_code)]

#[allow(dead_code)]
mod error;
#[allow(dead_code)]
mod list;
mod operator;
mod real;

pub mod dead_time;
pub mod lag;
pub mod play;
pub mod stop;

pub use dead_time::{DeadTime, DeadTimeState};
pub use error::Error;
pub use lag::{Hold, Lag, LagConfig, LagState};
pub use operator::Operator;
pub use play::Play;
pub use real::Real;
pub use stop::Stop;
