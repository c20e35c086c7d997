//! The STM32H743 (revision V), the second chip: see [`super`] for what a chip's folder holds.
//!
//! What differs from the STM32F405, by RM0433: the core is a Cortex-M7 with caches and data beside them in the TCM; the flash has two banks of
//! eight sectors, so models and settings change while the program runs on, and it is programmed in words of 256 bits with a code that
//! corrects errors, each of them once; the converters are three, and what is read back has two of its own.

pub mod brown_out;
pub mod facts;
pub mod flash;
pub mod regions;
mod reset_cause;
pub mod wiring;

#[cfg(all(target_os = "none", chip = "stm32h743"))]
#[expect(unsafe_code, reason = "registers")]
pub mod registers;

pub use reset_cause::reset_cause;
