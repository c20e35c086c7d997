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
//!
//! # Example
//! ```
//! use model_export::blob::{Blob, BlobError, HEADER_BYTES, Header, MAGIC, OLDEST_SCHEMA_VERSION, SCHEMA_VERSION, crc32};
//! use model_export::blob::{content_id, decode, decode_into};
//! use model_export::schema::{Channel, FrontEnd, Model};
//!
//! assert_eq!(decode(b"no blob at all"), Err(BlobError::Magic));
//! assert!(matches!(decode(&MAGIC), Err(BlobError::Truncated { expected: HEADER_BYTES, found: 8 })));
//! assert_eq!(crc32(0, b"123456789"), 0xcbf4_3926);
//!
//! // A physics model of pressure in bar and displacement in mm, with two play operators.
//! let front_end = FrontEnd {
//!     lag_coefficient: 1.0,
//!     play_thresholds: [0.0, 0.1].into_iter().collect(),
//!     play_weights: [0.5, 0.5].into_iter().collect(),
//!     ..FrontEnd::default()
//! };
//! let input = Channel { quantity: "pressure", unit: "bar", offset: 0.0, scale: 3.0, minimum: 0.0, maximum: 3.0 };
//! let output = Channel { quantity: "displacement", unit: "mm", offset: 0.0, scale: 10.0, minimum: 0.0, maximum: 10.0 };
//! let model = Model { sample_period_s: 0.02, input, output, front_end, ..Model::default() };
//!
//! # #[cfg(feature = "std")] {
//! use model_export::blob::{content_hash_matches, encode};
//!
//! let bytes = encode(&model)?;
//! assert!(content_hash_matches(&bytes));
//! let Blob { model: read, schema_version, content_hash, .. } = decode(&bytes)?;
//! assert_eq!(read, model);
//! assert!((OLDEST_SCHEMA_VERSION..=SCHEMA_VERSION).contains(&schema_version));
//! assert_eq!(content_id(&bytes).as_ref(), content_hash.first_chunk());
//!
//! let mut place = Model::default();
//! let header: Header = decode_into(&bytes, &mut place)?;
//! assert_eq!(header.content_hash, content_hash);
//! # }
//! # Ok::<(), BlobError>(())
//! ```

use core::fmt;

use crc::{CRC_32_ISO_HDLC, Crc};
use serde::Deserialize;

use crate::schema::{Model, Network, Stages};
use crate::several_inputs::SeveralInputs;
use crate::validate::Invalid;
use crate::version_2::LstmNetwork;

/// The first bytes of a blob.
pub const MAGIC: [u8; 8] = *b"CATHBLOB";
/// Newest version of the schema. Version 3 added layers other than LSTM and features of past inputs, version 4 several inputs, version 5
/// further stages of the front end; a model is written in the oldest version that has room for it, so that firmware of before runs it.
pub const SCHEMA_VERSION: u16 = 5;
/// Version from which on a model may have several inputs.
const SEVERAL_INPUTS_VERSION: u16 = 4;
/// Version from which on a model may have further stages.
const STAGES_VERSION: u16 = 5;
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

/// The checksum of frames, blobs, settings and the program: CRC-32 of IEEE 802.3, as in zip.
pub static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// That checksum, continued from `crc`; start with 0.
#[must_use]
pub fn crc32(crc: u32, bytes: &[u8]) -> u32 {
    // The crate begins with a register in the order of the polynomial's bits; the checksum is its complement in reflected order.
    let mut digest = CRC.digest_with_initial((!crc).reverse_bits());
    digest.update(bytes);
    digest.finalize()
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
    model.extension = take_model(payload, version, model).map_err(|_| BlobError::Payload)?;
    if let Some(network) = &model.network
        && network.activation().is_err()
    {
        return Err(BlobError::Activation { found: network.activation_code });
    }
    model.validate()?;
    Ok(Header { content_hash, crc: stored, schema_version: version })
}

