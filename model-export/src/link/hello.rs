//! Hello: the one exchange that every version of host and firmware understands, for ever.
//!
//! The layout is written by hand, not by a serialiser, so that no library and no new field can change it. Integers are little-endian.
//!
//! | offset | bytes | meaning |
//! |---|---|---|
//! | 0 | 1 | kind, 0x02 |
//! | 1 | 4 | `CATH` |
//! | 5 | 6 | firmware version: major, minor, patch |
//! | 11 | 2 | protocol version |
//! | 13 | 4 | schema hash |
//! | 17 | 8 | model id (first bytes of the blob's content hash, zero without a model) |
//! | 25 | 1 | cause of the last reset |
//! | 26 | 16 | board name, ASCII, padded with zeros |
//! | 42 | 4 | number of the session that this Hello began, from protocol 2 on |
//!
//! A later version may append bytes; readers ignore what follows. The request is the kind byte 0x01; whatever follows is ignored too.
//!
//! A **session** lasts from a Hello to the next one and has a number of its own, which every request repeats. Frames that wait
//! somewhere on the way, or that somebody plays again, belong to another session and move nothing. As long as no request has come a further Hello
//! gives the same number, so that a repeated question does no harm.

use heapless::{String, Vec};

use super::Kind;
use super::state::ResetCause;

/// Length of the answer's frozen part.
pub const FROZEN_BYTES: usize = 42;
/// Length of the answer.
pub const HELLO_BYTES: usize = FROZEN_BYTES + 4;
const MAGIC: [u8; 4] = *b"CATH";
/// Longest board name.
pub const MAX_BOARD_NAME: usize = 16;

/// Who is at the other end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Firmware version: major, minor, patch.
    pub firmware: [u16; 3],
    /// Protocol version of its messages, see [`super::PROTOCOL`].
    pub protocol: u16,
    /// Hash of its wire schema, see [`super::SCHEMA_HASH`].
    pub schema_hash: u32,
    /// First bytes of the active model's content hash, zero without a model.
    pub model_id: [u8; 8],
    /// Why the device last started.
    pub reset_cause: ResetCause,
    /// Name of the board, for example `stm32f405-rig`.
    pub board: String<MAX_BOARD_NAME>,
    /// The session that this Hello began; zero before protocol 2.
    pub session: u32,
}

/// Why a payload is not a Hello answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HelloError {
    /// Shorter than the frozen part.
    TooShort,
    /// The kind byte or `CATH` is missing: something else is at the other end.
    NotHello,
    /// The board name is not ASCII text.
    BoardName,
}

impl Hello {
    /// The answer's payload.
    pub fn encode(&self) -> Vec<u8, HELLO_BYTES> {
        let kind = [Kind::HelloAnswer.byte()];
        let [major, minor, patch] = self.firmware.map(u16::to_le_bytes);
        let (protocol, schema_hash) = (self.protocol.to_le_bytes(), self.schema_hash.to_le_bytes());
        let reset_cause = [self.reset_cause.number()];
        let name = self.board.as_bytes();
        let parts: [&[u8]; 10] = [&kind, &MAGIC, &major, &minor, &patch, &protocol, &schema_hash, &self.model_id, &reset_cause, name];
        let mut bytes = Vec::new();
        for part in parts {
            // The parts before the name have fixed lengths that sum to 26 and the name's capacity is 16: they always fit.
            let _ = bytes.extend_from_slice(part);
        }
        let _ = bytes.resize(FROZEN_BYTES, 0);
        let _ = bytes.extend_from_slice(&self.session.to_le_bytes());
        bytes
    }

    /// Reads an answer's payload of this or any later version.
    ///
    /// # Errors
    /// See [`HelloError`].
    pub fn decode(payload: &[u8]) -> Result<Self, HelloError> {
        let (kind, rest) = take::<1>(payload)?;
        let (magic, rest) = take::<4>(rest)?;
        if kind != [Kind::HelloAnswer.byte()] || magic != MAGIC {
            return Err(HelloError::NotHello);
        }
        let (major, rest) = take::<2>(rest)?;
        let (minor, rest) = take::<2>(rest)?;
        let (patch, rest) = take::<2>(rest)?;
        let (protocol, rest) = take::<2>(rest)?;
        let (schema_hash, rest) = take::<4>(rest)?;
        let (model_id, rest) = take::<8>(rest)?;
        let (reset_cause, rest) = take::<1>(rest)?;
        let (board, later) = take::<MAX_BOARD_NAME>(rest)?;
        let name = board.split(|&byte| byte == 0).next().unwrap_or_default();
        let name = core::str::from_utf8(name).map_err(|_| HelloError::BoardName)?;
        if !name.is_ascii() {
            return Err(HelloError::BoardName);
        }
        Ok(Self {
            firmware: [major, minor, patch].map(u16::from_le_bytes),
            protocol: u16::from_le_bytes(protocol),
            schema_hash: u32::from_le_bytes(schema_hash),
            model_id,
            reset_cause: ResetCause::from_number(reset_cause[0]),
            board: String::try_from(name).map_err(|_| HelloError::BoardName)?,
            session: later.first_chunk().map_or(0, |session| u32::from_le_bytes(*session)),
        })
    }
}

fn take<const N: usize>(bytes: &[u8]) -> Result<([u8; N], &[u8]), HelloError> {
    bytes.split_first_chunk::<N>().map(|(head, rest)| (*head, rest)).ok_or(HelloError::TooShort)
}
