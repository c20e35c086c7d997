//! What the clock controller's model takes for granted: that an HSE is fitted and that the phase-locked loop locks (RM0090 section 7.2).
//!
//! | register | what this changes | RM0090 |
//! |---|---|---|
//! | CR.HSERDY | stays clear without an HSE | 7.2.1, 7.3.1 |
//! | CR.PLLRDY | stays clear if the loop is to fail | 7.2.3, 7.3.1 |

use rigless::soc::stm32f427::generated::rcc::{Register, cr};
use rigless::soc::stm32f427::peripherals::rcc::Rcc;

use super::beside::Beside;

/// The oscillator pins.
#[derive(Debug, Clone, Copy)]
pub struct Oscillators {
    /// Whether the HSE swings.
    pub hse: bool,
    /// Whether the phase-locked loop locks.
    pub loop_locks: bool,
}

impl Default for Oscillators {
    fn default() -> Self {
        Self { hse: true, loop_locks: true }
    }
}

impl Beside<Rcc> for Oscillators {
    fn answer(&self, register: Register, value: u64) -> u64 {
        let mut value = value;
        if register == Register::Cr && !self.hse {
            value = cr::HSERDY.set(value, 0);
        }
        if register == Register::Cr && !self.loop_locks {
            value = cr::PLLRDY.set(value, 0);
        }
        value
    }
}
