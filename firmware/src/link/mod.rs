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
//! 4. Whenever the line is free: [`Link::transmit_to`] sends on, or [`Link::transmit`] gives the next frame.
//! 5. On [`Event::ModelUploaded`] check the blob and tell [`Link::finish_upload`] what came of it.
//! 6. On [`Event::ModelChanged`] queue a `Retest`; the rig then asks for the self-test, after which [`Link::set_model`] gets the result.
//!
//! [`crate::background`] does 5 and 6.
//!
//! Whatever is long stays in its place in [`LinkBuffers`], since the background shares a small stack with the tick.

mod config;
mod models;
mod requests;
mod session;
mod settings;

use core::borrow::BorrowMut;

use embedded_io::{Write, WriteReady};
use heapless::{Deque, Vec};
use model_export::link::Kind;
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::frame::{self, Decoder, Wire};
use model_export::link::history::{HistoryPiece, MAX_PIECE_ROWS};
use model_export::link::message::{Message, Refusal, Reply, ReplyFrame, Request, RequestFrame, Telemetry};
use model_export::link::settings::Settings;
use model_export::link::state::State;
use model_export::link::trace::{MAX_PIECE_BYTES, MAX_RECORD_BYTES, TracePiece, TraceRecord};

pub use self::config::{CommandSink, Event, Identity, LinkConfig, Measured};
use self::requests::{Outcome, SessionState, TraceProgress};
use self::session::Admission;
use crate::history::{self, HistoryWords};
use crate::model::ModelFacts;
use crate::storage::{Flash, Slot};
use crate::tick::{Action, Answer, Command};

/// Replies waiting for the line.
pub const REPLY_QUEUE: usize = 4;
/// Telemetry samples waiting for the line.
pub const TELEMETRY_QUEUE: usize = 8;
/// Bytes of a trace that wait for more before they go: half a piece, so that the frames around them cost little.
const TRACE_PIECE_BYTES: usize = 128;

/// What a link keeps that is long: the frame and the request under way each way, and what waits for the line.
#[derive(Debug, Default)]
pub struct LinkBuffers {
    decoder: Decoder,
    request: RequestFrame,
    wire: Wire,
    replies: Deque<ReplyFrame, REPLY_QUEUE>,
    telemetry: Deque<Telemetry, TELEMETRY_QUEUE>,
    trace: TracePiece,
    refused: Option<(u32, Refusal)>,
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
            refused: None,
        }
    }

    fn reply(&mut self, token: u32, reply: Reply) {
        if let Reply::Refused(refusal) = reply {
            self.refused = Some((token, refusal));
        }
        // A host that does not read its replies loses the newest: it has stopped waiting for them in order.
        let _ = self.replies.push_back(ReplyFrame { token, reply });
    }
}

