//! Requests, replies and telemetry, as postcard encodes them.
//!
//! Every request carries a token that its reply repeats. The order of enum variants and struct fields is the wire format: append, never
//! insert; `tests/link/examples.rs` holds the bytes of an example of each.
//!
//! # Example
//! ```
//! use model_export::link::message::{Baseline, ControlReport, FaultRecord, MAX_CHUNK_BYTES, MAX_CHUNK_POINTS, MAX_PAGE, Message, MessageError};
//! use model_export::link::message::{PlaybackChunk, Quantity, Refusal, Reply, ReplyFrame, Request, RequestFrame, SettingDifference, Status};
//! use model_export::link::settings::SettingValue;
//! use model_export::link::state::State;
//!
//! // What a host asks: a set-point of 1.5 bar, and a piece of an experiment.
//! let set_point = Request::SetPoint { quantity: Quantity::Pressure, value: 1.5 };
//! assert!(!set_point.only_asks() && Request::Status.only_asks());
//! let values_bar = [0.0, 0.5, 1.0].into_iter().collect();
//! let chunk = PlaybackChunk { first_index: 0, last: true, values_bar };
//! assert!(chunk.values_bar.len() <= MAX_CHUNK_POINTS && !Request::Playback(chunk).only_asks());
//! assert!(Request::ModelFinish.is_beyond_a_trace());
//! let frame = RequestFrame { token: 2, session: 7, request: set_point };
//! let wire = frame.to_wire()?;
//! assert!(wire.len() < MAX_CHUNK_BYTES);
//!
//! // What a device answers: done, refused, or what was asked for.
//! for reply in [
//!     Reply::Done,
//!     Reply::Refused(Refusal::State(State::Running)),
//!     Reply::Status(Status::default()),
//!     Reply::FaultRecord(FaultRecord::default()),
//!     Reply::ControlReport(ControlReport { ticks: 20_000, ..ControlReport::default() }),
//!     Reply::Differences { entries: [SettingDifference::default(); MAX_PAGE].into_iter().collect(), next_number: 0 },
//! ] {
//!     let mut wire = Default::default();
//!     ReplyFrame { token: 2, reply }.encode_into(&mut wire)?;
//! }
//! assert_eq!(ReplyFrame::from_payload(&[]), Err(MessageError::Kind));
//! let asked = Request::SettingsDifference { baseline: Baseline::Defaults, from_number: 0 };
//! assert!(asked.only_asks());
//! # let _ = SettingValue::Flag(true);
//! # Ok::<(), MessageError>(())
//! ```

use heapless::Vec;

use serde::{Deserialize, Serialize};

use super::adaptation::AdaptationReport;
pub use super::codec::{Message, MessageError};
use super::fault::{BlockerSet, FaultSet, NoticeSet};
use super::history::HistoryPiece;
use super::kind::Kind;
use super::settings::{SettingError, SettingValue};
use super::state::{ResetCause, State};
pub use super::telemetry::{RestNoise, Telemetry};

/// Most points of a playback chunk.
pub const MAX_CHUNK_POINTS: usize = 32;
/// Most bytes of a model chunk; a multiple of the flash's word.
pub const MAX_CHUNK_BYTES: usize = 256;
/// Most entries of a settings page: few, so that a page is no longer than a status and a queue of replies stays short.
pub const MAX_PAGE: usize = 4;

/// Physical quantity of a set-point; a control law refuses one it does not understand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Quantity {
    /// In bar.
    #[default]
    Pressure,
    /// In mm.
    Displacement,
}

/// A piece of an experiment to play back.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PlaybackChunk {
    /// Index of the first point since the playback began; must continue where the last chunk ended.
    pub first_index: u32,
    /// Whether the experiment ends with this chunk.
    pub last: bool,
    /// Pressures in bar, or displacements in mm for a control law that tracks, one each playback period.
    pub values_bar: Vec<f32, MAX_CHUNK_POINTS>,
}

/// Which settings to compare the ones in use with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Baseline {
    /// What the device starts with.
    #[default]
    Saved,
    /// What a device nobody has set up has.
    Defaults,
}

