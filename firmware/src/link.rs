//! The link's device side: bytes in, commands for the tick, frames out.
//!
//! The link runs in the background. It owns the settings in use and the two flash stores, and reaches the rig only through commands that the board
//! queues ([`CommandSink`]) and answers that come back. Replies go before telemetry; telemetry is best effort: what does not fit the queue
//! is dropped and counted. Nothing here is called from the tick.
//!
//! # How a board drives it
//!
//! 1. [`Link::new`] with the two stores; [`Link::settings`] and [`Link::boot_faults`] go into the rig.
//! 2. For every received byte: [`Link::receive`]. An [`Event`] may come of it.
//! 3. For every answer and telemetry sample that the tick put out: [`Link::answer`], [`Link::telemetry`]; after each tick or before each byte
//!    [`Link::observe`] with the state.
//! 4. Whenever the line is free: [`Link::transmit`] gives the next frame.
//! 5. On [`Event::ModelChanged`] queue a `Retest`; the rig then asks for the self-test, after which [`Link::set_model`] gets the result.

use heapless::{Deque, Vec};
use model_export::blob::crc32;
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::frame::{self, Decoder, MAX_WIRE};
use model_export::link::hello::{Hello, MAX_BOARD_NAME};
use model_export::link::message::{
    Baseline, FaultRecord, MAX_PAGE, Message, MessageError, Refusal, Reply, ReplyFrame, Request, RequestFrame, SettingDifference, Telemetry,
};
use model_export::link::settings::Settings;
use model_export::link::state::{ResetCause, State};
use model_export::link::{Kind, PROTOCOL, SCHEMA_HASH};

use crate::control::SetPoint;
use crate::model::{self, ModelFacts};
use crate::settings::{self, STORE_KIND, STORE_VERSION, Stored};
use crate::storage::{Flash, Slot, StorageError, Store, Upload};
use crate::supervisor;
use crate::tick::{Action, Answer, Command, RigFacts, Tick, TickConfig};

/// Replies waiting for the line.
pub const REPLY_QUEUE: usize = 4;
/// Telemetry samples waiting for the line.
pub const TELEMETRY_QUEUE: usize = 8;

/// Where commands for the tick go: on a board a queue of a few places.
pub trait CommandSink {
    /// Queues a command; `false` if the queue is full and the command is dropped.
    #[must_use]
    fn send(&mut self, command: Command) -> bool;

    /// Makes the next tick vent ([`crate::tick::TickInputs::vent`]), however full the queue is.
    fn vent(&mut self);
}

/// What the device says of itself.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkConfig {
    /// Firmware version: major, minor, patch.
    pub firmware: [u16; 3],
    /// Name of the board.
    pub board: heapless::String<MAX_BOARD_NAME>,
    /// Why it started.
    pub reset_cause: ResetCause,
    /// The fault record of the run before, if one survived.
    pub previous_record: Option<FaultRecord>,
    /// The board's converter, for building settings.
    pub facts: RigFacts,
}

/// What the board measures about itself, for the status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Measured {
    /// Longest tick in processor cycles.
    pub longest_tick_cycles: u32,
    /// Bytes of stack never used.
    pub stack_unused_bytes: u32,
}

/// What the board must do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Another model is active: load it and test again.
    ModelChanged,
}

/// A change of settings on its way through the tick.
#[derive(Clone, Debug)]
struct Candidate {
    token: u16,
    settings: Settings,
}

/// The link with its stores.
#[derive(Debug)]
pub struct Link<S, M> {
    config: LinkConfig,
    settings_store: Store<S>,
    model_store: Store<M>,
    decoder: Decoder,
    settings: Settings,
    saved: Settings,
    boot_faults: FaultSet,
    candidate: Option<Candidate>,
    upload: Option<Upload>,
    model: Option<ModelFacts>,
    state: State,
    awaited: u16,
    measured: Measured,
    damaged_frames: u32,
    telemetry_dropped: u32,
    hello_wanted: bool,
    replies: Deque<ReplyFrame, REPLY_QUEUE>,
    telemetry: Deque<Telemetry, TELEMETRY_QUEUE>,
}

