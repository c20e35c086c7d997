//! The two outputs to the valve: a voltage by the DAC, a pulse width by TIM3 (RM0090 sections 14.5 and 18.4).

use core::convert::Infallible;

use embedded_hal::pwm::{ErrorType, SetDutyCycle};
use model_export::link::settings::Settings;
use stm32f4::stm32f405::{DAC, RCC, TIM3};

use crate::board::hardware::Rates;
use crate::board::pulse::PulseTiming;
use crate::seam::{PulseFrequency, PwmValve, ValveDrive};

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
pub struct PulseDrive {
    timer: TIM3,
    timer_hz: u32,
    period_counts: u16,
}

impl PulseDrive {
    /// At zero.
    pub fn new(rcc: &RCC, timer: TIM3, rates: Rates) -> PwmValve<Self> {
        enable_clock!(rcc.apb1enr: tim3en);
        // SAFETY: PWM mode 1 (OC1M = 110) with preload (OC1PE).
        timer.ccmr1_output().write(|w| unsafe { w.bits((0b110 << 4) | (1 << 3)) });
        let mut drive = Self { timer, timer_hz: rates.timer_hz, period_counts: 0 };
        drive.set_pulse_hz(Settings::DEFAULT.pulse_hz);
        drive.timer.ccer().write(|w| w.cc1e().set_bit());
        drive.timer.cr1().write(|w| w.arpe().set_bit().cen().set_bit());
        PwmValve(drive)
    }
}

impl PulseFrequency for PulseDrive {
    fn set_pulse_hz(&mut self, pulse_hz: u32) {
        let PulseTiming { prescaler, period_counts } = PulseTiming::new(self.timer_hz, pulse_hz);
        self.period_counts = period_counts;
        // SAFETY: every prescaler and period counts; the duty is zero.
        unsafe {
            self.timer.ccr1().write(|w| w.bits(0));
            self.timer.psc().write(|w| w.bits(u32::from(prescaler)));
            self.timer.arr().write(|w| w.bits(u32::from(period_counts.saturating_sub(1))));
        }
        // Only an update takes them over.
        self.timer.egr().write(|w| w.ug().set_bit());
    }
}

impl ErrorType for PulseDrive {
    type Error = Infallible;
}

impl SetDutyCycle for PulseDrive {
    fn max_duty_cycle(&self) -> u16 {
        self.period_counts
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        // SAFETY: a duty of the period's counts is always on.
        self.timer.ccr1().write(|w| unsafe { w.bits(u32::from(duty.min(self.period_counts))) });
        Ok(())
    }
}
