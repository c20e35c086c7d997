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
//! 3. For every answer, telemetry sample and trace record that the tick put out: [`Link::answer`], [`Link::telemetry`], [`Link::trace_record`] (or
//!    [`Link::trace`] where the record comes byte by byte); after each tick or before each byte [`Link::observe`] with the state and the vent.
//! 4. Whenever the line is free: [`Link::transmit`] gives the next frame.
//! 5. On [`Event::ModelUploaded`] check the blob and tell [`Link::finish_upload`] what came of it.
//! 6. On [`Event::ModelChanged`] queue a `Retest`; the rig then asks for the self-test, after which [`Link::set_model`] gets the result.
//!
//! [`crate::background`] does 5 and 6.
//!
//! Whatever is long stays in its place in [`LinkBuffers`], since the background shares a small stack with the tick.

use core::borrow::BorrowMut;

use heapless::{Deque, Vec};
use model_export::blob::{self, crc32};
use model_export::link::fault::{Blocker, BlockerSet, Fault, FaultSet};
use model_export::link::frame::{self, Decoder, Wire};
use model_export::link::hello::{Hello, MAX_BOARD_NAME};
use model_export::link::message::{
    Baseline, FaultRecord, MAX_PAGE, Message, Refusal, Reply, ReplyFrame, Request, RequestFrame, SettingDifference, Telemetry,
};
use model_export::link::settings::{SettingError, Settings};
use model_export::link::state::{ResetCause, State};
use model_export::link::trace::{MAX_PIECE_BYTES, MAX_RECORD_BYTES, TracePiece, TraceRecord};
use model_export::link::{Kind, PROTOCOL, SCHEMA_HASH};
use model_export::wire::{Reader, Wire as _};

use crate::control::SetPoint;
use crate::model::{self, ModelFacts};
use crate::settings::{self, STORE_KIND, STORE_VERSION, Stored};
use crate::storage::{Flash, Slot, StorageError, Store, Upload};
use crate::supervisor;
use crate::tick::{Action, Answer, Command, Inconsistent, RigFacts, TickConfig};

/// Replies waiting for the line.
pub const REPLY_QUEUE: usize = 4;
/// Telemetry samples waiting for the line.
pub const TELEMETRY_QUEUE: usize = 8;
/// Bytes of a trace that wait for more before they go: half a piece, so that the frames around them cost little.
const TRACE_PIECE_BYTES: usize = 128;

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
    /// A number that nobody can foretell, such as a fast counter's: it tells the sessions of one start from those of another. Zero in lock step,
    /// where equal inputs must give equal outputs.
    pub noise: u32,
}

/// What the board must do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A model has come whole: see whether it is one ([`Link::uploaded_model`]) and tell [`Link::finish_upload`].
    ModelUploaded,
    /// Another model is active: load it and test again.
    ModelChanged,
}

/// What a link keeps that is long: the frame and the request under way each way, and what waits for the line.
#[derive(Debug, Default)]
pub struct LinkBuffers {
    decoder: Decoder,
    request: RequestFrame,
    wire: Wire,
    replies: Deque<ReplyFrame, REPLY_QUEUE>,
    telemetry: Deque<Telemetry, TELEMETRY_QUEUE>,
    trace: TracePiece,
}

impl LinkBuffers {
    /// Empty.
    pub const fn new() -> Self {
        Self {
            decoder: Decoder::new(),
            request: RequestFrame { token: 0, session: 0, request: Request::Status },
            wire: Wire::new(),
            replies: Deque::new(),
            telemetry: Deque::new(),
            trace: TracePiece { offset: 0, bytes: Vec::new() },
        }
    }

    fn reply(&mut self, token: u32, reply: Reply) {
        // A host that does not read its replies loses the newest: it has stopped waiting for them in order.
        let _ = self.replies.push_back(ReplyFrame { token, reply });
    }
}

/// The link with its stores. On a board the buffers lie elsewhere, so that the rest is short enough to be made on the stack.
#[derive(Debug)]
pub struct Link<S, M, B = LinkBuffers> {
    desk: Desk<S, M>,
    hello_wanted: bool,
    buffers: B,
}

