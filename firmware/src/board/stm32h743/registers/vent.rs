//! The safe state, from wherever it is wanted.

use super::{pac, pins};

/// Releases the dump valve and takes the drive to zero, whoever owns them.
pub fn vent() {
    pins::release_dump_valve();
    // SAFETY: single writes that any owner may find done; the program ends after this.
    unsafe {
        (*pac::DAC::ptr()).dhr12r1().write(|w| w.bits(0));
        (*pac::TIM3::ptr()).ccr1().write(|w| w.bits(0));
    }
}
