//! The registers behind the board's traits; target only.
//!
//! Each type owns the peripheral that it drives. Exceptions are the port bits, which the chip sets and resets one by one in a single write, and
//! [`crash`], which must reach the outputs whoever owns them.

pub mod clock;
pub mod crash;
pub mod drives;
pub mod entry;
pub mod flash;
pub mod memory;
pub mod models;
pub mod pins;
pub mod sampling;
pub mod serial;
pub mod supply;
pub mod watchdog;

pub use stm32f4::stm32f405 as pac;

use crate::board::tick_task::{Hands, TickTask};
use crate::seam::PwmValve;

/// The tick's task with the board's hands.
pub type BoardTask = TickTask<
    'static,
    Hands<
        sampling::Sampler,
        drives::AnalogueDrive,
        PwmValve<drives::PulseDrive>,
        pins::DumpPin,
        pins::StopPin,
        watchdog::Timer,
        sampling::Cycles,
        crash::Keeper,
    >,
>;
