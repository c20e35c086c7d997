//! The host's side of the link: one [`Client`] for a board on a serial port, for the emulator and for a rig in this process.
//!
//! Terms. A [`Transport`] carries bytes and has a clock. On a serial port ([`Serial`]) that is the clock on the wall. [`Lockstep`] is a rig in
//! simulated time: a [`Processor`] (the firmware library in this process, ARM code in QEMU, or the flashable image on a model of its chip)
//! and simulated [`Hardware`] around it; time
//! passes only while somebody waits for bytes, one tick of 1 ms after the other. Code written against [`Client`] cannot tell them apart.

mod board_model;
mod breakage;
mod client;
mod error;
mod find;
mod flash;
mod hardware;
mod in_process;
mod inject;
mod lockstep;
mod qemu;
mod reserved;
mod serial;
mod trace;
mod words;

#[cfg(test)]
mod tests;

use std::time::Duration;

pub use board_model::{BOARD_MODEL_BUILD, BoardModel, BoardModelConfig, BoardPins};
pub use breakage::Breakage;
pub use client::{Account, Client, Gap, version};
pub use error::LinkError;
pub use find::find_board;
pub use flash::{FlashMemory, SlotPair};
pub use hardware::{Hardware, HardwareConfig, Muscle, SensorError, ValveError};
pub(crate) use in_process::device_outputs;
pub use in_process::{FACTS, FIRMWARE, Heap, HostDevice, InProcess};
pub use inject::{INJECTIONS, Injection};
pub use lockstep::{Boot, Lockstep, Observer, Processor, TickRecord, Turn, WATCHDOG_MS};
pub use qemu::{EMULATOR, Qemu, QemuConfig};
pub use serial::Serial;
pub use trace::{Cut, Trace, TracedTick};
pub use words::{fault_in_words, in_words, refusal_in_words, state_name};

/// A line to a device.
pub trait Transport {
    /// Sends bytes, all of them.
    ///
    /// # Errors
    /// When the device is gone.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;

    /// Waits until bytes come, at most `limit` of this transport's time, and adds them to `into`; none by then is no error.
    ///
    /// # Errors
    /// When the device is gone.
    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError>;

    /// Time since the transport was opened, by its own clock.
    fn elapsed(&self) -> Duration;

    /// Where it leads, for messages.
    fn place(&self) -> &str;

    /// The token before the first request's. A line that others may have used begins at random, so that a reply that was for somebody else is not
    /// taken for one of ours; a rig in simulated time begins at zero, so that the same command gives the same bytes.
    fn token_before_the_first(&self) -> u32 {
        0
    }
}

impl<T: Transport + ?Sized> Transport for &mut T {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        (**self).send(bytes)
    }

    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        (**self).receive(limit, into)
    }

    fn elapsed(&self) -> Duration {
        (**self).elapsed()
    }

    fn place(&self) -> &str {
        (**self).place()
    }

    fn token_before_the_first(&self) -> u32 {
        (**self).token_before_the_first()
    }
}
