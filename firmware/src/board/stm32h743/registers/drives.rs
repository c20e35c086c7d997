//! The two outputs to the valve: a voltage by the DAC, a pulse width by TIM3 (RM0433 sections 26.7 and 39.4).

use stm32h7::stm32h743v::{DAC, RCC, TIM3};

use super::pins;
use crate::board::pulse_drive::{self, PulseExpectation, pulse_timer};
use crate::board::rates::Rates;
use crate::drivers::{PwmValve, ValveDrive};

/// Mode of channel 1: to its pin, without the output buffer, which cannot go down to zero (RM0433 section 26.7.16).
const UNBUFFERED: u32 = 0b010;

/// PA4.
pub struct AnalogueDrive(DAC);

impl AnalogueDrive {
    /// At zero.
    pub fn new(rcc: &RCC, registers: DAC) -> Self {
        enable_clock!(rcc.apb1lenr: dac12en);
        let mut drive = Self(registers);
        drive.drive(0);
        // SAFETY: the mode, which may be written while the channel is off.
        drive.0.mcr().write(|w| unsafe { w.bits(UNBUFFERED) });
        drive.0.cr().write(|w| w.en1().set_bit());
        drive
    }
}

impl ValveDrive for AnalogueDrive {
    fn drive(&mut self, share: u16) {
        // SAFETY: twelve bits, right-aligned (RM0433 section 26.7.3).
        self.0.dhr12r1().write(|w| unsafe { w.bits(u32::from(share >> 4)) });
    }
}

pulse_timer!(TIM3, pins::pulse_is_high);

/// PA6.
pub type PulseDrive = PwmValve<pulse_drive::PulseDrive<Timer>>;

/// PA6, at zero.
pub fn pulse_drive(rcc: &RCC, timer: TIM3, rates: Rates, expectation: &'static PulseExpectation) -> PulseDrive {
    enable_clock!(rcc.apb1lenr: tim3en);
    pulse_drive::PulseDrive::new(Timer::new(timer), rates, expectation)
}