/// Reads the fields one after the other into their places, and gives the bytes behind. What `postcard::take_from_bytes` makes of the
/// whole would stand on the microcontroller's stack as often as serde passes it up.
fn take_model<'a>(payload: &'a [u8], version: u16, model: &mut Model<'a>) -> postcard::Result<&'a [u8]> {
    // Every field by name, so that a new one cannot be forgotten; a test holds the order.
    let Model {
        sample_period_s,
        mode,
        input,
        output,
        front_end,
        network,
        provenance,
        metrics,
        envelope,
        golden,
        more_inputs,
        extension: _,
    } = model;
    more_inputs.clear();
    let rest = take(payload, sample_period_s)?;
    let rest = take(rest, mode)?;
    let rest = take(rest, input)?;
    let rest = take(rest, output)?;
    let rest = take(rest, front_end)?;
    let rest = if version == OLDEST_SCHEMA_VERSION { take_lstm_network(rest, network)? } else { take(rest, network)? };
    let rest = take(rest, provenance)?;
    let rest = take(rest, metrics)?;
    let rest = take(rest, envelope)?;
    let rest = take(rest, golden)?;
    if version < SEVERAL_INPUTS_VERSION {
        return Ok(rest);
    }
    let mut several = SeveralInputs::default();
    let rest = take(rest, &mut several)?;
    several.put_into(model);
    if version < STAGES_VERSION {
        return Ok(rest);
    }
    take(rest, model.front_end.stages.insert(Stages::default()))
}

