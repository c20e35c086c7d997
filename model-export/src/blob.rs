//! The frame around a model: what a blob looks like in flash, and every reason to refuse one.
//!
//! ```text
//! offset  bytes  what
//!      0      8  magic, "CATHBLOB"
//!      8      2  schema version, little-endian
//!     10      2  zero
//!     12      4  length of the whole blob in bytes, little-endian
//!     16      4  CRC-32 (IEEE 802.3, as in zip) of every other byte of the blob
//!     20     32  SHA-256 of the payload: the model's identity
//!     52      .  payload: [`Model`] in postcard, and behind it the bytes of an [`Extension`](crate::compensation::Extension), if any
//! ```
//!
//! The CRC catches every single flipped bit, wherever it is, and is checked before anything else is believed; whoever builds a blob
//! with a valid CRC on purpose still meets [`Model::validate`].

use core::fmt;

use crate::schema::Model;
use crate::validate::Invalid;
#[cfg(feature = "std")]
use crate::wire::Writer;
use crate::wire::{Reader, Wire as _};

/// The first bytes of a blob.
pub const MAGIC: [u8; 8] = *b"CATHBLOB";
/// Newest version of the schema. Version 3 added layers other than LSTM and features of past inputs; a model without them is written in
/// version 2, so that firmware of before runs it.
pub const SCHEMA_VERSION: u16 = 3;
/// Oldest version that is read.
pub const OLDEST_SCHEMA_VERSION: u16 = 2;
/// Bytes in front of the payload.
pub const HEADER_BYTES: usize = 52;

/// Why a blob is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlobError {
    /// The first bytes are not those of a blob.
    Magic,
    /// Shorter than it says, or than any blob.
    Truncated {
        /// Bytes there should be.
        expected: usize,
        /// Bytes there are.
        found: usize,
    },
    /// Longer than it says.
    TooLong {
        /// Bytes there should be.
        expected: usize,
        /// Bytes there are.
        found: usize,
    },
    /// A bit has flipped somewhere.
    Checksum {
        /// CRC-32 in the header.
        stored: u32,
        /// CRC-32 of the bytes.
        computed: u32,
    },
    /// Made for another version of the firmware.
    SchemaVersion {
        /// The blob's version.
        found: u16,
    },
    /// A cell activation this firmware does not know.
    Activation {
        /// Its wire number.
        found: u8,
    },
    /// The payload does not decode.
    Payload,
    /// The payload decodes to a model that cannot be.
    Invalid(Invalid),
}

impl fmt::Display for BlobError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Magic => write!(formatter, "wrong magic: the file does not begin with CATHBLOB, so it is no model blob"),
            Self::Truncated { expected, found } => {
                write!(formatter, "truncated: {found} bytes of {expected}; copy the blob again")
            }
            Self::TooLong { expected, found } => {
                write!(formatter, "wrong length: {found} bytes where the header says {expected}; copy the blob again")
            }
            Self::Checksum { stored, computed } => {
                write!(formatter, "damaged: CRC-32 is {computed:08x}, the header says {stored:08x}; copy the blob again")
            }
            Self::SchemaVersion { found } => {
                write!(
                    formatter,
                    "wrong schema version: {found}, this build reads {OLDEST_SCHEMA_VERSION} to {SCHEMA_VERSION}; export the model again"
                )
            }
            Self::Activation { found } => {
                write!(formatter, "wrong activation: number {found}, this build knows 0 (tanh), 1 (relu) and 2 (hard)")
            }
            Self::Payload => write!(formatter, "the payload does not decode as a model; export the model again"),
            Self::Invalid(invalid) => write!(formatter, "the model cannot be: {invalid}"),
        }
    }
}

impl core::error::Error for BlobError {}

impl From<Invalid> for BlobError {
    fn from(invalid: Invalid) -> Self {
        Self::Invalid(invalid)
    }
}

/// CRC-32 (IEEE 802.3, reflected), continued from `crc`; start with 0.
#[must_use]
pub fn crc32(crc: u32, bytes: &[u8]) -> u32 {
    let mut register = !crc;
    for byte in bytes {
        register ^= u32::from(*byte);
        // Two table look-ups of four bits: 64 bytes of table instead of a kilobyte.
        for _ in 0..2 {
            let entry = NIBBLES.get(usize::try_from(register & 15).unwrap_or(0)).copied().unwrap_or(0);
            register = (register >> 4) ^ entry;
        }
    }
    !register
}

static NIBBLES: [u32; 16] = nibbles();

const fn nibbles() -> [u32; 16] {
    let mut table = [0u32; 16];
    let mut index = 0;
    let mut value = 0u32;
    while index < 16 {
        let mut register = value;
        let mut bit = 0;
        while bit < 4 {
            register = if register & 1 == 1 { (register >> 1) ^ 0xedb8_8320 } else { register >> 1 };
            bit += 1;
        }
        table[index] = register;
        index += 1;
        value += 1;
    }
    table
}

/// What the frame of a blob says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// SHA-256 of the payload.
    pub content_hash: [u8; 32],
    /// CRC-32 of the blob.
    pub crc: u32,
    /// Version of the schema it is written in.
    pub schema_version: u16,
}

/// A blob that passed every check.
#[derive(Clone, Debug, PartialEq)]
pub struct Blob<'a> {
    /// SHA-256 of the payload.
    pub content_hash: [u8; 32],
    /// CRC-32 of the blob.
    pub crc: u32,
    /// Version of the schema it is written in.
    pub schema_version: u16,
    /// The model; its arrays point into the blob.
    pub model: Model<'a>,
}

