//! Frames: payloads on a byte stream that may lose, invent and flip bytes.
//!
//! ```text
//! wire = COBS(payload || CRC-32(payload), little-endian) || 0x00
//! ```
//!
//! COBS (Cheshire and Baker, 1999) leaves no zero inside a frame, so a receiver that joins late or reads garbage finds the next frame at the
//! next zero. The CRC is the one of Ethernet and zip. postcard's flavours make frames, the crate `cobs` takes them apart in the place they are in.
//!
//! # Example
//! ```
//! use model_export::link::frame::{Decoder, FrameError, MAX_PAYLOAD, MAX_WIRE, Wire, encode, encode_into};
//!
//! let mut wire: Wire = encode(&[0x12, 0, 7])?;
//! assert!(wire.len() <= MAX_WIRE && wire.last() == Some(&0));
//!
//! let mut decoder = Decoder::new();
//! let mut last = None;
//! for byte in &wire {
//!     last = decoder.push(*byte).map(|payload| payload.map(<[u8]>::to_vec));
//! }
//! assert_eq!(last, Some(Ok(vec![0x12, 0, 7])));
//!
//! // A damaged byte is noticed, a long payload refused.
//! wire[2] ^= 4;
//! let last = wire.iter().filter_map(|byte| decoder.push(*byte).map(|payload| payload.map(<[u8]>::to_vec))).last();
//! assert!(matches!(last, Some(Err(_))));
//! assert_eq!(encode_into(&mut wire, &[0; MAX_PAYLOAD + 1]), Err(FrameError::TooLong));
//! # Ok::<(), FrameError>(())
//! ```

use heapless::Vec;
use postcard::ser_flavors::crc::CrcModifier;
use postcard::ser_flavors::{Cobs, Flavor as _, Slice};
use serde::Serialize;

use crate::blob::{CRC, crc32};

/// Longest payload; a model chunk with its header is the longest in use.
pub const MAX_PAYLOAD: usize = 320;
/// Length of the checksum.
const CHECKSUM_BYTES: usize = 4;
/// Bytes of a block: what COBS puts one byte in front of.
const BLOCK: usize = 254;
/// Longest frame on the wire, the closing zero included.
pub const MAX_WIRE: usize = MAX_PAYLOAD + CHECKSUM_BYTES + (MAX_PAYLOAD + CHECKSUM_BYTES).div_ceil(BLOCK) + 1;

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
    if payload.len() > MAX_PAYLOAD {
        return Err(FrameError::TooLong);
    }
    wire.resize(MAX_WIRE, 0).map_err(|_| FrameError::TooLong)?;
    let length = close(wire, payload).map_err(|_| FrameError::TooLong)?;
    wire.truncate(length);
    Ok(())
}

/// The checksum behind the payload, COBS around both.
fn close(place: &mut [u8], payload: &[u8]) -> postcard::Result<usize> {
    let mut frame = CrcModifier::new(Cobs::try_new(Slice::new(place))?, CRC.digest());
    frame.try_extend(payload)?;
    Ok(frame.finalize()?.len())
}

/// Makes a frame of a value, which becomes the payload as postcard writes it.
pub(super) fn encode_value(wire: &mut Wire, value: &impl Serialize) -> Result<(), FrameError> {
    // First the payload and then the frame: postcard's flavours around the serialiser would stand in the code of every type.
    let mut payload = [0; MAX_PAYLOAD];
    let payload = postcard::to_slice(value, &mut payload).map_err(|_| FrameError::TooLong)?;
    encode_into(wire, payload)
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
    let length = cobs::decode_in_place(wire).map_err(|_| FrameError::NotCobs)?;
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

        /// With runs around the length of a block; the frame is COBS of payload and checksum as the crate `cobs` has it.
        #[test]
        fn a_frame_is_payload_and_checksum_and_comes_back_as_it_was_sent(
            runs in prop::collection::vec((0usize..3, prop_oneof![0usize..4, 250usize..258]), 0..6)
        ) {
            let payload: std::vec::Vec<u8> = runs
                .into_iter()
                .flat_map(|(zeros, others)| core::iter::repeat_n(0, zeros).chain((1..=u8::MAX).cycle().take(others)))
                .take(MAX_PAYLOAD)
                .collect();
            let wire = encode(&payload).unwrap();
            let plain = [&payload[..], &crc32(0, &payload).to_le_bytes()].concat();
            // Behind a full block that ends the frame postcard leaves an empty one; both are COBS, and every decoder takes both.
            let mut other = [0; MAX_WIRE];
            let length = cobs::encode(&plain, &mut other);
            let (body, end) = wire.split_at(length);
            prop_assert_eq!(body, &other[..length]);
            let is_full = plain.len() >= BLOCK && !plain[plain.len() - BLOCK..].contains(&0);
            prop_assert!(end == [0] || (end == [1, 0] && is_full), "{:?}", end);
            let mut decoder = Decoder::new();
            for byte in &wire[..wire.len() - 1] {
                prop_assert_eq!(decoder.push(*byte), None);
            }
            prop_assert_eq!(decoder.push(0), Some(Ok(&payload[..])));
        }

        /// Whatever comes is a payload with its checksum or an error.
        #[test]
        fn any_bytes_are_a_frame_or_an_error(
            bytes in prop::collection::vec(prop_oneof![1u8..6, 1u8..=u8::MAX], 1..MAX_WIRE + 9)
        ) {
            let mut decoder = Decoder::new();
            for byte in &bytes {
                prop_assert_eq!(decoder.push(*byte), None);
            }
            let too_long = bytes.len() > MAX_WIRE;
            let mut place = bytes.clone();
            let plain = cobs::decode_in_place(&mut place).ok().map(|length| &place[..length]);
            match decoder.push(0) {
                Some(Ok(payload)) => {
                    let (body, checksum) = plain.unwrap().split_last_chunk().unwrap();
                    prop_assert_eq!((payload, crc32(0, payload)), (body, u32::from_le_bytes(*checksum)));
                }
                Some(Err(error)) => prop_assert_eq!(error == FrameError::TooLong, too_long || plain.is_some_and(|plain| plain.len() > MAX_PAYLOAD + CHECKSUM_BYTES)),
                None => prop_assert!(false, "the zero ends a frame"),
            }
        }
    }

    #[test]
    fn the_longest_payload_fits_and_a_longer_one_is_refused() {
        assert_eq!(encode(&[1; MAX_PAYLOAD]).unwrap().len(), MAX_WIRE);
        assert_eq!(encode(&[1; MAX_PAYLOAD + 1]), Err(FrameError::TooLong));
    }

    #[test]
    fn the_checksum_is_that_of_zip_and_goes_on_where_it_was_left() {
        // The check value of CRC-32/ISO-HDLC in the catalogue of parametrised CRC algorithms (G. Cook).
        assert_eq!(crc32(0, b"123456789"), 0xcbf4_3926);
        assert_eq!(crc32(crc32(0, b"1234"), b"56789"), 0xcbf4_3926);
    }
}
