//! The two outputs to the valve: a voltage by the DAC, a pulse width by TIM3 (RM0090 sections 14.5 and 18.4).

use stm32f4::stm32f405::{DAC, RCC, TIM3};

use super::pins;
use crate::board::pulse_drive::{self, PulseExpectation, pulse_timer};
use crate::board::rates::Rates;
use crate::drivers::{PwmValve, ValveDrive};

/// PA4.
pub struct AnalogueDrive(DAC);

impl AnalogueDrive {
    /// At zero. Without the chip's output buffer, which cannot go below 0.2 V (DS8626 table 74).
    pub fn new(rcc: &RCC, registers: DAC) -> Self {
        enable_clock!(rcc.apb1enr: dacen);
        let mut drive = Self(registers);
        drive.drive(0);
        drive.0.cr().write(|w| w.boff1().set_bit().en1().set_bit());
        drive
    }
}

impl ValveDrive for AnalogueDrive {
    fn drive(&mut self, share: u16) {
        // SAFETY: twelve bits, right-aligned (RM0090 section 14.5.3).
        self.0.dhr12r1().write(|w| unsafe { w.bits(u32::from(share >> 4)) });
    }
}

pulse_timer!(TIM3, pins::pulse_is_high);

/// PA6.
pub type PulseDrive = PwmValve<pulse_drive::PulseDrive<Timer>>;

/// PA6, at zero.
pub fn pulse_drive(rcc: &RCC, timer: TIM3, rates: Rates, expectation: &'static PulseExpectation) -> PulseDrive {
    enable_clock!(rcc.apb1enr: tim3en);
    pulse_drive::PulseDrive::new(Timer::new(timer), rates, expectation)
}
