//! Hello: the one message that every version of host and firmware understands, for ever.
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
//! | 46 | 8 | first bytes of the hash of the source the program was built from, zero if unknown; from protocol 3 on |
//! | 54 | 4 | the chip's device and revision identifiers (DBGMCU_IDCODE of an STM32), zero if it is none; from protocol 3 on |
//! | 58 | 12 | the chip's unique number, zero if it has none; from protocol 3 on |
//!
//! A later version may append bytes; readers ignore what follows. The request is the kind byte 0x01; whatever follows is ignored too.
//!
//! A **session** lasts from a Hello to the next one and has a number of its own, which every request repeats. Frames that wait
//! somewhere on the way, or that somebody plays again, belong to another session and move nothing. As long as no request has come a further Hello
//! gives the same number, so that a repeated question does no harm.
//!
//! # Example
//! ```
//! use model_export::link::hello::{Build, FROZEN_BYTES, HELLO_BYTES, Hello, HelloError, MAX_BOARD_NAME};
//! use model_export::link::state::ResetCause;
//!
//! let hello = Hello {
//!     firmware: [0, 1, 0],
//!     protocol: model_export::link::PROTOCOL,
//!     schema_hash: model_export::link::SCHEMA_HASH,
//!     model_id: [0; 8],
//!     reset_cause: ResetCause::PowerOn,
//!     board: "custom-f405".try_into()?,
//!     session: 7,
//!     build: Build::default(),
//! };
//! assert!(hello.board.len() <= MAX_BOARD_NAME);
//! let payload = hello.encode();
//! assert_eq!(payload.len(), HELLO_BYTES);
//! assert_eq!(Hello::decode(&payload), Ok(hello));
//! assert_eq!(Hello::decode(&payload[..FROZEN_BYTES - 1]), Err(HelloError::TooShort));
//! # Ok::<(), heapless::CapacityError>(())
//! ```

use heapless::{String, Vec};

use super::kind::Kind;
use super::state::ResetCause;

/// Length of the answer's frozen part.
pub const FROZEN_BYTES: usize = 42;
/// Length of the answer.
pub const HELLO_BYTES: usize = FROZEN_BYTES + 4 + 8 + 4 + 12;
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
    /// Name of the board, for example `custom-f405`.
    pub board: String<MAX_BOARD_NAME>,
    /// The session that this Hello began; zero before protocol 2.
    pub session: u32,
    /// What was built and what it runs on.
    pub build: Build,
}

/// What was built and what it runs on; zeros before protocol 3 and where nobody knows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Build {
    /// First bytes of the hash of the source.
    pub source: [u8; 8],
    /// Device identifier in the low twelve bits, revision in the high half.
    pub chip: u32,
    /// The chip's own number.
    pub chip_number: [u8; 12],
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
        let Build { source, chip, chip_number } = self.build;
        let (session, chip) = (self.session.to_le_bytes(), chip.to_le_bytes());
        for part in [&session[..], &source, &chip, &chip_number] {
            // HELLO_BYTES counts them.
            let _ = bytes.extend_from_slice(part);
        }
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
            build: Build::decode(later.get(4..).unwrap_or(&[])),
        })
    }
}

impl Build {
    /// Of what a sender of any version put behind the session.
    fn decode(bytes: &[u8]) -> Self {
        let read = || {
            let (source, rest) = take::<8>(bytes).ok()?;
            let (chip, rest) = take::<4>(rest).ok()?;
            let (chip_number, _) = take::<12>(rest).ok()?;
            Some(Self { source, chip: u32::from_le_bytes(chip), chip_number })
        };
        read().unwrap_or_default()
    }
}

fn take<const N: usize>(bytes: &[u8]) -> Result<([u8; N], &[u8]), HelloError> {
    bytes.split_first_chunk::<N>().map(|(head, rest)| (*head, rest)).ok_or(HelloError::TooShort)
}
