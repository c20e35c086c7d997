//! The supply: what happens before it is too low (RM0090 sections 5.4 and 12.3).

use model_export::link::fault::Fault;
use stm32f4::stm32f405::{EXTI, PWR, RCC};

use crate::board::chip::crash;
use crate::board::hardware::BROWN_OUT_LEVEL;

/// Line of the supply monitor at the interrupt controller (RM0090 section 12.2.5).
const MONITOR_LINE: u32 = 1 << 16;

/// Starts the monitor; its interrupt is PVD. Gives whether the supply is too low already.
pub fn start(rcc: &RCC, power: &PWR, lines: &EXTI) -> bool {
    enable_clock!(rcc.apb1enr: pwren);
    // SAFETY: a three-bit level.
    power.cr().modify(|_, w| unsafe { w.pls().bits(BROWN_OUT_LEVEL).pvde().set_bit() });
    // SAFETY: the line's bit alone. Rising, because the monitor's output rises when the supply falls.
    unsafe {
        lines.rtsr().modify(|r, w| w.bits(r.bits() | MONITOR_LINE));
        lines.pr().write(|w| w.bits(MONITOR_LINE));
        lines.imr().modify(|r, w| w.bits(r.bits() | MONITOR_LINE));
    }
    is_low(power)
}

fn is_low(power: &PWR) -> bool {
    power.csr().read().pvdo().bit_is_set()
}

/// The supply falls: vents, remembers, and starts again when it is back. If it is not, the watchdog or the power-down reset ends the wait.
pub fn fell(power: &PWR) -> ! {
    crash::vent_and_remember(Fault::BrownOut);
    while is_low(power) {
        crash::vent();
    }
    cortex_m::peripheral::SCB::sys_reset()
}
