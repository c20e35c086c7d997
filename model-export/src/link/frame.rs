//! Frames: payloads on a byte stream that may lose, invent and flip bytes.
//!
//! ```text
//! wire = COBS(payload || CRC-32(payload), little-endian) || 0x00
//! ```
//!
//! COBS (Cheshire and Baker, 1999) leaves no zero inside a frame, so a receiver that joins late or reads garbage finds the next frame at the
//! next zero. The CRC is the one of Ethernet and zip.

use heapless::Vec;

use crate::blob::crc32;

/// Longest payload; a model chunk with its header is the longest in use.
pub const MAX_PAYLOAD: usize = 320;
/// Length of the checksum.
const CHECKSUM_BYTES: usize = 4;
/// Longest frame on the wire, the closing zero included.
pub const MAX_WIRE: usize = cobs::max_encoding_length(MAX_PAYLOAD + CHECKSUM_BYTES) + 2;

/// Why bytes could not be made into a frame or a frame into a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FrameError {
    /// The payload is longer than [`MAX_PAYLOAD`], or a frame came that long.
    TooLong,
    /// The bytes between two zeros are not COBS.
    NotCobs,
    /// The checksum does not match, or the frame is too short to have one.
    Checksum,
}

/// Encodes one payload as a frame, the closing zero included.
///
/// # Errors
/// [`FrameError::TooLong`] if the payload exceeds [`MAX_PAYLOAD`].
pub fn encode(payload: &[u8]) -> Result<Vec<u8, MAX_WIRE>, FrameError> {
    if payload.len() > MAX_PAYLOAD {
        return Err(FrameError::TooLong);
    }
    let mut plain: Vec<u8, { MAX_PAYLOAD + CHECKSUM_BYTES }> = Vec::new();
    plain.extend_from_slice(payload).map_err(|_| FrameError::TooLong)?;
    plain.extend_from_slice(&crc32(0, payload).to_le_bytes()).map_err(|_| FrameError::TooLong)?;
    let mut wire = Vec::new();
    wire.resize(MAX_WIRE, 0).map_err(|_| FrameError::TooLong)?;
    let length = cobs::try_encode(&plain, &mut wire).map_err(|_| FrameError::TooLong)?;
    wire.truncate(length);
    wire.push(0).map_err(|_| FrameError::TooLong)?;
    Ok(wire)
}

/// Finds frames in a stream of bytes.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    buffer: Vec<u8, MAX_WIRE>,
    overflowed: bool,
}

impl Decoder {
    /// An empty decoder.
    pub const fn new() -> Self {
        Self { buffer: Vec::new(), overflowed: false }
    }

    /// Takes one byte; when it ends a frame, gives that frame's payload or says what is wrong with it.
    ///
    /// Zeros between frames are silent, so a sender may begin with one to flush the line's noise.
    pub fn push(&mut self, byte: u8) -> Option<Result<Vec<u8, MAX_PAYLOAD>, FrameError>> {
        if byte != 0 {
            if self.buffer.push(byte).is_err() {
                self.overflowed = true;
            }
            return None;
        }
        let outcome = if self.overflowed {
            Some(Err(FrameError::TooLong))
        } else if self.buffer.is_empty() {
            None
        } else {
            Some(unpack(&mut self.buffer))
        };
        self.buffer.clear();
        self.overflowed = false;
        outcome
    }
}

fn unpack(wire: &mut [u8]) -> Result<Vec<u8, MAX_PAYLOAD>, FrameError> {
    let length = cobs::decode_in_place(wire).map_err(|_| FrameError::NotCobs)?;
    let plain = wire.get(..length).ok_or(FrameError::NotCobs)?;
    let (payload, checksum) = plain.split_last_chunk::<CHECKSUM_BYTES>().ok_or(FrameError::Checksum)?;
    if crc32(0, payload) != u32::from_le_bytes(*checksum) {
        return Err(FrameError::Checksum);
    }
    Vec::from_slice(payload).map_err(|_| FrameError::TooLong)
}