/// Everything but the bytes.
#[derive(Debug)]
struct Desk<S, M> {
    config: LinkConfig,
    settings_store: Store<S>,
    model_store: Store<M>,
    settings: Settings,
    saved: Settings,
    /// Settings on their way through the tick, and the token of the request they came with.
    proposed: Settings,
    proposal: Option<u32>,
    boot_faults: FaultSet,
    /// What was saved is damaged or not acceptable, and nothing was saved since.
    settings_unreliable: bool,
    upload: Option<Upload>,
    /// Token of the request that waits for the check of the upload.
    checking: Option<u32>,
    model: Option<ModelFacts>,
    state: State,
    vent_verified: bool,
    awaited: u16,
    measured: Measured,
    damaged_frames: u32,
    telemetry_dropped: u32,
    trace: TraceProgress,
    sessions: Sessions,
}

/// Which requests are of now: those of the session that the last Hello began, in rising order of their tokens.
#[derive(Debug, Default)]
struct Sessions {
    number: Option<u32>,
    is_used: bool,
    last_token: u32,
    every: bool,
}

/// What to make of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Admission {
    Admitted,
    /// Sent before one that was taken already.
    Old,
    OtherSession,
}

impl Sessions {
    /// Begins a session; `noise` makes its number another one than after the last start.
    fn begin(&mut self, noise: u32) {
        if self.number.is_none() || self.is_used {
            let before = self.number.unwrap_or(0).to_le_bytes();
            // Zero is no number: it stands for a device that has no sessions.
            let number = crc32(crc32(0, &before), &noise.to_le_bytes()).max(1);
            *self = Self { number: Some(number), every: self.every, ..Self::default() };
        }
    }

    fn admit(&mut self, session: u32, token: u32) -> Admission {
        if self.every {
            return Admission::Admitted;
        }
        if self.number != Some(session) {
            return Admission::OtherSession;
        }
        if token <= self.last_token {
            return Admission::Old;
        }
        self.is_used = true;
        self.last_token = token;
        Admission::Admitted
    }
}

/// How far a trace is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TraceProgress {
    /// None runs; what is left of the last one goes at once.
    Off,
    /// The tick was asked for one by the request with this token.
    Asked(u32),
    /// One runs.
    On,
}

impl<S: Flash, M: Flash> Link<S, M> {
    /// A link over two pairs of flash slots. Settings come from flash, or are the defaults if flash has none that go together.
    pub fn new(config: LinkConfig, settings_flash: S, model_flash: M) -> Self {
        Self::with_buffers(config, settings_flash, model_flash, LinkBuffers::new())
    }
}

impl<S: Flash, M: Flash, B: BorrowMut<LinkBuffers>> Link<S, M, B> {
    /// As [`Link::new`], with buffers that lie wherever the caller wants.
    pub fn with_buffers(config: LinkConfig, settings_flash: S, model_flash: M, buffers: B) -> Self {
        Self { desk: Desk::new(config, settings_flash, model_flash), hello_wanted: false, buffers }
    }

    /// The settings in use.
    pub fn settings(&self) -> &Settings {
        &self.desk.settings
    }

    /// What was wrong with the stores at the start.
    pub fn boot_faults(&self) -> FaultSet {
        self.desk.boot_faults
    }

    /// What is wrong with the stores now, for the self-test: damaged settings keep the rig vented until settings are saved again.
    pub fn standing_faults(&self) -> FaultSet {
        let mut faults = FaultSet::EMPTY;
        faults.insert_if(self.desk.settings_unreliable, Fault::SettingsInvalid);
        faults
    }

    /// The active model's blob, for the self-test.
    pub fn model_blob(&self) -> Option<&[u8]> {
        self.desk.model_store.active_payload()
    }

    /// The slot it lies in.
    pub fn model_slot(&self) -> Option<Slot> {
        self.desk.model_store.select().active
    }

