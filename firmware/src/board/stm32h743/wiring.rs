//! What a board around the STM32H743 has to say: its name, its clock, and which pins it uses for what.
//!
//! Some functions have one pin here: the analogue drive is DAC_OUT1 at PA4, the pulse width is TIM3_CH1 at PA6, the line is USART3 at PD8 and
//! PD9 (DS12110 tables 11 to 20). The board's model reads this file too, so it says nothing of the firmware.

use super::super::stm32f405::wiring::{Pin, all_differ};

/// The analogue drive's pin.
pub const DRIVE: Pin = Pin::new('A', 4);
/// The pulse width's pin.
pub const PULSE: Pin = Pin::new('A', 6);
/// USART3 TX.
pub const TRANSMIT: Pin = Pin::new('D', 8);
/// USART3 RX.
pub const RECEIVE: Pin = Pin::new('D', 9);
/// The debug probe's pins.
pub const PROBE: [Pin; 2] = [Pin::new('A', 13), Pin::new('A', 14)];

/// Channel of the first and second converter at a pin (DS12110 table 8).
pub const fn channel(pin: Pin) -> Option<u8> {
    match (pin.port, pin.number) {
        (0, 2) => Some(14),
        (0, 3) => Some(15),
        (0, 4) => Some(18),
        (0, 5) => Some(19),
        (0, 6) => Some(3),
        (0, 7) => Some(7),
        (1, 0) => Some(9),
        (1, 1) => Some(5),
        (2, 0) => Some(10),
        (2, 1) => Some(11),
        (2, 4) => Some(4),
        (2, 5) => Some(8),
        _ => None,
    }
}

/// The same, of a pin that has one.
pub const fn channel_of(pin: Pin) -> u8 {
    match channel(pin) {
        Some(channel) => channel,
        None => unreachable!(),
    }
}

/// Address of a port's registers (RM0433 table 8).
pub const fn port_address(pin: Pin) -> u32 {
    0x5802_0000 + 0x400 * pin.port
}

/// A board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wiring {
    /// Its name, in the Hello.
    pub name: &'static str,
    /// The HSE or clock signal at OSC_IN, Hz: any multiple of 4 MHz up to 48 MHz (RM0433 section 8.5.2, and the loop's divided input here).
    pub hse_hz: u32,
    /// Whether it is a clock signal and no resonator.
    pub has_clock_signal: bool,
    /// The laser's input.
    pub laser: Pin,
    /// The measured pressure's input.
    pub pressure: Pin,
    /// The emergency stop: an input, high is pressed.
    pub emergency_stop: Pin,
    /// The dump valve: an output, high is energised.
    pub dump_valve: Pin,
}

impl Wiring {
    /// Whether the chip can do that: converter channels where they are needed, a clock within its range, and no pin twice.
    pub const fn is_possible(&self) -> bool {
        let analogue = channel(self.laser).is_some() && channel(self.pressure).is_some();
        let hse = self.hse_hz >= 4_000_000 && self.hse_hz <= 48_000_000 && self.hse_hz.is_multiple_of(4_000_000);
        analogue && hse && all_differ(&self.pins())
    }

    /// Every pin in use.
    pub const fn pins(&self) -> [Pin; 10] {
        let [clock, data] = PROBE;
        [self.laser, self.pressure, DRIVE, PULSE, self.emergency_stop, self.dump_valve, TRANSMIT, RECEIVE, clock, data]
    }
}
