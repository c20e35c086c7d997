//! What a link takes from its board, and what it asks of it.

use model_export::link::hello::{Build, MAX_BOARD_NAME};
use model_export::link::message::FaultRecord;
use model_export::link::state::ResetCause;

use crate::tick::{Command, RigFacts};

/// Where commands for the tick go: on a board a queue of a few places.
pub trait CommandSink {
    /// Queues a command; `false` if the queue is full and the command is dropped.
    #[must_use]
    fn send(&mut self, command: Command) -> bool;

    /// Makes the next tick vent ([`crate::tick::TickInputs::vent`]), however full the queue is.
    fn vent(&mut self);
}

/// What the device says of itself.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkConfig {
    /// Firmware version: major, minor, patch.
    pub firmware: [u16; 3],
    /// Name of the board.
    pub board: heapless::String<MAX_BOARD_NAME>,
    /// Why it started.
    pub reset_cause: ResetCause,
    /// The fault record of the run before, if one survived.
    pub previous_record: Option<FaultRecord>,
    /// The board's converter, for building settings.
    pub facts: RigFacts,
}

/// What else a device is and can do; nothing of it where nobody says so.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// What was built, and the chip it runs on.
    pub build: Build,
    /// Whether the board starts the chip's bootloader when [`super::Link::wants_bootloader`].
    pub has_bootloader: bool,
    /// Whether the board keeps a history and calls [`super::Link::serve_history`].
    pub has_history: bool,
}

/// What the board measures about itself, for status and telemetry.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Longest tick in processor cycles.
    pub longest_tick_cycles: u32,
    /// Bytes of stack never used.
    pub stack_unused_bytes: u32,
    /// Analogue supply.
    pub supply_v: Option<f32>,
    /// Temperature of the chip.
    pub chip_celsius: Option<f32>,
    /// Root mean squares of laser and pressure about their means, in codes, while the rig was last at rest for a second.
    pub rest_noise_codes: Option<[f32; 2]>,
    /// A number that nobody can foretell, such as a fast counter's: it tells the sessions of one start from those of another. Zero in lock step,
    /// where equal inputs must give equal outputs.
    pub noise: u32,
}

/// What the board must do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A model has come whole: see whether it is one ([`super::Link::uploaded_model`]) and tell [`super::Link::finish_upload`].
    ModelUploaded,
    /// Another model is active: load it and test again.
    ModelChanged,
}
