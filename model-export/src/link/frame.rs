//! Frames: payloads on a byte stream that may lose, invent and flip bytes.
//!
//! ```text
//! wire = COBS(payload || CRC-32(payload), little-endian) || 0x00
//! ```
//!
//! COBS (Cheshire and Baker, 1999) leaves no zero inside a frame, so a receiver that joins late or reads garbage finds the next frame at the
//! next zero. The CRC is the one of Ethernet and zip.
//!
//! Frames are made and taken apart in the place they are in, because the microcontroller's stack has no room for copies of them.

use heapless::Vec;

use crate::blob::crc32;

/// Longest payload; a model chunk with its header is the longest in use.
pub const MAX_PAYLOAD: usize = 320;
/// Length of the checksum.
const CHECKSUM_BYTES: usize = 4;
/// Bytes of a block: what COBS puts one byte in front of.
const BLOCK: usize = 254;
/// Longest frame on the wire, the closing zero included.
pub const MAX_WIRE: usize = LEAD + MAX_PAYLOAD + CHECKSUM_BYTES + 1;
/// What COBS adds to the longest frame; so far from the front a payload is put together.
const LEAD: usize = (MAX_PAYLOAD + CHECKSUM_BYTES).div_ceil(BLOCK);

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

/// A frame on its way to the line.
pub type Wire = Vec<u8, MAX_WIRE>;

/// Encodes one payload as a frame, the closing zero included.
///
/// # Errors
/// [`FrameError::TooLong`] if the payload exceeds [`MAX_PAYLOAD`].
pub fn encode(payload: &[u8]) -> Result<Wire, FrameError> {
    let mut wire = Wire::new();
    encode_into(&mut wire, payload)?;
    Ok(wire)
}

/// As [`encode`], in a place of the caller's.
///
/// # Errors
/// As [`encode`].
pub fn encode_into(wire: &mut Wire, payload: &[u8]) -> Result<(), FrameError> {
    build(wire, |place| {
        place.iter_mut().zip(payload).for_each(|(byte, new)| *byte = *new);
        Some(payload.len())
    })
}

/// Makes a frame of the payload that `write` leaves in a place of [`MAX_PAYLOAD`] bytes; it gives the length, `None` if there is no room.
pub(super) fn build(wire: &mut Wire, write: impl FnOnce(&mut [u8]) -> Option<usize>) -> Result<(), FrameError> {
    wire.resize(MAX_WIRE, 0).map_err(|_| FrameError::TooLong)?;
    let place = wire.get_mut(LEAD..LEAD + MAX_PAYLOAD).ok_or(FrameError::TooLong)?;
    let length = write(&mut *place).ok_or(FrameError::TooLong)?;
    let checksum = crc32(0, place.get(..length).ok_or(FrameError::TooLong)?).to_le_bytes();
    wire.iter_mut().skip(LEAD + length).zip(checksum).for_each(|(byte, new)| *byte = new);
    let length = stuff(wire, length + CHECKSUM_BYTES);
    wire.truncate(length);
    Ok(())
}

/// Turns `length` bytes from [`LEAD`] on into COBS from the front with a zero behind; gives the length of that.
///
/// What is written trails what is read: by [`LEAD`] at first, then by a byte less for every block that is full.
fn stuff(bytes: &mut [u8], length: usize) -> usize {
    let (mut code_at, mut to, mut code) = (0, 1, 1);
    for from in LEAD..LEAD + length {
        let byte = bytes.get(from).copied().unwrap_or(0);
        let full = code == u8::MAX;
        if full || byte == 0 {
            put(bytes, code_at, code);
            (code_at, code) = (to, 1);
            to += 1;
        }
        if full && byte == 0 {
            put(bytes, code_at, code);
            code_at = to;
            to += 1;
        }
        if byte != 0 {
            put(bytes, to, byte);
            to += 1;
            code = code.saturating_add(1);
        }
    }
    put(bytes, code_at, code);
    put(bytes, to, 0);
    to + 1
}

