//! What can go wrong on the way to a device, each with what to do.

use model_export::link::message::Refusal;

use super::words::refusal_in_words;

/// Why an exchange with a device failed.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The place cannot be opened.
    #[error("{place}: cannot be opened ({problem}); {remedy}")]
    CannotOpen {
        /// Which place.
        place: String,
        /// What the system says.
        problem: String,
        /// What to do.
        remedy: String,
    },
    /// Another process has the place open.
    #[error(
        "{place}: is in use by {by}; wait until it ends, or end it: Ctrl-C vents there, and a rig that has lost its host vents by itself"
    )]
    InUse {
        /// Which place.
        place: String,
        /// By whom.
        by: String,
    },
    /// No board, or too many.
    #[error("{problem}{}", .tried.iter().map(|one| format!("\n  tried {one}")).collect::<String>())]
    NotFound {
        /// What is wrong and what to do.
        problem: String,
        /// What each port said.
        tried: Vec<String>,
    },
    /// The device was there and is gone.
    #[error("{place}: the device is gone ({problem}); check cable and power, a running rig vents by itself")]
    Unplugged {
        /// Where it was.
        place: String,
        /// What the system says.
        problem: String,
    },
    /// Bytes come, but no frames.
    #[error("{place}: {bytes} bytes came and none of them made a sound frame; another device or another baud rate")]
    Garbage {
        /// Where they came from.
        place: String,
        /// How many.
        bytes: usize,
    },
    /// Silence.
    #[error("{place}: no answer to {request} within {milliseconds} ms; is the device powered and is this its port?{condition}")]
    NoAnswer {
        /// Where.
        place: String,
        /// What was asked.
        request: String,
        /// How long was waited.
        milliseconds: u128,
        /// What can be seen of it besides, or nothing.
        condition: String,
    },
    /// The firmware is older than this program.
    #[error(
        "{place}: the firmware {firmware} speaks protocol {theirs}, this program speaks {ours}: the firmware is too old; flash the current one \
         (`cargo xtask flash`)"
    )]
    OldFirmware {
        /// Where.
        place: String,
        /// Its version.
        firmware: String,
        /// Its protocol.
        theirs: u16,
        /// Ours.
        ours: u16,
    },
    /// The firmware is newer than this program.
    #[error(
        "{place}: the firmware {firmware} speaks protocol {theirs}, this program speaks {ours}: this program is too old; install the \
         release that came with the firmware"
    )]
    NewFirmware {
        /// Where.
        place: String,
        /// Its version.
        firmware: String,
        /// Its protocol.
        theirs: u16,
        /// Ours.
        ours: u16,
    },
    /// Equal protocol numbers, unequal messages.
    #[error(
        "{place}: firmware {firmware} and this program claim the same protocol and differ in its messages ({theirs:08x} and {ours:08x}): one of \
         them is an unreleased build; build both from the same sources"
    )]
    OtherSchema {
        /// Where.
        place: String,
        /// Its version.
        firmware: String,
        /// Its schema hash.
        theirs: u32,
        /// Ours.
        ours: u32,
    },
    /// The device said no.
    #[error("refused: {}", refusal_in_words(.0))]
    Refused(Refusal),
    /// The device's answer does not belong to the request.
    #[error("{place}: the answer does not belong to the request {request}; please report this")]
    Unexpected {
        /// Where.
        place: String,
        /// What was asked.
        request: String,
    },
    /// The emulator cannot be used.
    #[error("QEMU: {0}")]
    Emulator(String),
    /// The simulated rig cannot be used.
    #[error("{0}")]
    Rig(String),
}