    /// The blob that [`Event::ModelUploaded`] is about.
    pub fn uploaded_model(&self) -> Option<&[u8]> {
        self.desk.checking?;
        self.desk.upload.as_ref().map(|upload| self.desk.model_store.uploaded(upload))
    }

    /// The stores' flash, settings first.
    pub fn flash(&self) -> (&S, &M) {
        (self.desk.settings_store.flash(), self.desk.model_store.flash())
    }

    /// Gives the flash back, settings first.
    pub fn release(self) -> (S, M) {
        (self.desk.settings_store.release(), self.desk.model_store.release())
    }

    /// Tells which model passed the self-test.
    pub fn set_model(&mut self, model: Option<ModelFacts>) {
        self.desk.model = model;
    }

    /// Tells the state the rig is in, and whether the pressure was seen to be gone.
    pub fn observe(&mut self, state: State, vent_verified: bool, measured: Measured) {
        self.desk.state = state;
        self.desk.vent_verified = vent_verified;
        self.desk.measured = measured;
    }

    /// Telemetry samples dropped so far: what the tick writes into the next sample.
    pub fn telemetry_dropped(&self) -> u32 {
        self.desk.telemetry_dropped
    }

    /// Takes one byte from the line.
    pub fn receive(&mut self, byte: u8, commands: &mut impl CommandSink) -> Option<Event> {
        let LinkBuffers { decoder, request, .. } = self.buffers.borrow_mut();
        let damaged_frames = &mut self.desk.damaged_frames;
        let Ok(payload) = decoder.push(byte)? else {
            *damaged_frames = damaged_frames.saturating_add(1);
            return None;
        };
        match payload.first().copied().and_then(Kind::from_byte) {
            Some(Kind::HelloRequest) => {
                self.desk.begin_session();
                self.hello_wanted = true;
            }
            Some(Kind::Request) => {
                if request.take(payload).is_ok() {
                    return self.handle(commands);
                }
                // The token comes first on the wire, so that even a request of a later version gets its refusal.
                let mut reader = Reader::new(payload.get(1..).unwrap_or(&[]));
                let mut token = 0u32;
                token.read(&mut reader);
                if reader.finish().is_some() {
                    self.buffers.borrow_mut().reply(token, Reply::Refused(Refusal::NotUnderstood));
                }
            }
            _ => *damaged_frames = damaged_frames.saturating_add(1),
        }
        None
    }

    /// Carries out the request in the buffer.
    #[inline(never)]
    fn handle(&mut self, commands: &mut impl CommandSink) -> Option<Event> {
        let buffers = self.buffers.borrow_mut();
        let RequestFrame { token, session, .. } = buffers.request;
        // A vent is welcome from anybody at any time.
        if buffers.request.request != Request::Vent {
            match self.desk.sessions.admit(session, token) {
                Admission::Admitted => {}
                Admission::Old => {
                    self.desk.damaged_frames = self.desk.damaged_frames.saturating_add(1);
                    return None;
                }
                Admission::OtherSession => {
                    buffers.reply(token, Reply::Refused(Refusal::OtherSession));
                    return None;
                }
            }
        }
        match self.desk.request(token, &buffers.request.request, commands) {
            Outcome::Reply(reply) => buffers.reply(token, reply),
            Outcome::Done(outcome) => reply_done(buffers, token, outcome, commands),
            Outcome::Sent => {}
            Outcome::Event(event) => {
                if event == Event::ModelChanged {
                    buffers.reply(token, Reply::Done);
                }
                return Some(event);
            }
        }
        None
    }

    /// Takes requests of every session from now on, in whatever order: for running recorded ones again.
    #[cfg(not(target_os = "none"))]
    pub fn take_every_session(&mut self) {
        self.desk.sessions.every = true;
    }

    /// Ends an upload: whether the blob is a model that this device can run, or what is wrong with it.
    pub fn finish_upload(&mut self, checked: Result<(), Fault>, commands: &mut impl CommandSink) {
        let Some(token) = self.desk.checking.take() else { return };
        let outcome = self.desk.finish_upload(checked);
        reply_done(self.buffers.borrow_mut(), token, outcome, commands);
    }

