//! The traits between the logic and a board: what a board must bring.
//!
//! embedded-hal 1.0 has traits for pins and PWM but none for a sampled pair of channels or an analogue output, hence the two of ours.

use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;

use crate::supervisor::DumpOrder;

/// One sample of both measured channels, taken at the same instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RawSample {
    /// Laser channel, sum of its conversions.
    pub laser_code: u16,
    /// Pressure channel, sum of its conversions.
    pub pressure_code: u16,
}

impl RawSample {
    /// No conversion came: a code above every converter's full scale, which no calibration takes for a measurement.
    pub const MISSING: Self = Self { laser_code: u16::MAX, pressure_code: u16::MAX };
}

/// What the converter and the pins read beside the sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadBack {
    /// Code of the reference voltage, if it was converted.
    pub reference_code: Option<u16>,
    /// Code of the drive's pin, if it was converted.
    pub drive_code: Option<u16>,
    /// Code of the chip's temperature sensor, if it was converted.
    pub chip_code: Option<u16>,
    /// Whether the dump valve's pin is high.
    pub dump_is_high: bool,
}

/// Where samples come from: on the board the injected conversions of the ADC.
pub trait SampleSource {
    /// The newest sample. Never blocks; the tick is started by the end of the conversion.
    fn sample(&mut self) -> RawSample;

    /// What else the converter and the pins have read since the last tick, where there is such a thing.
    fn read_back(&mut self) -> Option<ReadBack> {
        None
    }
}

/// Where the valve's drive goes: a DAC, a PWM pin, or a simulated valve.
pub trait ValveDrive {
    /// Sets the drive to `share` / 65535 of full scale. Never blocks and cannot fail: a drive that cannot be set must go to zero.
    fn drive(&mut self, share: u16);
}

/// A drive whose pulses have a frequency.
pub trait PulseFrequency {
    /// Sets the frequency; the drive is at zero meanwhile and afterwards.
    fn set_pulse_hz(&mut self, pulse_hz: u32);
}

/// A [`ValveDrive`] over any embedded-hal PWM channel.
#[derive(Debug)]
pub struct PwmValve<P>(pub P);

impl<P: PulseFrequency> PulseFrequency for PwmValve<P> {
    fn set_pulse_hz(&mut self, pulse_hz: u32) {
        self.0.set_pulse_hz(pulse_hz);
    }
}

impl<P: SetDutyCycle> ValveDrive for PwmValve<P> {
    fn drive(&mut self, share: u16) {
        // Rounded down, so that the duty never exceeds the share.
        let duty = u32::from(share) * u32::from(self.0.max_duty_cycle()) / u32::from(u16::MAX);
        if self.0.set_duty_cycle(u16::try_from(duty).unwrap_or(0)).is_err() {
            let _ = self.0.set_duty_cycle_fully_off();
        }
    }
}

/// The dump valve on any embedded-hal output pin: closed (holding pressure) only while energised, so that a dead board vents.
///
/// It has its pin for itself, and closes on the supervisor's word alone: no other code can put pressure on.
#[derive(Debug)]
pub struct DumpValve<P>(P);

impl<P: OutputPin> DumpValve<P> {
    /// Takes the pin.
    pub const fn new(pin: P) -> Self {
        Self(pin)
    }

    /// Energises (closes) or releases (opens) the valve.
    ///
    /// # Errors
    /// The pin's own error; on the STM32 none exists.
    pub fn obey(&mut self, order: &DumpOrder) -> Result<(), P::Error> {
        if order.closes() { self.0.set_high() } else { self.0.set_low() }
    }
}