impl<S: Flash, M: Flash> Link<S, M> {
    /// A link over two pairs of flash slots. Settings come from flash, or are the defaults if flash has none that go together.
    pub fn new(config: LinkConfig, settings_flash: S, model_flash: M) -> Self {
        let settings_store = Store::new(settings_flash, STORE_KIND, STORE_VERSION);
        let model_store = Store::new(model_flash, model::STORE_KIND, model::STORE_VERSION);
        let mut boot_faults = FaultSet::EMPTY;
        let stored = settings_store.active_payload().map(settings::decode).unwrap_or_default();
        let fallback = settings_store.select().is_fallback;
        let Stored { settings, rejected, is_damaged, .. } = stored;
        let goes_together = TickConfig { settings: &settings, facts: config.facts }.build().is_ok();
        boot_faults.insert_if(fallback || is_damaged || rejected > 0 || !goes_together, Fault::SettingsInvalid);
        boot_faults.insert_if(model_store.select().is_fallback, Fault::ModelCorrupt);
        let settings = if goes_together { settings } else { Settings::default() };
        Self {
            config,
            settings_store,
            model_store,
            decoder: Decoder::new(),
            saved: settings.clone(),
            settings,
            boot_faults,
            candidate: None,
            upload: None,
            model: None,
            state: State::Boot,
            awaited: 0,
            measured: Measured::default(),
            damaged_frames: 0,
            telemetry_dropped: 0,
            hello_wanted: false,
            replies: Deque::new(),
            telemetry: Deque::new(),
        }
    }

    /// The settings in use.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What was wrong with the stores at the start.
    pub fn boot_faults(&self) -> FaultSet {
        self.boot_faults
    }

    /// The active model's blob, for the self-test.
    pub fn model_blob(&self) -> Option<&[u8]> {
        self.model_store.active_payload()
    }

    /// The slot it lies in.
    pub fn model_slot(&self) -> Option<Slot> {
        self.model_store.select().active
    }

    /// The stores' flash, settings first.
    pub fn flash(&self) -> (&S, &M) {
        (self.settings_store.flash(), self.model_store.flash())
    }

    /// Gives the flash back, settings first.
    pub fn release(self) -> (S, M) {
        (self.settings_store.release(), self.model_store.release())
    }

    /// Tells which model passed the self-test.
    pub fn set_model(&mut self, model: Option<ModelFacts>) {
        self.model = model;
    }

    /// Tells the state the rig is in.
    pub fn observe(&mut self, state: State, measured: Measured) {
        self.state = state;
        self.measured = measured;
    }

    /// Telemetry samples dropped so far: what the tick writes into the next sample.
    pub fn telemetry_dropped(&self) -> u32 {
        self.telemetry_dropped
    }

    /// Takes one byte from the line.
    pub fn receive(&mut self, byte: u8, commands: &mut impl CommandSink, check_model: impl FnMut(&[u8]) -> bool) -> Option<Event> {
        let payload = match self.decoder.push(byte)? {
            Ok(payload) => payload,
            Err(_) => {
                self.damaged_frames = self.damaged_frames.saturating_add(1);
                return None;
            }
        };
        match payload.first().copied().and_then(Kind::from_byte) {
            Some(Kind::HelloRequest) => self.hello_wanted = true,
            Some(Kind::Request) => match RequestFrame::from_payload(&payload) {
                Ok(frame) => return self.request(frame, commands, check_model),
                Err(_) => {
                    // The token comes first on the wire, so that even a request of a later version gets its refusal.
                    let token = payload.get(1..).and_then(|body| postcard::take_from_bytes::<u16>(body).ok());
                    if let Some((token, _)) = token {
                        self.reply(token, Reply::Refused(Refusal::NotUnderstood));
                    }
                }
            },
            _ => self.damaged_frames = self.damaged_frames.saturating_add(1),
        }
        None
    }

    /// Takes an answer of the tick.
    pub fn answer(&mut self, answer: Answer) {
        self.awaited = self.awaited.saturating_sub(1);
        let Answer { token, mut reply } = answer;
        if let Some(candidate) = self.candidate.take_if(|candidate| candidate.token == token)
            && matches!(reply, Reply::Done)
        {
            self.settings = candidate.settings;
        }
        if let Reply::Status(status) = &mut reply {
            status.longest_tick_cycles = self.measured.longest_tick_cycles;
            status.stack_unused_bytes = self.measured.stack_unused_bytes;
            status.damaged_frames = self.damaged_frames;
            status.telemetry_dropped = self.telemetry_dropped;
            status.settings_unsaved = self.settings != self.saved;
        }
        self.reply(token, reply);
    }

    /// Takes a telemetry sample of the tick; drops it if the line is too slow.
    pub fn telemetry(&mut self, sample: Telemetry) {
        if self.telemetry.push_back(sample).is_err() {
            self.drop_telemetry(1);
        }
    }