/// What the host asks for.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Request {
    /// State, fault, blockers, counters.
    #[default]
    Status,
    /// Idle to armed.
    Arm,
    /// To idle, vented.
    Disarm,
    /// Armed to running.
    Start,
    /// Running to armed, output to zero at the slew limit.
    Stop,
    /// To idle at once, vented; never refused.
    Vent,
    /// Clear the latched fault and test again.
    Acknowledge,
    /// One set-point for the set-point control laws.
    SetPoint {
        /// Its quantity.
        quantity: Quantity,
        /// Its value, in the quantity's unit.
        value: f32,
    },
    /// A piece of an experiment for the playback control law.
    Playback(PlaybackChunk),
    /// Forget the playback buffer and its index.
    PlaybackClear,
    /// One setting in use.
    SettingGet {
        /// Its number.
        number: u16,
    },
    /// Change one setting in use; refused unless vented.
    SettingSet {
        /// Its number.
        number: u16,
        /// Its new value.
        value: SettingValue,
    },
    /// A page of settings that differ from a baseline.
    SettingsDifference {
        /// What to compare with.
        baseline: Baseline,
        /// Skip settings with lower numbers.
        from_number: u16,
    },
    /// Write the settings in use to flash; refused unless idle or in the fault state.
    SettingsSave,
    /// Go back to a baseline; refused unless vented.
    SettingsRevert(Baseline),
    /// Begin a model upload into the slot that is not active; refused unless idle or in the fault state.
    ModelBegin {
        /// Length of the blob in bytes.
        length: u32,
        /// CRC-32 of the blob.
        crc32: u32,
    },
    /// A piece of the blob; pieces come in order.
    ModelChunk {
        /// Where the piece belongs.
        offset: u32,
        /// Its bytes; a multiple of four except in the last piece.
        bytes: Vec<u8, MAX_CHUNK_BYTES>,
    },
    /// Check the upload and make it whole, without activating it.
    ModelFinish,
    /// Make this whole model the active one and test again; nothing if it is that already, so that a repeated request does no harm.
    ModelActivate {
        /// First bytes of its content hash.
        id: [u8; 8],
    },
    /// Which models are whole.
    Models,
    /// The fault record of this run.
    FaultRecord,
    /// The fault record that survived the last reset.
    PreviousFaultRecord,
    /// What the controllers did since the start of the run.
    ControlReport,
    /// Begin again, as after a start, and tell every tick from then on ([`super::trace`]); refused unless idle and vented. The answer is the status
    /// just before.
    TraceBegin,
    /// Tell no more ticks.
    TraceEnd,
    /// What adaptation learned since it was reset.
    AdaptationReport,
    /// The last ticks before a fault ([`super::history`]), of this run or the one before.
    History {
        /// The row to begin with, the oldest being zero.
        from_row: u16,
    },
    /// Start again in the chip's own bootloader, which takes a new program over this line; refused unless vented. The answer comes before.
    EnterBootloader,
    /// How much the measured channels scatter while the rig is vented.
    RestNoise,
}

impl Request {
    /// Whether it changes nothing, so that asking again after a restart of the device is always right.
    pub const fn only_asks(&self) -> bool {
        matches!(
            self,
            Self::Status
                | Self::SettingGet { .. }
                | Self::SettingsDifference { .. }
                | Self::FaultRecord
                | Self::PreviousFaultRecord
                | Self::ControlReport
                | Self::AdaptationReport
                | Self::Models
                | Self::History { .. }
                | Self::RestNoise
        )
    }

    /// Whether it may bring in what a trace does not tell: another model, or settings that only the device has.
    pub const fn is_beyond_a_trace(&self) -> bool {
        matches!(
            self,
            Self::ModelBegin { .. }
                | Self::ModelChunk { .. }
                | Self::ModelFinish
                | Self::ModelActivate { .. }
                | Self::SettingsRevert(Baseline::Saved)
                | Self::EnterBootloader
        )
    }
}

/// A request with its token.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RequestFrame {
    /// Chosen by the host, each higher than those before in the session; the reply repeats it. A request with a token that is not higher is an old
    /// one: it is dropped and counted.
    pub token: u32,
    /// The session that the last Hello began ([`super::hello::Hello::session`]). A request of another one is refused.
    pub session: u32,
    /// What is asked for.
    pub request: Request,
}

/// Why a request was not carried out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// Named reasons against arming or starting.
    Blocked(BlockerSet),
    /// Not in this state.
    State(State),
    /// The frame was sound but this version does not understand the request.
    #[default]
    NotUnderstood,
    /// The device has more to do than it can queue; try again.
    Busy,
    /// The setting was not changed.
    Setting(SettingError),
    /// The settings do not go together; the number is the first one to blame.
    SettingsInconsistent(u16),
    /// The active control law does not take this quantity.
    WrongQuantity,
    /// The value is not a number.
    NotFinite,
    /// Playback continues at this index, not at the chunk's.
    PlaybackIndex(u32),
    /// The playback buffer has room for this many points only.
    PlaybackFull(u16),
    /// No upload is under way.
    NoUpload,
    /// The upload continues at this offset, not at the piece's.
    UploadOffset(u32),
    /// The blob is longer than the slot (bytes).
    TooLong(u32),
    /// The blob's checksum is wrong after writing.
    Checksum,
    /// The piece is not a multiple of four bytes, or goes beyond the announced length.
    PieceLength,
    /// The blob is sound but no model this firmware can run.
    NotAModel,
    /// There is no other whole model.
    NoOtherModel,
    /// The flash memory could not be erased or written.
    Storage,
    /// There is no such record.
    NoRecord,
    /// The slot has been activated too often to be activated again: upload the model again.
    LogFull,
    /// Not while a trace runs.
    Traced,
    /// Adaptation has no certificate with these settings; the number of the first condition that fails
    /// ([`super::fault::AdaptationCondition`]).
    Uncertified(u8),
    /// The blob is a sound model whose step takes more than its share of a tick.
    ModelTooSlow,
    /// The request belongs to no session or to another one: somebody has said Hello since.
    OtherSession,
    /// The blob is a sound model of several inputs, of which this firmware measures one.
    ModelInputs,
}

