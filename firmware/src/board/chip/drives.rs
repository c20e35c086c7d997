//! The two outputs to the valve: a voltage by the DAC, a pulse width by TIM3 (RM0090 sections 14.5 and 18.4).

use core::convert::Infallible;

use embedded_hal::pwm::{ErrorType, SetDutyCycle};
use stm32f4::stm32f405::{DAC, RCC, TIM3};

use crate::board::hardware::PULSE_PERIOD_COUNTS;
use crate::seam::{PwmValve, ValveDrive};

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

/// PA6.
pub struct PulseDrive(TIM3);

impl PulseDrive {
    /// At zero.
    pub fn new(rcc: &RCC, timer: TIM3) -> PwmValve<Self> {
        enable_clock!(rcc.apb1enr: tim3en);
        timer.psc().reset();
        // SAFETY: PWM mode 1 (OC1M = 110) with preload (OC1PE), the period, duty zero.
        unsafe {
            timer.ccmr1_output().write(|w| w.bits((0b110 << 4) | (1 << 3)));
            timer.arr().write(|w| w.bits(u32::from(PULSE_PERIOD_COUNTS - 1)));
            timer.ccr1().write(|w| w.bits(0));
        }
        timer.ccer().write(|w| w.cc1e().set_bit());
        timer.egr().write(|w| w.ug().set_bit());
        timer.cr1().write(|w| w.arpe().set_bit().cen().set_bit());
        PwmValve(Self(timer))
    }
}

impl ErrorType for PulseDrive {
    type Error = Infallible;
}

impl SetDutyCycle for PulseDrive {
    fn max_duty_cycle(&self) -> u16 {
        PULSE_PERIOD_COUNTS
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        // SAFETY: a duty of the period's counts is always on.
        self.0.ccr1().write(|w| unsafe { w.bits(u32::from(duty.min(PULSE_PERIOD_COUNTS))) });
        Ok(())
    }
}
