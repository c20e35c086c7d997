//! What stands on a port's pins beside the port: a timer's output, and something outside that is stronger than the chip's own outputs.

use rigless::device::Level;
use rigless::soc::{stm32f427, stm32h743};

use super::beside::Beside;
use crate::boards::stm32f405::wiring::Pin;

/// Levels on pins of one port; the input register shows them (RM0090 section 8.4.5, RM0433 section 11.4.5).
#[derive(Debug, Clone, Copy, Default)]
pub struct Held {
    /// Pins that a peripheral drives, and those of them that are high.
    driven: [u64; 2],
    /// Pins that something outside holds, a short to ground or to the supply, and those of them that are high.
    forced: [u64; 2],
}

fn put(place: &mut [u64; 2], pin: Pin, level: Option<bool>) {
    let [which, high] = place;
    let bit = 1 << pin.number;
    *which = if level.is_some() { *which | bit } else { *which & !bit };
    *high = if level == Some(true) { *high | bit } else { *high & !bit };
}

impl Held {
    /// What a peripheral drives on its pin.
    pub fn drive(&mut self, pin: Pin, level: Option<Level>) {
        put(&mut self.driven, pin, level.map(|level| level == Level::High));
    }

    /// What something outside makes of a pin; `None` lets it go.
    pub fn force(&mut self, pin: Pin, level: Option<bool>) {
        put(&mut self.forced, pin, level);
    }

    fn show(&self, value: u64) -> u64 {
        [self.driven, self.forced].into_iter().fold(value, |value, [which, high]| value & !which | high)
    }
}

impl Beside<stm32f427::peripherals::gpio::Gpio> for Held {
    fn answer(&self, register: stm32f427::generated::gpioa::Register, value: u64) -> u64 {
        if register == stm32f427::generated::gpioa::Register::Idr { self.show(value) } else { value }
    }
}

impl Beside<stm32h743::peripherals::gpio::Gpio> for Held {
    fn answer(&self, register: stm32h743::generated::gpioa::Register, value: u64) -> u64 {
        if register == stm32h743::generated::gpioa::Register::Idr { self.show(value) } else { value }
    }
}

/// Compare value and period at the pulse width's pin, whatever the timer gives there.
pub fn pulse_on_pin(given: Option<(u16, u16)>, forced: Option<bool>) -> Option<(u16, u16)> {
    match forced {
        Some(true) => Some((u16::MAX, u16::MAX - 1)),
        Some(false) => Some((0, u16::MAX - 1)),
        None => given,
    }
}