#[inline(never)]
fn take<'a, T: Deserialize<'a>>(bytes: &'a [u8], place: &mut T) -> postcard::Result<&'a [u8]> {
    let (value, rest) = postcard::take_from_bytes(bytes)?;
    *place = value;
    Ok(rest)
}

#[inline(never)]
fn take_lstm_network<'a>(bytes: &'a [u8], place: &mut Option<Network<'a>>) -> postcard::Result<&'a [u8]> {
    let (network, rest) = postcard::take_from_bytes::<Option<LstmNetwork<'a>>>(bytes)?;
    *place = network.map(Network::from);
    Ok(rest)
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
    let mut payload = payload(model, version).map_err(|_| BlobError::Payload)?;
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
    write_crc(&mut bytes);
    Ok(bytes)
}

/// The model on the wire.
#[cfg(feature = "std")]
fn payload(model: &Model<'_>, version: u16) -> postcard::Result<std::vec::Vec<u8>> {
    if version >= SEVERAL_INPUTS_VERSION {
        let mut payload = postcard::to_allocvec(model)?;
        payload.extend(postcard::to_allocvec(&SeveralInputs::of(model))?);
        if let Some(stages) = &model.front_end.stages {
            payload.extend(postcard::to_allocvec(stages)?);
        }
        return Ok(payload);
    }
    if version != OLDEST_SCHEMA_VERSION {
        return postcard::to_allocvec(model);
    }
    let network = model.network.as_ref().map(LstmNetwork::from);
    let Model { sample_period_s, mode, input, output, front_end, network: _, provenance, metrics, envelope, golden, .. } = model;
    postcard::to_allocvec(&(sample_period_s, mode, input, output, front_end, network, provenance, metrics, envelope, golden))
}

/// Writes the CRC-32 into a blob's header.
#[cfg(feature = "std")]
fn write_crc(bytes: &mut [u8]) {
    let crc = checksum(bytes).to_le_bytes();
    if let Some(field) = bytes.get_mut(16..20) {
        field.copy_from_slice(&crc);
    }
}

/// First bytes of the content hash that a blob carries, by which the link distinguishes models.
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

#[cfg(all(test, feature = "std"))]
mod tests {
    use std::vec::Vec;

    use super::*;
    use crate::schema::{Activation, Cell, Curve, Feature, FeatureSource, Filter, Flow, Growth, Layer};

    const WEIGHTS: [u8; 8] = [1, 2, 3, 4, 5, 6, 7, 8];

    fn model(cell: Cell) -> Model<'static> {
        let layer =
            Layer { cell, inputs: 3, units: 300, input_weights: &WEIGHTS, biases: &WEIGHTS[2..], cell_limit: -2, ..Layer::default() };
        let mut model = Model { sample_period_s: 0.02, ..Model::default() };
        model.input.quantity = "pressure";
        model.output.unit = "mm";
        model.front_end.play_thresholds = [0.0, 0.5].into_iter().collect();
        model.front_end.features.push(Feature { source: FeatureSource::Stop(1), offset: 0.5, gain: 2.0 }).unwrap();
        let mut network = Network { activation_code: 2, layers: [layer.clone(), layer].into_iter().collect(), ..Network::default() };
        network.dense.scale = 0.25;
        model.network = Some(network);
        model.provenance.preset = "hybrid";
        model.metrics.calibration_samples = 70_000;
        model.envelope.maximum_rate = 4.0;
        model.golden.digest = 0xdead_beef;
        model
    }

    /// Field by field is the same as all at once, as serde's derive has it.
    #[test]
    fn fields_are_read_in_the_order_of_their_declaration() {
        for cell in [Cell::Lstm, Cell::Gru, Cell::Dense(Activation::Hard)] {
            let model = model(cell);
            let bytes = [payload(&model, SEVERAL_INPUTS_VERSION).unwrap(), [7, 7].to_vec()].concat();
            let (whole, _) = postcard::take_from_bytes::<Model<'_>>(&bytes).unwrap();
            let mut taken = Model::default();
            assert_eq!(take_model(&bytes, SEVERAL_INPUTS_VERSION, &mut taken), Ok(&[7, 7][..]));
            assert_eq!((&taken, &whole), (&model, &model));
        }
    }

    /// What stands behind the model from version 5 on, and that none of it is left in a place that is used again.
    #[test]
    fn stages_stand_behind_the_model() {
        let curve = Curve { slope: 1.0, bend_points: [0.5].into_iter().collect(), bends: [-0.5].into_iter().collect(), ..Curve::default() };
        let filter = Filter { momentum: 0.5, gains: [0.25, 0.125, 0.0] };
        let stages = Stages {
            supply: Some(curve.clone()),
            flow: Some(Flow { fill: curve.clone(), vent: curve.clone() }),
            line: Some(filter),
            muscle: Some(curve.clone()),
            growth: Some(Growth { per_path: [0.5, 0.0], law: curve.clone(), share: 2.0, follow: Some(curve), ..Growth::default() }),
            tip: Some(filter),
        };
        let mut staged = model(Cell::Lstm);
        staged.front_end.stages = Some(stages);
        assert_eq!(staged.schema_version(), STAGES_VERSION);
        let plain = model(Cell::Lstm);
        let bytes = [payload(&staged, STAGES_VERSION).unwrap(), [7, 7].to_vec()].concat();
        let plain_bytes = payload(&plain, plain.schema_version()).unwrap();
        let mut taken = Model::default();
        assert_eq!(take_model(&bytes, STAGES_VERSION, &mut taken), Ok(&[7, 7][..]));
        assert_eq!(taken, staged);
        assert_eq!(take_model(&plain_bytes, plain.schema_version(), &mut taken), Ok(&[][..]));
        assert_eq!(taken, plain);
    }

    /// Version 2 is version 3 without one byte in each layer, which is zero for LSTM.
    #[test]
    fn a_network_of_version_2_says_no_cell() {
        let model = model(Cell::Lstm);
        let (old, new) = (payload(&model, 2).unwrap(), payload(&model, 3).unwrap());
        assert_eq!(old.len() + 2, new.len());
        let mut taken = Model::default();
        assert_eq!(take_model(&old, 2, &mut taken), Ok(&[][..]));
        assert_eq!(taken, model);
        // Where the two begin to differ stands the first layer's cell.
        let at = old.iter().zip(&new).position(|(old, new)| old != new).unwrap();
        assert_eq!(new.iter().skip(at - 1).take(2).copied().collect::<Vec<_>>(), [2, 0]);
    }
}