    /// Takes an answer of the tick.
    pub fn answer(&mut self, answer: Answer) {
        let Answer { token, mut reply } = answer;
        self.desk.complete(token, &mut reply);
        self.buffers.borrow_mut().reply(token, reply);
    }

    /// Takes a telemetry sample of the tick; drops it if the line is too slow.
    pub fn telemetry(&mut self, sample: Telemetry) {
        if self.buffers.borrow_mut().telemetry.push_back(sample).is_err() {
            self.drop_telemetry(1);
        }
    }

    /// Counts samples that were lost before they came here, for example in the board's queue.
    pub fn drop_telemetry(&mut self, samples: u32) {
        self.desk.telemetry_dropped = self.desk.telemetry_dropped.saturating_add(samples);
    }

    /// Bytes of a trace that there is room for.
    pub fn trace_room(&mut self) -> usize {
        MAX_PIECE_BYTES.saturating_sub(self.buffers.borrow_mut().trace.bytes.len())
    }

    /// Takes a byte of the trace, for which there is room.
    pub fn trace(&mut self, byte: u8) {
        let _ = self.buffers.borrow_mut().trace.bytes.push(byte);
    }

    /// Takes a record of the trace; `false` if there is no room and the trace must end.
    #[must_use]
    pub fn trace_record(&mut self, record: &TraceRecord) -> bool {
        let mut place = [0; MAX_RECORD_BYTES];
        let encoded = record.encode(self.trace_room(), &mut place);
        place.iter().take(encoded.length).for_each(|byte| self.trace(*byte));
        !encoded.overflowed
    }

    /// The next frame for the line: Hello, then replies, then the trace, then telemetry.
    pub fn transmit(&mut self) -> Option<&[u8]> {
        let LinkBuffers { wire, replies, telemetry, trace, .. } = self.buffers.borrow_mut();
        let enough = if self.desk.trace == TraceProgress::Off { 1 } else { TRACE_PIECE_BYTES };
        // Every message fits its frame; a test holds that.
        if core::mem::take(&mut self.hello_wanted) {
            frame::encode_into(wire, &self.desk.hello().encode()).ok()?;
        } else if let Some(reply) = replies.front() {
            let encoded = reply.encode_into(wire);
            let _ = replies.pop_front();
            encoded.ok()?;
        } else if trace.bytes.len() >= enough {
            let encoded = trace.encode_into(wire);
            trace.offset = trace.offset.wrapping_add(u32::try_from(trace.bytes.len()).unwrap_or(0));
            trace.bytes.clear();
            encoded.ok()?;
        } else {
            let encoded = telemetry.front()?.encode_into(wire);
            let _ = telemetry.pop_front();
            encoded.ok()?;
        }
        Some(wire)
    }
}

impl<S: Flash, M: Flash> Desk<S, M> {
    fn new(config: LinkConfig, settings_flash: S, model_flash: M) -> Self {
        let settings_store = Store::new(settings_flash, STORE_KIND, STORE_VERSION);
        let model_store = Store::new(model_flash, model::STORE_KIND, model::STORE_VERSION);
        let mut boot_faults = FaultSet::EMPTY;
        let Stored { mut settings, is_damaged, .. } = settings::load(&settings_store);
        let goes_together = TickConfig { settings: &settings, facts: config.facts }.build().is_ok();
        let settings_unreliable = is_damaged || !goes_together;
        boot_faults.insert_if(settings_unreliable, Fault::SettingsInvalid);
        boot_faults.insert_if(model_store.select().is_damaged, Fault::ModelCorrupt);
        if !goes_together {
            settings.clone_from(&Settings::DEFAULT);
        }
        Self {
            config,
            settings_store,
            model_store,
            saved: settings.clone(),
            proposed: settings.clone(),
            settings,
            proposal: None,
            boot_faults,
            settings_unreliable,
            upload: None,
            checking: None,
            model: None,
            state: State::Boot,
            vent_verified: false,
            awaited: 0,
            measured: Measured::default(),
            damaged_frames: 0,
            telemetry_dropped: 0,
            trace: TraceProgress::Off,
            sessions: Sessions::default(),
        }
    }

