//! The rig's flash image on a register-level model of its chip, in lock step with whoever simulates what is around it.
//!
//! The image is the file that `cargo xtask flash` writes to the board, byte for byte. Its processor, clock tree, converters, timers, line,
//! watchdog and flash are models written against the reference manual: those of the crate `rigless` for the chip's sibling, and those in
//! [`chip`] for what these lack. Time is virtual and exact; [`protocol`] says how it passes.
#![warn(missing_docs)]
#![deny(unsafe_code)]

pub mod board;
pub mod boards;
pub mod chip;
pub mod core;
pub mod line;
pub mod log;
pub mod machine;
pub mod part;
pub mod protocol;
pub mod stm32h743;
pub mod touched;