    /// Counts samples that were lost before they came here, for example in the board's queue.
    pub fn drop_telemetry(&mut self, samples: u32) {
        self.telemetry_dropped = self.telemetry_dropped.saturating_add(samples);
    }

    /// The next frame for the line: Hello, then replies, then telemetry.
    pub fn transmit(&mut self) -> Option<Vec<u8, MAX_WIRE>> {
        if core::mem::take(&mut self.hello_wanted) {
            return frame::encode(&self.hello().encode()).ok();
        }
        if let Some(reply) = self.replies.pop_front() {
            return encoded(reply.to_wire());
        }
        encoded(self.telemetry.pop_front()?.to_wire())
    }

    fn hello(&self) -> Hello {
        Hello {
            firmware: self.config.firmware,
            protocol: PROTOCOL,
            schema_hash: SCHEMA_HASH,
            model_id: self.model.map_or([0; 8], |model| model.id),
            reset_cause: self.config.reset_cause,
            board: self.config.board.clone(),
        }
    }

    fn reply(&mut self, token: u16, reply: Reply) {
        // A host that does not read its replies loses the newest: it has stopped waiting for them in order.
        let _ = self.replies.push_back(ReplyFrame { token, reply });
    }

    fn request(
        &mut self,
        RequestFrame { token, request }: RequestFrame,
        commands: &mut impl CommandSink,
        check_model: impl FnMut(&[u8]) -> bool,
    ) -> Option<Event> {
        let mut event = None;
        let outcome = match request {
            Request::Status => Outcome::Send(Action::Status),
            Request::Arm => Outcome::Send(Action::Request(supervisor::Event::Arm)),
            Request::Disarm => Outcome::Send(Action::Request(supervisor::Event::Disarm)),
            Request::Start => Outcome::Send(Action::Request(supervisor::Event::Start)),
            Request::Stop => Outcome::Send(Action::Request(supervisor::Event::Stop)),
            Request::Vent => {
                // Past the queue, and never refused.
                commands.vent();
                Outcome::Reply(Reply::Done)
            }
            Request::Acknowledge => Outcome::Send(Action::Request(supervisor::Event::Acknowledge)),
            Request::SetPoint { quantity, value } => Outcome::Send(Action::SetPoint(SetPoint::Value(quantity, value))),
            Request::Playback(chunk) => Outcome::Send(Action::SetPoint(SetPoint::Chunk(chunk))),
            Request::PlaybackClear => Outcome::Send(Action::PlaybackClear),
            Request::FaultRecord => Outcome::Send(Action::FaultRecord),
            Request::ControlReport => Outcome::Send(Action::ControlReport),
            Request::PreviousFaultRecord => {
                Outcome::Reply(self.config.previous_record.map_or(Reply::Refused(Refusal::NoRecord), Reply::FaultRecord))
            }
            Request::SettingGet { number } => Outcome::Reply(match self.settings.get(number) {
                Some(value) => Reply::Setting(value),
                None => Reply::Refused(Refusal::Setting(model_export::link::settings::SettingError::Unknown)),
            }),
            Request::SettingSet { number, value } => {
                let mut settings = self.settings.clone();
                match settings.set(number, value) {
                    Ok(()) => self.propose(token, settings),
                    Err(error) => Outcome::Reply(Reply::Refused(Refusal::Setting(error))),
                }
            }
            Request::SettingsRevert(baseline) => {
                let settings = self.baseline(baseline);
                self.propose(token, settings)
            }
            Request::SettingsDifference { baseline, from_number } => Outcome::Reply(self.differences(baseline, from_number)),
            Request::SettingsSave => Outcome::Reply(done(self.may_write().and_then(|()| self.save_settings()))),
            Request::ModelBegin { length, crc32 } => Outcome::Reply(done(self.may_write().and_then(|()| {
                self.upload = None;
                self.upload = Some(self.model_store.begin(length, crc32).map_err(refusal)?);
                Ok(())
            }))),
            Request::ModelChunk { offset, bytes } => {
                let written = self.may_write().and_then(|()| {
                    let upload = self.upload.as_mut().ok_or(Refusal::NoUpload)?;
                    self.model_store.write(upload, offset, &bytes).map_err(refusal)?;
                    Ok(upload.next_offset())
                });
                Outcome::Reply(written.map_or_else(Reply::Refused, Reply::Uploaded))
            }
            Request::ModelFinish => Outcome::Reply(done(self.may_write().and_then(|()| self.finish_upload(check_model)))),
            Request::ModelActivate | Request::ModelRollback => {
                let activated = self.may_write().and_then(|()| {
                    let slot = self.model_store.inactive_whole().ok_or(Refusal::NoOtherModel)?;
                    self.model_store.activate(slot).map_err(refusal)
                });
                if activated.is_ok() {
                    event = Some(Event::ModelChanged);
                }
                Outcome::Reply(done(activated))
            }
        };
        match outcome {
            Outcome::Reply(reply) => {
                if matches!(reply, Reply::Refused(Refusal::Storage)) {
                    // If the queue is full the host still has its refusal, and the next attempt raises the fault again.
                    let _ = commands.send(Command { token: None, action: Action::Raise(Fault::StorageFailed) });
                }
                self.reply(token, reply);
            }
            Outcome::Send(action) => {
                if commands.send(Command { token: Some(token), action }) {
                    self.awaited = self.awaited.saturating_add(1);
                } else {
                    self.candidate.take_if(|candidate| candidate.token == token);
                    self.reply(token, Reply::Refused(Refusal::Busy));
                }
            }
        }
        event
    }

