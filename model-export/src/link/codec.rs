//! Messages as frames: a kind byte, then the message in postcard.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::frame::{self, FrameError, Wire};
use super::kind::Kind;

/// Why a payload could not be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MessageError {
    /// The payload is empty or of a kind that was not expected here.
    Kind,
    /// Its bytes do not decode, or bytes are left over.
    Content,
    /// It would not fit a frame.
    TooLong,
}

impl From<FrameError> for MessageError {
    fn from(_: FrameError) -> Self {
        Self::TooLong
    }
}

/// A message that knows its kind.
pub trait Message: Serialize + DeserializeOwned {
    /// First byte of its payload.
    const KIND: Kind;

    /// The whole frame on the wire.
    ///
    /// # Errors
    /// [`MessageError::TooLong`] if it does not fit a frame.
    fn to_wire(&self) -> Result<Wire, MessageError> {
        let mut wire = Wire::new();
        self.encode_into(&mut wire)?;
        Ok(wire)
    }

    /// As [`Self::to_wire`], in a place of the caller's.
    ///
    /// # Errors
    /// As [`Self::to_wire`].
    fn encode_into(&self, wire: &mut Wire) -> Result<(), MessageError> {
        Ok(frame::encode_value(wire, &(Self::KIND.byte(), self))?)
    }

    /// Reads a payload of this kind.
    ///
    /// # Errors
    /// [`MessageError::Kind`] or [`MessageError::Content`].
    fn from_payload(payload: &[u8]) -> Result<Self, MessageError> {
        let (kind, body) = payload.split_first().ok_or(MessageError::Kind)?;
        if *kind != Self::KIND.byte() {
            return Err(MessageError::Kind);
        }
        match postcard::take_from_bytes(body) {
            Ok((message, [])) => Ok(message),
            _ => Err(MessageError::Content),
        }
    }
}
