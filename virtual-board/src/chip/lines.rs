//! External interrupt line 16, the supply monitor's (RM0090 chapter 12), and the monitor's output that drives it (section 5.4).
//!
//! | register | behaviour | RM0090 |
//! |---|---|---|
//! | IMR | lets a pending line interrupt | 12.3.1 |
//! | EMR | stored: no wake-up from stop mode here | 12.3.2 |
//! | RTSR, FTSR | the edges that make the line pending | 12.3.3, 12.3.4 |
//! | SWIER | a rising bit makes its line pending; clearing the pending bit clears it | 12.3.5 |
//! | PR | cleared by writing one | 12.3.6 |
//! | PWR CSR.PVDO | its level goes to line 16 | 5.4.2, 12.2.5 |
//!
//! The lines of pins and of other peripherals are not wired: the image uses none of them.

use rigless::device::{Device, DeviceContext, Level, RegisterFile, RequestChange};
use rigless::soc::stm32f427::generated::exti::Register;
use rigless::soc::stm32f427::generated::pwr;
use rigless::soc::stm32f427::peripherals::pwr::Pwr;

use super::beside::Beside;

/// Request output on which the supply monitor gives PVDO.
pub const MONITOR_REQUEST: usize = 16;
/// Line of the supply monitor.
const MONITOR_LINE: u64 = 1 << 16;
/// Its interrupt in the instance's list.
const MONITOR_INTERRUPT: usize = 0;

/// The interrupt controller's lines.
#[derive(Debug, Default)]
pub struct Lines {
    pending: u64,
    software: u64,
    driven: Level,
}

impl Lines {
    fn refresh(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        registers.set(Register::Pr, self.pending);
        registers.set(Register::Swier, self.software);
        let level = Level::from(self.pending & registers.get(Register::Imr) & MONITOR_LINE != 0);
        if level != self.driven {
            self.driven = level;
            context.interrupt(MONITOR_INTERRUPT, level);
        }
    }
}

impl Device for Lines {
    type Register = Register;

    fn write(&mut self, register: Register, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        match register {
            Register::Pr => {
                self.pending &= !value;
                self.software &= !value;
            }
            Register::Swier => {
                let rising = value & !self.software;
                self.software |= value;
                self.pending |= rising & registers.get(Register::Imr);
            }
            Register::Imr | Register::Emr | Register::Rtsr | Register::Ftsr => {}
        }
        self.refresh(registers, context);
    }

    fn on_request(&mut self, change: RequestChange, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if change.instance != "PWR" || change.request != MONITOR_REQUEST {
            return;
        }
        let edges = match change.level {
            Level::High => Register::Rtsr,
            Level::Low => Register::Ftsr,
        };
        self.pending |= registers.get(edges) & MONITOR_LINE;
        self.refresh(registers, context);
    }

    fn reset(&mut self) {
        *self = Self::default();
    }
}

/// Sends the supply monitor's output on.
#[derive(Debug, Default)]
pub struct MonitorOutput {
    level: Level,
}

impl Beside<Pwr> for MonitorOutput {
    fn after(&mut self, _model: &mut Pwr, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let level = Level::from(pwr::csr::PVDO.is_set(registers.get(pwr::Register::Csr)));
        if level != self.level {
            self.level = level;
            context.request(MONITOR_REQUEST, level);
        }
    }

    fn reset(&mut self) {
        *self = Self::default();
    }
}