    /// Flash stops the processor, so it is written only while vented and with no command on its way that could change that.
    fn may_write(&self) -> Result<(), Refusal> {
        if self.awaited > 0 {
            return Err(Refusal::Busy);
        }
        match self.state {
            State::Idle | State::Fault => Ok(()),
            state => Err(Refusal::State(state)),
        }
    }

    fn baseline(&self, baseline: Baseline) -> Settings {
        match baseline {
            Baseline::Saved => self.saved.clone(),
            Baseline::Defaults => Settings::default(),
        }
    }

    /// Sends settings to the tick; they are in use once it has taken them.
    fn propose(&mut self, token: u16, settings: Settings) -> Outcome {
        if self.candidate.is_some() {
            return Outcome::Reply(Reply::Refused(Refusal::Busy));
        }
        let built: Result<Tick, _> = TickConfig { settings: &settings, facts: self.config.facts }.build();
        match built {
            Ok(tick) => {
                self.candidate = Some(Candidate { token, settings });
                Outcome::Send(Action::Configure(tick))
            }
            Err(inconsistent) => Outcome::Reply(Reply::Refused(Refusal::SettingsInconsistent(inconsistent.0))),
        }
    }

    fn differences(&self, baseline: Baseline, from_number: u16) -> Reply {
        let baseline = self.baseline(baseline);
        let mut entries = Vec::new();
        for (number, in_use, baseline) in self.settings.differences(&baseline).filter(|entry| entry.0 >= from_number) {
            if entries.len() == MAX_PAGE {
                return Reply::Differences { entries, next_number: number };
            }
            let _ = entries.push(SettingDifference { number, in_use, baseline });
        }
        Reply::Differences { entries, next_number: 0 }
    }

    fn save_settings(&mut self) -> Result<(), Refusal> {
        let bytes = settings::encode(&self.settings).ok_or(Refusal::Storage)?;
        self.settings_store.save(&bytes).map_err(refusal)?;
        self.saved = self.settings.clone();
        Ok(())
    }

    fn finish_upload(&mut self, mut check_model: impl FnMut(&[u8]) -> bool) -> Result<(), Refusal> {
        let upload = self.upload.take().ok_or(Refusal::NoUpload)?;
        let bytes = self.model_store.uploaded(&upload);
        // The checksum first: a damaged blob is not a wrong model.
        if !upload.is_complete(crc32(0, bytes)) {
            return Err(Refusal::Checksum);
        }
        if !check_model(bytes) {
            return Err(Refusal::NotAModel);
        }
        self.model_store.finish(upload).map_err(refusal).map(|_| ())
    }
}

/// What becomes of a request.
enum Outcome {
    Reply(Reply),
    Send(Action),
}

fn done(outcome: Result<(), Refusal>) -> Reply {
    match outcome {
        Ok(()) => Reply::Done,
        Err(refusal) => Reply::Refused(refusal),
    }
}

fn encoded(wire: Result<Vec<u8, MAX_WIRE>, MessageError>) -> Option<Vec<u8, MAX_WIRE>> {
    // Every message fits its frame; a test holds that.
    wire.ok()
}

fn refusal(error: StorageError) -> Refusal {
    match error {
        StorageError::Flash => Refusal::Storage,
        StorageError::LogFull => Refusal::LogFull,
        StorageError::TooLong(capacity) => Refusal::TooLong(capacity),
        StorageError::Offset(offset) => Refusal::UploadOffset(offset),
        StorageError::PieceLength => Refusal::PieceLength,
        StorageError::Checksum => Refusal::Checksum,
        StorageError::NotWhole => Refusal::NoOtherModel,
    }
}
