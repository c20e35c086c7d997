//! The supply: what happens before it is too low (RM0433 sections 6.8 and 20.6).

use model_export::link::fault::Fault;
use stm32h7::stm32h743v::{EXTI, PWR};

use super::vent::vent;
use crate::board::contract::SupplyMonitor;
use crate::board::stm32h743::facts::BROWN_OUT_LEVEL;
use crate::board::target::crash;

/// Line of the supply monitor at the interrupt controller (RM0433 table 148).
const MONITOR_LINE: u32 = 1 << 16;

/// The monitor.
pub struct Monitor(PWR);

/// Starts the monitor; its interrupt is PVD_PVM. Beside it whether the supply is too low already.
pub fn start(power: PWR, lines: &EXTI) -> (Monitor, bool) {
    // SAFETY: a three-bit level.
    power.cr1().modify(|_, w| unsafe { w.pls().bits(BROWN_OUT_LEVEL).pvde().set_bit() });
    // SAFETY: the line's bit alone. Rising, because the monitor's output rises when the supply falls.
    unsafe {
        lines.rtsr1().modify(|r, w| w.bits(r.bits() | MONITOR_LINE));
        lines.cpupr1().write(|w| w.bits(MONITOR_LINE));
        lines.cpuimr1().modify(|r, w| w.bits(r.bits() | MONITOR_LINE));
    }
    let low = is_low(&power);
    (Monitor(power), low)
}

fn is_low(power: &PWR) -> bool {
    power.csr1().read().pvdo().bit_is_set()
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
