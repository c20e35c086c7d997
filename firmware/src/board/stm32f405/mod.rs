//! The STM32F405: its clock tree, flash controller, memory protection and option bytes as sequences over small traits of registers, and the
//! registers themselves.
//!
//! [`facts`] holds every rate, address and limit of the chip. The modules beside it know no register and are tested on the desktop;
//! `registers` implements their traits and exists only on the target.

pub mod brown_out;
pub mod clock;
pub mod facts;
pub mod flash;
pub mod memory_map;
mod reset_cause;

#[cfg(target_os = "none")]
#[expect(unsafe_code, reason = "registers, linker symbols and memory that survives a reset")]
pub mod registers;

pub use reset_cause::reset_cause;