/// The link with its stores. On a board the buffers lie elsewhere, so that the rest is short enough to be made on the stack.
#[derive(Debug)]
pub struct Link<S, M, B = LinkBuffers> {
    session: SessionState<S, M>,
    hello_wanted: bool,
    /// Bytes of the frame in the buffer that the line has taken.
    sent: usize,
    buffers: B,
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
        Self { session: SessionState::new(config, settings_flash, model_flash), hello_wanted: false, sent: 0, buffers }
    }

    /// The settings in use.
    pub fn settings(&self) -> &Settings {
        &self.session.settings
    }

    /// What was wrong with the stores at the start.
    pub fn boot_faults(&self) -> FaultSet {
        self.session.boot_faults
    }

    /// What is wrong with the stores now, for the self-test: damaged settings keep the rig vented until settings are saved again.
    pub fn standing_faults(&self) -> FaultSet {
        let mut faults = FaultSet::EMPTY;
        faults.insert_if(self.session.settings_unreliable, Fault::SettingsInvalid);
        faults
    }

    /// The active model's blob, for the self-test.
    pub fn model_blob(&self) -> Option<&[u8]> {
        self.session.model_store.active_payload()
    }

    /// The slot it lies in.
    pub fn model_slot(&self) -> Option<Slot> {
        self.session.model_store.select().active
    }

    /// The blob that [`Event::ModelUploaded`] is about.
    pub fn uploaded_model(&self) -> Option<&[u8]> {
        self.session.checking?;
        self.session.upload.as_ref().map(|upload| self.session.model_store.uploaded(upload))
    }

    /// The stores' flash, settings first.
    pub fn flash(&self) -> (&S, &M) {
        (self.session.settings_store.flash(), self.session.model_store.flash())
    }

    /// Gives the flash back, settings first.
    pub fn release(self) -> (S, M) {
        (self.session.settings_store.release(), self.session.model_store.release())
    }

    /// Tells which model passed the self-test.
    pub fn set_model(&mut self, model: Option<ModelFacts>) {
        self.session.model = model;
    }

    /// Tells the state the rig is in, and whether the pressure was seen to be gone.
    pub fn observe(&mut self, state: State, vent_verified: bool, measured: Measured) {
        self.session.state = state;
        self.session.vent_verified = vent_verified;
        self.session.measured = measured;
    }

    /// Telemetry samples dropped so far: what the tick writes into the next sample.
    pub fn telemetry_dropped(&self) -> u32 {
        self.session.telemetry_dropped
    }

    /// Takes one byte from the line.
    pub fn receive(&mut self, byte: u8, commands: &mut impl CommandSink) -> Option<Event> {
        let LinkBuffers { decoder, request, .. } = self.buffers.borrow_mut();
        let damaged_frames = &mut self.session.damaged_frames;
        let Ok(payload) = decoder.push(byte)? else {
            *damaged_frames = damaged_frames.saturating_add(1);
            return None;
        };
        match payload.first().copied().and_then(Kind::from_byte) {
            Some(Kind::HelloRequest) => {
                self.session.begin_session();
                self.hello_wanted = true;
            }
            Some(Kind::Request) => {
                match RequestFrame::from_payload(payload) {
                    Ok(frame) => {
                        *request = frame;
                        return self.handle(commands);
                    }
                    // The token comes first on the wire, so that even a request of a later version gets its refusal.
                    Err(_) => {
                        if let Ok((token, _)) = postcard::take_from_bytes::<u32>(payload.get(1..).unwrap_or(&[])) {
                            self.buffers.borrow_mut().reply(token, Reply::Refused(Refusal::NotUnderstood));
                        }
                    }
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
            match self.session.sessions.load(session, token) {
                Admission::Admitted => {}
                Admission::Old => {
                    self.session.damaged_frames = self.session.damaged_frames.saturating_add(1);
                    return None;
                }
                Admission::OtherSession => {
                    buffers.reply(token, Reply::Refused(Refusal::OtherSession));
                    return None;
                }
            }
        }
        match self.session.request(token, &buffers.request.request, commands) {
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
        self.session.sessions.every = true;
    }

    /// Ends an upload: whether the blob is a model that this device can run, or what is wrong with it.
    pub fn finish_upload(&mut self, checked: Result<(), Fault>, commands: &mut impl CommandSink) {
        let Some(token) = self.session.checking.take() else { return };
        let outcome = self.session.finish_upload(checked);
        reply_done(self.buffers.borrow_mut(), token, outcome, commands);
    }

    /// Takes an answer of the tick.
    pub fn answer(&mut self, answer: Answer) {
        let Answer { token, mut reply } = answer;
        self.session.complete(token, &mut reply);
        self.buffers.borrow_mut().reply(token, reply);
    }

    /// Takes a telemetry sample of the tick, and adds what the board measures about itself; drops it if the line is too slow.
    pub fn telemetry(&mut self, mut sample: Telemetry) {
        let Measured { longest_tick_cycles, stack_unused_bytes, supply_v, chip_celsius, .. } = self.session.measured;
        sample.longest_tick_cycles = longest_tick_cycles;
        sample.stack_unused_bytes = stack_unused_bytes;
        (sample.supply_v, sample.chip_celsius) = (supply_v, chip_celsius);
        if self.buffers.borrow_mut().telemetry.push_back(sample).is_err() {
            self.drop_telemetry(1);
        }
    }

    /// Counts samples that were lost before they came here, for example in the board's queue.
    pub fn drop_telemetry(&mut self, samples: u32) {
        self.session.telemetry_dropped = self.session.telemetry_dropped.saturating_add(samples);
    }

    /// Tells what the device is and can do besides.
    pub fn identify(&mut self, identity: Identity) {
        self.session.identity = identity;
    }

    /// Answers the request for the history that waits, if one does.
    pub fn serve_history(&mut self, memory: &impl HistoryWords) {
        let Some((token, from_row)) = self.session.history_wanted.take() else { return };
        if !history::is_held(memory) {
            return self.buffers.borrow_mut().reply(token, Reply::Refused(Refusal::NoRecord));
        }
        let rows = history::rows(memory);
        let mut piece = HistoryPiece { rows, bytes: Vec::new() };
        for index in (from_row..rows).take(MAX_PIECE_ROWS) {
            // The piece has room for that many.
            let _ = piece.bytes.extend_from_slice(&history::row(memory, index));
        }
        self.buffers.borrow_mut().reply(token, Reply::History(piece));
    }

    /// Whether the chip's bootloader is wanted and everything that was to be said before has gone to the line.
    pub fn wants_bootloader(&self) -> bool {
        let buffers = self.buffers.borrow();
        self.session.bootloader_wanted && buffers.replies.is_empty() && self.sent >= buffers.wire.len()
    }

    /// A refusal that was sent since the last call, with its request's token: for the board's log.
    pub fn take_refusal(&mut self) -> Option<(u32, Refusal)> {
        self.buffers.borrow_mut().refused.take()
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

    /// Sends as much of the frames that wait as the line takes without waiting, of one frame at most.
    pub fn transmit_to(&mut self, line: &mut (impl Write + WriteReady)) {
        if self.sent >= self.buffers.borrow().wire.len() {
            if self.transmit().is_none() {
                self.buffers.borrow_mut().wire.clear();
                return;
            }
            self.sent = 0;
        }
        let rest = self.buffers.borrow().wire.get(self.sent..).unwrap_or(&[]);
        if matches!(line.write_ready(), Ok(true))
            && let Ok(taken) = line.write(rest)
        {
            self.sent = self.sent.saturating_add(taken);
        }
    }

    /// The next frame for the line: Hello, then replies, then the trace, then telemetry.
    pub fn transmit(&mut self) -> Option<&[u8]> {
        let LinkBuffers { wire, replies, telemetry, trace, .. } = self.buffers.borrow_mut();
        let enough = if self.session.trace == TraceProgress::Off { 1 } else { TRACE_PIECE_BYTES };
        // Every message fits its frame; a test holds that.
        if core::mem::take(&mut self.hello_wanted) {
            frame::encode_into(wire, &self.session.hello().encode()).ok()?;
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

/// Answers what has no answer but that it is done.
fn reply_done(buffers: &mut LinkBuffers, token: u32, outcome: Result<(), Refusal>, commands: &mut impl CommandSink) {
    if outcome == Err(Refusal::Storage) {
        // If the queue is full the host still has its refusal, and the next attempt raises the fault again.
        let _ = commands.send(Command { token: None, action: Action::Raise(Fault::StorageFailed) });
    }
    buffers.reply(token, outcome.map_or_else(Reply::Refused, |()| Reply::Done));
}
