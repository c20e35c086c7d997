//! What a payload is, by its first byte.
//!
//! # Example
//! ```
//! use model_export::link::Kind;
//!
//! assert_eq!(Kind::Telemetry.byte(), 0x12);
//! assert_eq!(Kind::from_byte(0x12), Some(Kind::Telemetry));
//! assert_eq!(Kind::from_byte(0xff), None);
//! ```

/// First byte of every payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Kind {
    /// Host asks who is there; frozen.
    HelloRequest,
    /// The device's answer to it; frozen.
    HelloAnswer,
    /// Host to device: [`super::message::RequestFrame`].
    Request,
    /// Device to host: [`super::message::ReplyFrame`].
    Reply,
    /// Device to host, unsolicited: [`super::message::Telemetry`].
    Telemetry,
    /// Device to host, while a trace runs: [`super::trace::TracePiece`].
    Trace,
}

impl Kind {
    /// The byte on the wire.
    pub const fn byte(self) -> u8 {
        match self {
            Self::HelloRequest => 0x01,
            Self::HelloAnswer => 0x02,
            Self::Request => 0x10,
            Self::Reply => 0x11,
            Self::Telemetry => 0x12,
            Self::Trace => 0x13,
        }
    }

    /// The kind a byte stands for, if it is known to this version.
    pub const fn from_byte(byte: u8) -> Option<Self> {
        match byte {
            0x01 => Some(Self::HelloRequest),
            0x02 => Some(Self::HelloAnswer),
            0x10 => Some(Self::Request),
            0x11 => Some(Self::Reply),
            0x12 => Some(Self::Telemetry),
            0x13 => Some(Self::Trace),
            _ => None,
        }
    }
}
