//! The registers behind the board's traits; target only.
//!
//! Each type owns the peripheral that it drives. Exceptions are the port bits, which the chip sets and resets one by one in a single write, and
//! [`crash`], which must reach the outputs whoever owns them.

/// Switches peripherals' clocks on and waits until they have arrived: a register that is written before that loses the write (errata ES0182,
/// delay after an RCC peripheral clock enabling). The only place where clocks are switched on; a test holds that.
macro_rules! enable_clock {
    ($rcc:ident.$register:ident: $($bit:ident),+) => {{
        $rcc.$register().modify(|_, w| w$(.$bit().set_bit())+);
        // Through the bus and back, which is longer than the two cycles of the bus's clock that it takes.
        let _ = $rcc.$register().read().bits();
        cortex_m::asm::dsb();
    }};
}

pub mod clock;
pub mod crash;
pub mod drives;
pub mod entry;
pub mod flash;
pub mod memory;
pub mod models;
pub mod pins;
pub mod protection;
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