/// Entry of a settings page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SettingDifference {
    /// The setting's number.
    pub number: u16,
    /// Value in use.
    pub in_use: SettingValue,
    /// Value in the baseline.
    pub baseline: SettingValue,
}

/// What the device is and does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// State.
    pub state: State,
    /// Number of the first fault, 0 without one.
    pub first_fault: u8,
    /// Every fault since the last acknowledgement.
    pub faults: FaultSet,
    /// What would refuse arming now.
    pub blockers: BlockerSet,
    /// What is limited or degraded now.
    pub notices: NoticeSet,
    /// Ticks since the start, 1 ms each.
    pub time_ms: u64,
    /// Ticks that came late or were lost since the start.
    pub late_ticks: u32,
    /// Longest tick since the start, in processor cycles; 0 if not measured.
    pub longest_tick_cycles: u32,
    /// Bytes of stack never used since the start; 0 if not measured.
    pub stack_unused_bytes: u32,
    /// Frames received that were damaged, or whose token was not higher than those before.
    pub damaged_frames: u32,
    /// Telemetry samples dropped since the start.
    pub telemetry_dropped: u32,
    /// Why the device last started.
    pub reset_cause: ResetCause,
    /// Whether the settings in use differ from the saved ones.
    pub settings_unsaved: bool,
    /// Index of the next playback point the device expects.
    pub playback_next_index: u32,
    /// Playback points the device has room for.
    pub playback_free: u16,
}

/// The first fault with its context.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FaultRecord {
    /// Number of the first fault, 0 without one.
    pub first: u8,
    /// Number of the second, 0 without one.
    pub second: u8,
    /// All faults since the last acknowledgement.
    pub all: FaultSet,
    /// Time of the first fault, ms since the start.
    pub time_ms: u64,
    /// State in which it struck.
    pub state: State,
    /// Output at that moment.
    pub output_ubar: i32,
    /// Pressure and laser codes at that moment.
    pub pressure_code: u16,
    /// See `pressure_code`.
    pub laser_code: u16,
    /// Last good measured pressure.
    pub pressure_bar: f32,
    /// Last good displacement.
    pub displacement_mm: f32,
    /// Last estimate, NaN without one.
    pub estimate_mm: f32,
    /// Set-point then in force.
    pub set_point: f32,
    /// Ticks that had come late.
    pub late_ticks: u32,
}

/// What the controllers did since the run began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ControlReport {
    /// Ticks with a set-point.
    pub ticks: u32,
    /// Ticks of them in which the limiter held the output back.
    pub limited_ticks: u32,
    /// Ticks of them in which the model saw what it was not trained on.
    pub outside_domain_ticks: u32,
    /// Ticks of them in which a simpler feed-forward stood in for the chosen one.
    pub fallback_ticks: u32,
    /// What the feedback adds to the reference, mm.
    pub correction_mm: f32,
    /// Laser and model blended, mm; NaN with neither.
    pub blend_mm: f32,
    /// Bound on the blend's error, mm; NaN with neither.
    pub bound_mm: f32,
}

/// What the device answers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Reply {
    /// Carried out.
    #[default]
    Done,
    /// Not carried out.
    Refused(Refusal),
    /// Answer to [`Request::Status`].
    Status(Status),
    /// Answer to [`Request::Playback`]: the buffer has taken the chunk.
    Playback {
        /// Index the next chunk must begin with.
        next_index: u32,
        /// Points there is room for.
        free: u16,
    },
    /// Answer to [`Request::SettingGet`].
    Setting(SettingValue),
    /// Answer to [`Request::SettingsDifference`].
    Differences {
        /// The page.
        entries: Vec<SettingDifference, MAX_PAGE>,
        /// Where the next page begins; zero at the end.
        next_number: u16,
    },
    /// Answer to [`Request::ModelChunk`]: offset of the next piece.
    Uploaded(u32),
    /// Answer to the record requests.
    FaultRecord(FaultRecord),
    /// Answer to [`Request::ControlReport`].
    ControlReport(ControlReport),
    /// Answer to [`Request::AdaptationReport`].
    AdaptationReport(AdaptationReport),
    /// Answer to [`Request::Models`]: first bytes of the content hashes, zero without a model.
    Models {
        /// The active one, whether or not it passed its self-test.
        active: [u8; 8],
        /// The one that could be activated.
        other: [u8; 8],
    },
    /// Answer to [`Request::History`].
    History(HistoryPiece),
    /// Answer to [`Request::RestNoise`].
    RestNoise(RestNoise),
}

/// A reply with its request's token.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ReplyFrame {
    /// The request's token.
    pub token: u32,
    /// The answer.
    pub reply: Reply,
}

impl Message for RequestFrame {
    const KIND: Kind = Kind::Request;
}

impl Message for ReplyFrame {
    const KIND: Kind = Kind::Reply;
}

impl Message for Telemetry {
    const KIND: Kind = Kind::Telemetry;
}