/// Turns COBS, without the zero that ends it, into what it stands for; gives the length of that, `None` if a block is cut off.
fn unstuff(bytes: &mut [u8]) -> Option<usize> {
    let (mut from, mut to) = (0, 0);
    while let Some(code) = bytes.get(from).copied() {
        from += 1;
        for _ in 1..code {
            let byte = bytes.get(from).copied()?;
            put(bytes, to, byte);
            from += 1;
            to += 1;
        }
        if code != u8::MAX && from < bytes.len() {
            put(bytes, to, 0);
            to += 1;
        }
    }
    Some(to)
}

fn put(bytes: &mut [u8], at: usize, byte: u8) {
    if let Some(place) = bytes.get_mut(at) {
        *place = byte;
    }
}

/// Finds frames in a stream of bytes.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    buffer: Wire,
    overflowed: bool,
    /// The buffer holds a payload that has been given out.
    ended: bool,
}

impl Decoder {
    /// An empty decoder.
    pub const fn new() -> Self {
        Self { buffer: Vec::new(), overflowed: false, ended: false }
    }

    /// Takes one byte; when it ends a frame, gives that frame's payload or says what is wrong with it.
    ///
    /// Zeros between frames are silent, so a sender may begin with one to flush the line's noise.
    pub fn push(&mut self, byte: u8) -> Option<Result<&[u8], FrameError>> {
        if core::mem::take(&mut self.ended) {
            self.buffer.clear();
            self.overflowed = false;
        }
        if byte != 0 {
            if self.buffer.push(byte).is_err() {
                self.overflowed = true;
            }
            return None;
        }
        if self.buffer.is_empty() {
            return None;
        }
        self.ended = true;
        Some(if self.overflowed { Err(FrameError::TooLong) } else { unpack(&mut self.buffer) })
    }
}

fn unpack(wire: &mut [u8]) -> Result<&[u8], FrameError> {
    let length = unstuff(wire).ok_or(FrameError::NotCobs)?;
    let plain = wire.get(..length).ok_or(FrameError::NotCobs)?;
    let (payload, checksum) = plain.split_last_chunk::<CHECKSUM_BYTES>().ok_or(FrameError::Checksum)?;
    if payload.len() > MAX_PAYLOAD {
        return Err(FrameError::TooLong);
    }
    if crc32(0, payload) != u32::from_le_bytes(*checksum) {
        return Err(FrameError::Checksum);
    }
    Ok(payload)
}

#[cfg(test)]
mod tests {
    extern crate std;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// Against the crate `cobs`, with runs around the length of a block.
        #[test]
        fn stuffing_is_cobs_and_unstuffing_undoes_it(
            runs in prop::collection::vec((0usize..3, prop_oneof![0usize..4, 250usize..258]), 1..6)
        ) {
            let plain: std::vec::Vec<u8> = runs
                .into_iter()
                .flat_map(|(zeros, others)| core::iter::repeat_n(0, zeros).chain((1..=u8::MAX).cycle().take(others)))
                .take(MAX_PAYLOAD + CHECKSUM_BYTES)
                .collect();
            // A frame has its checksum at least.
            prop_assume!(!plain.is_empty());
            let mut bytes = [0xa5; MAX_WIRE];
            bytes[LEAD..][..plain.len()].copy_from_slice(&plain);
            let length = stuff(&mut bytes, plain.len());
            let mut other = [0; MAX_WIRE + 1];
            let other_length = cobs::encode(&plain, &mut other);
            prop_assert_eq!(&bytes[..length - 1], &other[..other_length]);
            prop_assert_eq!(bytes[length - 1], 0);
            let length = unstuff(&mut bytes[..length - 1]);
            prop_assert_eq!(length, Some(plain.len()));
            prop_assert_eq!(&bytes[..plain.len()], &plain[..]);
        }

        /// What is no COBS is refused, and what is gives the same, as the crate `cobs` has it.
        #[test]
        fn any_bytes_are_cobs_or_not_as_others_see_it(
            mut bytes in prop::collection::vec(prop_oneof![1u8..6, 1u8..=u8::MAX], 1..MAX_WIRE)
        ) {
            let mut other = bytes.clone();
            let length = cobs::decode_in_place(&mut other).ok();
            prop_assert_eq!(unstuff(&mut bytes), length);
            prop_assert_eq!(&bytes[..length.unwrap_or(0)], &other[..length.unwrap_or(0)]);
        }
    }
}
