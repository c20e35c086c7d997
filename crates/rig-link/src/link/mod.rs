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
mod transport;
mod words;

#[cfg(test)]
mod tests;

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
pub use transport::Transport;
pub use words::{fault_in_words, in_words, refusal_in_words, state_name};
