//! The supply: what happens before it is too low (RM0090 sections 5.4 and 12.3).

use model_export::link::fault::Fault;
use stm32f4::stm32f405::{EXTI, PWR, RCC};

use super::vent;
use crate::board::contract::SupplyMonitor;
use crate::board::stm32f405::facts::BROWN_OUT_LEVEL;
use crate::board::target::crash;

/// Line of the supply monitor at the interrupt controller (RM0090 section 12.2.5).
const MONITOR_LINE: u32 = 1 << 16;

/// The monitor.
pub struct Monitor(PWR);

/// Starts the monitor; its interrupt is PVD. Beside it whether the supply is too low already.
pub fn start(rcc: &RCC, power: PWR, lines: &EXTI) -> (Monitor, bool) {
    enable_clock!(rcc.apb1enr: pwren);
    // SAFETY: a three-bit level.
    power.cr().modify(|_, w| unsafe { w.pls().bits(BROWN_OUT_LEVEL).pvde().set_bit() });
    // SAFETY: the line's bit alone. Rising, because the monitor's output rises when the supply falls.
    unsafe {
        lines.rtsr().modify(|r, w| w.bits(r.bits() | MONITOR_LINE));
        lines.pr().write(|w| w.bits(MONITOR_LINE));
        lines.imr().modify(|r, w| w.bits(r.bits() | MONITOR_LINE));
    }
    let low = is_low(&power);
    (Monitor(power), low)
}

fn is_low(power: &PWR) -> bool {
    power.csr().read().pvdo().bit_is_set()
}

impl SupplyMonitor for Monitor {
    /// If the supply does not come back, the watchdog or the power-down reset ends the wait.
    fn fell(&mut self) -> ! {
        crash::vent_and_remember(Fault::BrownOut);
        while is_low(&self.0) {
            vent();
        }
        cortex_m::peripheral::SCB::sys_reset()
    }
}
