//! The registers behind the board's traits; target only.
//!
//! Each type owns the peripheral that it drives. Exceptions are the port bits, which the chip sets and resets one by one in a single write, and
//! [`vent`], which must reach the outputs whoever owns them.

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

pub mod bootloader;
pub mod clock;
pub mod drives;
pub mod entry;
pub mod flash;
pub mod pins;
pub mod sampling;
pub mod serial;
mod start;
pub mod supply;
mod vent;
pub mod watchdog;

pub use stm32f4::stm32f405 as pac;

pub use start::{Peripherals, ThisBoard};
pub use vent::vent;