fn array<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

/// Reads and checks a blob without copying its arrays.
///
/// # Errors
/// The first of [`BlobError`] that applies; with `Ok` the model is safe to run whatever wrote it.
///
/// # Deadline
/// Not for the control tick: about 20 instructions a byte for the CRC.
pub fn decode(bytes: &[u8]) -> Result<Blob<'_>, BlobError> {
    let mut model = Model::default();
    let Header { content_hash, crc, schema_version } = decode_into(bytes, &mut model)?;
    Ok(Blob { content_hash, crc, schema_version, model })
}

/// As [`decode`], with the model in a place of the caller's: it is too long for a small stack.
///
/// # Errors
/// As [`decode`]; what is in the place then is no model.
pub fn decode_into<'a>(bytes: &'a [u8], model: &mut Model<'a>) -> Result<Header, BlobError> {
    let truncated = BlobError::Truncated { expected: HEADER_BYTES, found: bytes.len() };
    // A prefix of the magic is a blob cut short; anything else is no blob.
    if bytes.iter().zip(&MAGIC).any(|(found, expected)| found != expected) {
        return Err(BlobError::Magic);
    }
    let (Some(version), Some(length), Some(stored)) = (array(bytes, 8), array(bytes, 12), array(bytes, 16)) else {
        return Err(truncated);
    };
    let (Some(content_hash), Some(payload)) = (array(bytes, 20), bytes.get(HEADER_BYTES..)) else {
        return Err(truncated);
    };
    let (version, stored) = (u16::from_le_bytes(version), u32::from_le_bytes(stored));
    let expected = usize::try_from(u32::from_le_bytes(length)).unwrap_or(usize::MAX);
    if bytes.len() < expected {
        return Err(BlobError::Truncated { expected, found: bytes.len() });
    }
    if bytes.len() > expected {
        return Err(BlobError::TooLong { expected, found: bytes.len() });
    }
    let computed = checksum(bytes);
    if stored != computed {
        return Err(BlobError::Checksum { stored, computed });
    }
    if !(OLDEST_SCHEMA_VERSION..=SCHEMA_VERSION).contains(&version) {
        return Err(BlobError::SchemaVersion { found: version });
    }
    let mut reader = Reader::of_version(payload, version);
    model.read(&mut reader);
    let Some(extension) = reader.finish() else { return Err(BlobError::Payload) };
    model.extension = extension;
    if let Some(network) = &model.network
        && network.activation().is_err()
    {
        return Err(BlobError::Activation { found: network.activation_code });
    }
    model.validate()?;
    Ok(Header { content_hash, crc: stored, schema_version: version })
}

/// The CRC-32 that a blob's header must carry.
fn checksum(bytes: &[u8]) -> u32 {
    let before = bytes.get(..16).unwrap_or(&[]);
    let after = bytes.get(20..).unwrap_or(&[]);
    crc32(crc32(0, before), after)
}

/// Makes a blob of a model.
///
/// # Errors
/// When the model is invalid or does not fit in 4 GiB.
#[cfg(feature = "std")]
pub fn encode(model: &Model<'_>) -> Result<std::vec::Vec<u8>, BlobError> {
    use sha2::Digest;

    model.validate()?;
    let version = model.schema_version();
    let mut payload = payload(model, version);
    payload.extend_from_slice(model.extension);
    let length = u32::try_from(HEADER_BYTES + payload.len()).map_err(|_| BlobError::Payload)?;
    let mut bytes = std::vec::Vec::with_capacity(HEADER_BYTES + payload.len());
    bytes.extend(MAGIC);
    bytes.extend(version.to_le_bytes());
    bytes.extend([0; 2]);
    bytes.extend(length.to_le_bytes());
    bytes.extend([0; 4]);
    bytes.extend(sha2::Sha256::digest(&payload));
    bytes.extend(payload);
    seal(&mut bytes);
    Ok(bytes)
}

/// The model on the wire.
#[cfg(feature = "std")]
fn payload(model: &Model<'_>, version: u16) -> std::vec::Vec<u8> {
    // What a model of three full layers takes; a longer one is tried again.
    let mut place = std::vec![0; 1 << 16];
    loop {
        let mut writer = Writer::of_version(&mut place, version);
        model.write(&mut writer);
        match writer.finish() {
            Some(length) => {
                place.truncate(length);
                return place;
            }
            None => place.resize(2 * place.len(), 0),
        }
    }
}

/// Writes the CRC-32 into a blob's header.
#[cfg(feature = "std")]
fn seal(bytes: &mut [u8]) {
    let crc = checksum(bytes).to_le_bytes();
    if let Some(field) = bytes.get_mut(16..20) {
        field.copy_from_slice(&crc);
    }
}

/// First bytes of the content hash that a blob carries, by which models are told apart on the link.
#[must_use]
pub fn content_id(bytes: &[u8]) -> Option<[u8; 8]> {
    array(bytes, 20)
}

/// Whether the content hash in the header is that of the payload; the CRC alone does not prove identity.
#[cfg(feature = "std")]
#[must_use]
pub fn content_hash_matches(bytes: &[u8]) -> bool {
    use sha2::Digest;

    match (array::<32>(bytes, 20), bytes.get(HEADER_BYTES..)) {
        (Some(stored), Some(payload)) => sha2::Sha256::digest(payload)[..] == stored[..],
        _ => false,
    }
}