    fn begin_session(&mut self) {
        self.sessions.begin(self.measured.noise);
    }

    fn hello(&self) -> Hello {
        Hello {
            firmware: self.config.firmware,
            protocol: PROTOCOL,
            schema_hash: SCHEMA_HASH,
            model_id: self.model.map_or([0; 8], |model| model.id),
            reset_cause: self.config.reset_cause,
            board: self.config.board.clone(),
            session: self.sessions.number.unwrap_or(0),
        }
    }

    /// What an answer of the tick settles, and what the tick could not know for it.
    fn complete(&mut self, token: u32, reply: &mut Reply) {
        self.awaited = self.awaited.saturating_sub(1);
        if self.proposal.take_if(|proposal| *proposal == token).is_some() && matches!(reply, Reply::Done) {
            self.settings.clone_from(&self.proposed);
        }
        if self.trace == TraceProgress::Asked(token) {
            self.trace = if matches!(reply, Reply::Status(_)) { TraceProgress::On } else { TraceProgress::Off };
        }
        if let Reply::Status(status) = reply {
            status.longest_tick_cycles = self.measured.longest_tick_cycles;
            status.stack_unused_bytes = self.measured.stack_unused_bytes;
            status.damaged_frames = self.damaged_frames;
            status.telemetry_dropped = self.telemetry_dropped;
            status.settings_unsaved = self.settings != self.saved;
        }
    }

    fn request(&mut self, token: u32, request: &Request, commands: &mut impl CommandSink) -> Outcome {
        if self.trace != TraceProgress::Off && request.is_beyond_a_trace() {
            return Outcome::Done(Err(Refusal::Traced));
        }
        match request {
            Request::Status => self.send(token, Action::Status, commands),
            Request::Arm => self.send(token, Action::Request(supervisor::Event::Arm), commands),
            Request::Disarm => self.send(token, Action::Request(supervisor::Event::Disarm), commands),
            Request::Start => self.send(token, Action::Request(supervisor::Event::Start), commands),
            Request::Stop => self.send(token, Action::Request(supervisor::Event::Stop), commands),
            Request::Vent => {
                // Past the queue, and never refused.
                commands.vent();
                Outcome::Reply(Reply::Done)
            }
            Request::Acknowledge => self.send(token, Action::Request(supervisor::Event::Acknowledge), commands),
            Request::SetPoint { quantity, value } => self.send(token, Action::SetPoint(SetPoint::Value(*quantity, *value)), commands),
            Request::Playback(chunk) => self.send(token, Action::SetPoint(SetPoint::Chunk(chunk.clone())), commands),
            Request::PlaybackClear => self.send(token, Action::PlaybackClear, commands),
            Request::FaultRecord => self.send(token, Action::FaultRecord, commands),
            Request::ControlReport => self.send(token, Action::ControlReport, commands),
            Request::AdaptationReport => self.send(token, Action::AdaptationReport, commands),
            Request::TraceBegin => {
                let outcome = self.send(token, Action::TraceBegin, commands);
                if matches!(outcome, Outcome::Sent) && self.trace == TraceProgress::Off {
                    self.trace = TraceProgress::Asked(token);
                }
                outcome
            }
            Request::TraceEnd => {
                self.trace = TraceProgress::Off;
                self.send(token, Action::TraceEnd, commands)
            }
            Request::PreviousFaultRecord => {
                Outcome::Reply(self.config.previous_record.map_or(Reply::Refused(Refusal::NoRecord), Reply::FaultRecord))
            }
            Request::SettingGet { number } => Outcome::Reply(match self.settings.get(*number) {
                Some(value) => Reply::Setting(value),
                None => Reply::Refused(Refusal::Setting(SettingError::Unknown)),
            }),
            Request::SettingSet { number, value } => {
                if self.proposal.is_some() {
                    return Outcome::Done(Err(Refusal::Busy));
                }
                self.proposed.clone_from(&self.settings);
                match self.proposed.set(*number, *value) {
                    Ok(()) => self.propose(token, commands),
                    Err(error) => Outcome::Done(Err(Refusal::Setting(error))),
                }
            }
            Request::SettingsRevert(baseline) => {
                if self.proposal.is_some() {
                    return Outcome::Done(Err(Refusal::Busy));
                }
                match baseline {
                    Baseline::Saved => self.proposed.clone_from(&self.saved),
                    Baseline::Defaults => self.proposed.clone_from(&Settings::DEFAULT),
                }
                self.propose(token, commands)
            }
            Request::SettingsDifference { baseline, from_number } => Outcome::Reply(self.differences(*baseline, *from_number)),
            Request::SettingsSave => Outcome::Done(self.save_settings()),
            Request::ModelBegin { length, crc32 } => Outcome::Done(self.begin_upload(*length, *crc32)),
            Request::ModelChunk { offset, bytes } => match self.write_upload(*offset, bytes) {
                Ok(next_offset) => Outcome::Reply(Reply::Uploaded(next_offset)),
                Err(refusal) => Outcome::Done(Err(refusal)),
            },
            Request::ModelFinish => match self.check_upload() {
                Ok(()) => {
                    self.checking = Some(token);
                    Outcome::Event(Event::ModelUploaded)
                }
                Err(refusal) => Outcome::Done(Err(refusal)),
            },
            Request::ModelActivate { id } => {
                // As often as it is asked for: the reply to the first request may have been lost.
                if self.active_model() == Some(*id) {
                    return Outcome::Done(Ok(()));
                }
                match self.activate(*id) {
                    Ok(()) => Outcome::Event(Event::ModelChanged),
                    Err(refusal) => Outcome::Done(Err(refusal)),
                }
            }
            Request::Models => {
                let other = self.model_store.inactive_whole().and_then(|slot| self.model_in(slot));
                Outcome::Reply(Reply::Models { active: self.active_model().unwrap_or([0; 8]), other: other.unwrap_or([0; 8]) })
            }
        }
    }

