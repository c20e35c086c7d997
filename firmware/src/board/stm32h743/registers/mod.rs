//! The registers behind the board's traits; target only. See the STM32F405's.

/// Switches peripherals' clocks on and waits until they have arrived (RM0433 section 8.5.10: two cycles of the bus's clock). The only place
/// where clocks are switched on; a test holds that.
macro_rules! enable_clock {
    ($rcc:ident.$register:ident: $($bit:ident),+) => {{
        $rcc.$register().modify(|_, w| w$(.$bit().set_bit())+);
        let _ = $rcc.$register().read().bits();
        cortex_m::asm::dsb();
    }};
}

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

pub use start::{Peripherals, ThisBoard};
pub use stm32h7::stm32h743v as pac;
pub use vent::vent;