    /// Sends a command to the tick, which answers it.
    #[inline(never)]
    fn send(&mut self, token: u32, action: Action, commands: &mut impl CommandSink) -> Outcome {
        if commands.send(Command { token: Some(token), action }) {
            self.awaited = self.awaited.saturating_add(1);
            Outcome::Sent
        } else {
            Outcome::Done(Err(Refusal::Busy))
        }
    }

    /// Flash stops the processor, so it is written only once the pressure was seen to be gone, and with no command on its way that could change
    /// that.
    fn may_write(&self) -> Result<(), Refusal> {
        if self.awaited > 0 {
            return Err(Refusal::Busy);
        }
        match self.state {
            State::Idle | State::Fault if self.vent_verified => Ok(()),
            State::Idle | State::Fault => {
                let mut blockers = BlockerSet::EMPTY;
                blockers.insert(Blocker::VentNotVerified);
                Err(Refusal::Blocked(blockers))
            }
            state => Err(Refusal::State(state)),
        }
    }

    /// Sends the proposed settings to the tick; they are in use once it has taken them.
    #[inline(never)]
    fn propose(&mut self, token: u32, commands: &mut impl CommandSink) -> Outcome {
        match (TickConfig { settings: &self.proposed, facts: self.config.facts }).build() {
            Ok(tick) => {
                let outcome = self.send(token, Action::Configure(tick), commands);
                if matches!(outcome, Outcome::Sent) {
                    self.proposal = Some(token);
                }
                outcome
            }
            Err(Inconsistent::Setting(number)) => Outcome::Done(Err(Refusal::SettingsInconsistent(number))),
            Err(Inconsistent::Adaptation(condition)) => Outcome::Done(Err(Refusal::Uncertified(condition.number()))),
        }
    }

    fn differences(&self, baseline: Baseline, from_number: u16) -> Reply {
        let baseline = match baseline {
            Baseline::Saved => &self.saved,
            Baseline::Defaults => &Settings::DEFAULT,
        };
        let mut entries = Vec::new();
        for (number, in_use, baseline) in self.settings.differences(baseline).filter(|entry| entry.0 >= from_number) {
            if entries.len() == MAX_PAGE {
                return Reply::Differences { entries, next_number: number };
            }
            let _ = entries.push(SettingDifference { number, in_use, baseline });
        }
        Reply::Differences { entries, next_number: 0 }
    }

    #[inline(never)]
    fn save_settings(&mut self) -> Result<(), Refusal> {
        self.may_write()?;
        let mut bytes = Vec::new();
        settings::encode_into(&self.settings, &mut bytes).ok_or(Refusal::Storage)?;
        self.settings_store.save(&bytes).map_err(refusal)?;
        self.saved.clone_from(&self.settings);
        self.settings_unreliable = false;
        Ok(())
    }

    fn begin_upload(&mut self, length: u32, crc32: u32) -> Result<(), Refusal> {
        self.may_write()?;
        self.upload = None;
        self.upload = Some(self.model_store.begin(length, crc32).map_err(refusal)?);
        Ok(())
    }

    fn write_upload(&mut self, offset: u32, bytes: &[u8]) -> Result<u32, Refusal> {
        self.may_write()?;
        let upload = self.upload.as_mut().ok_or(Refusal::NoUpload)?;
        self.model_store.write(upload, offset, bytes).map_err(refusal)?;
        Ok(upload.next_offset())
    }

    /// The checksum before anything else: a damaged blob is not a wrong model.
    fn check_upload(&mut self) -> Result<(), Refusal> {
        self.may_write()?;
        let upload = self.upload.as_ref().ok_or(Refusal::NoUpload)?;
        if upload.is_complete(crc32(0, self.model_store.uploaded(upload))) {
            return Ok(());
        }
        self.upload = None;
        Err(Refusal::Checksum)
    }

    fn finish_upload(&mut self, checked: Result<(), Fault>) -> Result<(), Refusal> {
        let upload = self.upload.take().ok_or(Refusal::NoUpload)?;
        checked.map_err(|fault| if fault == Fault::ModelTooSlow { Refusal::ModelTooSlow } else { Refusal::NotAModel })?;
        self.model_store.finish(upload).map_err(refusal).map(|_| ())
    }

    fn model_in(&self, slot: Slot) -> Option<[u8; 8]> {
        blob::content_id(self.model_store.payload(slot)?)
    }

    /// The model that is active and not damaged.
    fn active_model(&self) -> Option<[u8; 8]> {
        let selection = self.model_store.select();
        self.model_in(selection.active.filter(|_| !selection.is_damaged)?)
    }

    fn activate(&mut self, id: [u8; 8]) -> Result<(), Refusal> {
        self.may_write()?;
        let slot = Slot::BOTH.into_iter().find(|slot| self.model_in(*slot) == Some(id)).ok_or(Refusal::NoOtherModel)?;
        self.model_store.activate(slot).map_err(refusal)
    }
}

/// What becomes of a request.
enum Outcome {
    /// It is answered.
    Reply(Reply),
    /// It is carried out, or not.
    Done(Result<(), Refusal>),
    /// The tick will answer.
    Sent,
    /// The board has to do something; a change of the model is done, the check of one answers later.
    Event(Event),
}

/// Answers what has no answer but that it is done.
fn reply_done(buffers: &mut LinkBuffers, token: u32, outcome: Result<(), Refusal>, commands: &mut impl CommandSink) {
    if outcome == Err(Refusal::Storage) {
        // If the queue is full the host still has its refusal, and the next attempt raises the fault again.
        let _ = commands.send(Command { token: None, action: Action::Raise(Fault::StorageFailed) });
    }
    buffers.reply(token, outcome.map_or_else(Reply::Refused, |()| Reply::Done));
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
