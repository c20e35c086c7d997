//! The client: requests with their replies, telemetry with its account of what was lost.

use std::collections::VecDeque;
use std::time::Duration;

use firmware::tick::Origin;
use model_export::link::frame::{self, Decoder};
use model_export::link::hello::Hello;
use model_export::link::message::{Message, Refusal, Reply, ReplyFrame, Request, RequestFrame, Telemetry};
use model_export::link::trace::TracePiece;
use model_export::link::{Kind, PROTOCOL, SCHEMA_HASH};
use serde::Serialize;

use super::trace::{Stream, Trace};
use super::{LinkError, Transport};

/// How long to wait for a reply; erasing a model slot of 128 KiB takes the board up to 4 s (data sheet, table 48), and has its own limit.
const REPLY_WITHIN: Duration = Duration::from_millis(500);
/// Limit of requests that erase or write flash.
const FLASH_WITHIN: Duration = Duration::from_secs(10);
/// A trace that has not come on for so long comes no more.
const TRACE_WITHIN: Duration = Duration::from_millis(300);
/// How often Hello is asked: the first may meet a half-sent frame, or a device that is just starting.
const HELLO_ATTEMPTS: u32 = 4;

/// Telemetry that did not arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Gap {
    /// Sequence number of the first sample that is missing.
    pub first_sequence: u32,
    /// How many are missing.
    pub samples: u32,
    /// How many of them the device dropped because the line was full; the others were lost on the line.
    pub dropped_by_device: u32,
}

/// What arrived and what did not.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Account {
    /// Samples received.
    pub received: u32,
    /// Samples that the device dropped.
    pub dropped_by_device: u32,
    /// Samples lost on the line.
    pub lost_on_the_line: u32,
    /// Damaged frames received.
    pub damaged_frames: u32,
    /// Where samples are missing.
    pub gaps: Vec<Gap>,
    #[serde(skip)]
    last: Option<(u32, u32)>,
}

impl Account {
    fn count(&mut self, sample: &Telemetry) {
        self.received += 1;
        if let Some((sequence, dropped)) = self.last {
            let samples = sample.sequence.wrapping_sub(sequence).wrapping_sub(1);
            // A smaller number means that the device restarted: nothing is known about what was lost.
            if samples > 0 && samples < u32::MAX / 2 {
                let dropped_by_device = sample.dropped.wrapping_sub(dropped).min(samples);
                self.dropped_by_device += dropped_by_device;
                self.lost_on_the_line += samples - dropped_by_device;
                self.gaps.push(Gap { first_sequence: sequence.wrapping_add(1), samples, dropped_by_device });
            }
        }
        self.last = Some((sample.sequence, sample.dropped));
    }
}

/// A device at the other end of a transport, its Hello understood.
pub struct Client<T: Transport> {
    transport: T,
    hello: Hello,
    line: Line,
    token: u32,
}

/// What comes down the line.
#[derive(Default)]
struct Line {
    decoder: Decoder,
    bytes: Vec<u8>,
    received: usize,
    sound_frames: u32,
    hello: Option<Hello>,
    replies: Vec<ReplyFrame>,
    telemetry: VecDeque<Telemetry>,
    account: Account,
    trace: Option<Stream>,
}

impl Line {
    /// Lets bytes come in for at most `limit` and sorts what they say.
    fn listen(&mut self, transport: &mut impl Transport, limit: Duration) -> Result<(), LinkError> {
        self.bytes.clear();
        transport.receive(limit, &mut self.bytes)?;
        self.received += self.bytes.len();
        for byte in &self.bytes {
            match self.decoder.push(*byte) {
                None => {}
                Some(Err(_)) => self.account.damaged_frames += 1,
                Some(Ok(payload)) => {
                    self.sound_frames += 1;
                    match payload.first().copied().and_then(Kind::from_byte) {
                        Some(Kind::HelloAnswer) => self.hello = Hello::decode(payload).ok().or(self.hello.take()),
                        Some(Kind::Reply) => self.replies.extend(ReplyFrame::from_payload(payload)),
                        Some(Kind::Telemetry) => {
                            if let Ok(sample) = Telemetry::from_payload(payload) {
                                self.account.count(&sample);
                                self.telemetry.push_back(sample);
                            }
                        }
                        Some(Kind::Trace) => {
                            if let (Some(stream), Ok(piece)) = (&mut self.trace, TracePiece::from_payload(payload)) {
                                stream.take(&piece);
                            }
                        }
                        // A kind of a later version.
                        _ => {}
                    }
                }
            }
        }
        Ok(())
    }
}

/// Asks who is there.
///
/// # Errors
/// [`LinkError::NoAnswer`], [`LinkError::Garbage`], or the transport's.
fn greet(transport: &mut impl Transport, line: &mut Line, attempts: u32) -> Result<Hello, LinkError> {
    let request = frame::encode(&[Kind::HelloRequest.byte()]).map_err(|_| LinkError::Rig("a Hello fits no frame".to_owned()))?;
    for _ in 0..attempts {
        // The zero ends what the last host may have left half-sent.
        transport.send(&[0])?;
        transport.send(&request)?;
        let until = transport.elapsed() + REPLY_WITHIN;
        while transport.elapsed() < until {
            line.listen(transport, until.saturating_sub(transport.elapsed()))?;
            if let Some(hello) = line.hello.take() {
                return Ok(hello);
            }
        }
    }
    let place = transport.place().to_owned();
    if line.received > 0 && line.sound_frames == 0 {
        return Err(LinkError::Garbage { place, bytes: line.received });
    }
    Err(silence(transport, "Hello".to_owned(), REPLY_WITHIN * attempts))
}

fn silence(transport: &impl Transport, request: String, limit: Duration) -> LinkError {
    let condition = transport.condition();
    LinkError::NoAnswer { place: transport.place().to_owned(), request, milliseconds: limit.as_millis(), condition }
}

impl<T: Transport> Client<T> {
    /// Meets the device and checks that both speak the same protocol.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub fn connect(transport: T) -> Result<Self, LinkError> {
        let client = Self::meet(transport)?;
        client.check_protocol()?;
        Ok(client)
    }

    /// Meets the device whatever it speaks; only its Hello may be trusted then.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub fn meet(mut transport: T) -> Result<Self, LinkError> {
        let mut line = Line::default();
        let hello = greet(&mut transport, &mut line, HELLO_ATTEMPTS)?;
        let token = transport.token_before_the_first();
        Ok(Self { transport, hello, line, token })
    }

    /// As [`Client::meet`], but asks only once: where somebody else may be at the other end.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub fn try_to_meet(mut transport: T) -> Result<Self, LinkError> {
        let mut line = Line::default();
        let hello = greet(&mut transport, &mut line, 1)?;
        let token = transport.token_before_the_first();
        Ok(Self { transport, hello, line, token })
    }

    /// Whether both speak the same protocol.
    ///
    /// # Errors
    /// [`LinkError::OldFirmware`], [`LinkError::NewFirmware`] or [`LinkError::OtherSchema`].
    pub fn check_protocol(&self) -> Result<(), LinkError> {
        let place = self.transport.place().to_owned();
        let firmware = version(self.hello.firmware);
        let (theirs, ours) = (self.hello.protocol, PROTOCOL);
        if theirs < ours {
            return Err(LinkError::OldFirmware { place, firmware, theirs, ours });
        }
        if theirs > ours {
            return Err(LinkError::NewFirmware { place, firmware, theirs, ours });
        }
        if self.hello.schema_hash != SCHEMA_HASH {
            return Err(LinkError::OtherSchema { place, firmware, theirs: self.hello.schema_hash, ours: SCHEMA_HASH });
        }
        Ok(())
    }

    /// Who is there.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Asks again who is there: the active model may be another one now.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub fn greet_again(&mut self) -> Result<&Hello, LinkError> {
        self.hello = greet(&mut self.transport, &mut self.line, HELLO_ATTEMPTS)?;
        Ok(&self.hello)
    }

    /// The transport.
    pub fn transport(&mut self) -> &mut T {
        &mut self.transport
    }

    /// Gives the transport back.
    pub fn into_transport(self) -> T {
        self.transport
    }

    /// Time by the transport's clock.
    pub fn elapsed(&self) -> Duration {
        self.transport.elapsed()
    }

    /// Sends a request and does not wait; the reply will carry the token.
    ///
    /// # Errors
    /// When the device is gone.
    pub fn send(&mut self, request: &Request) -> Result<u32, LinkError> {
        self.token = self.token.wrapping_add(1);
        let frame = RequestFrame { token: self.token, session: self.hello.session, request: request.clone() };
        let wire = frame.to_wire().map_err(|_| LinkError::Rig(format!("the request {request:?} fits no frame")))?;
        self.transport.send(&wire)?;
        if let Some(stream) = &mut self.line.trace {
            stream.sent(self.token, *request == Request::Vent, &wire);
        }
        Ok(self.token)
    }

    /// Lets telemetry and replies come in for at most `limit`; returns as soon as anything came.
    ///
    /// # Errors
    /// When the device is gone.
    pub fn listen(&mut self, limit: Duration) -> Result<(), LinkError> {
        self.line.listen(&mut self.transport, limit)
    }

    /// The reply to a request sent before, if it has come.
    pub fn take_reply(&mut self, token: u32) -> Option<Reply> {
        let at = self.line.replies.iter().position(|reply| reply.token == token)?;
        Some(self.line.replies.remove(at).reply)
    }

    /// The oldest telemetry sample that has not been taken.
    pub fn take_telemetry(&mut self) -> Option<Telemetry> {
        self.line.telemetry.pop_front()
    }

    /// What arrived so far and what did not.
    pub fn account(&self) -> &Account {
        &self.line.account
    }

    /// Forgets samples and the account of them: a recording begins.
    pub fn begin_account(&mut self) {
        self.line.telemetry.clear();
        self.line.account = Account::default();
    }

    /// Makes the device begin again, as after a start, and tell every tick from then on. Gives what it kept.
    ///
    /// # Errors
    /// When it is not idle and vented, or is gone.
    pub fn begin_trace(&mut self) -> Result<Origin, LinkError> {
        // What may be left of the last one comes now.
        self.command(&Request::TraceEnd)?;
        self.listen_for(Duration::from_millis(50))?;
        self.line.trace = Some(Stream::default());
        match self.request(&Request::TraceBegin) {
            Ok(Reply::Status(status)) => {
                Ok(Origin { time_ms: status.time_ms, late_ticks: status.late_ticks, reset_cause: status.reset_cause })
            }
            other => {
                self.line.trace = None;
                other?;
                Err(self.unexpected(&Request::TraceBegin))
            }
        }
    }

    /// Ends the trace and gives what came of it. A device that does not answer any more has told what it has told.
    pub fn end_trace(&mut self, origin: Origin) -> Trace {
        // Without an answer there may still be something on its way.
        let _ = self.command(&Request::TraceEnd);
        let progress = |line: &Line| line.trace.as_ref().filter(|stream| !stream.has_ended()).map(Stream::len);
        while let Some(before) = progress(&self.line) {
            let until = self.transport.elapsed() + TRACE_WITHIN;
            while progress(&self.line) == Some(before) {
                let now = self.transport.elapsed();
                if now >= until || self.listen(until - now).is_err() {
                    return self.line.trace.take().unwrap_or_default().finish(origin);
                }
            }
        }
        self.line.trace.take().unwrap_or_default().finish(origin)
    }

    /// Lets time pass while listening.
    ///
    /// # Errors
    /// When the device is gone.
    pub fn listen_for(&mut self, time: Duration) -> Result<(), LinkError> {
        let until = self.transport.elapsed() + time;
        while self.transport.elapsed() < until {
            self.listen(until.saturating_sub(self.transport.elapsed()))?;
        }
        Ok(())
    }

    /// Sends a request and waits for its reply, whatever it is.
    ///
    /// # Errors
    /// [`LinkError::NoAnswer`] or the transport's.
    pub fn ask(&mut self, request: &Request) -> Result<Reply, LinkError> {
        let reply = self.ask_once(request)?;
        if reply != Reply::Refused(Refusal::OtherSession) || !request.only_asks() {
            return Ok(reply);
        }
        // The device has restarted. What moves something must not be repeated unseen; what only asks may.
        self.greet_again()?;
        self.ask_once(request)
    }

    fn ask_once(&mut self, request: &Request) -> Result<Reply, LinkError> {
        // Replies nobody waited for are of no use any more.
        self.line.replies.clear();
        let token = self.send(request)?;
        let limit = match request {
            Request::SettingsSave | Request::ModelBegin { .. } | Request::ModelChunk { .. } | Request::ModelFinish => FLASH_WITHIN,
            Request::ModelActivate { .. } => FLASH_WITHIN,
            _ => REPLY_WITHIN,
        };
        let until = self.transport.elapsed() + limit;
        loop {
            if let Some(reply) = self.take_reply(token) {
                return Ok(reply);
            }
            let now = self.transport.elapsed();
            if now >= until {
                return Err(silence(&self.transport, name(request), limit));
            }
            self.listen(until - now)?;
        }
    }

    /// As [`Client::ask`], but a refusal is an error.
    ///
    /// # Errors
    /// [`LinkError::Refused`] too.
    pub fn request(&mut self, request: &Request) -> Result<Reply, LinkError> {
        match self.ask(request)? {
            Reply::Refused(refusal) => Err(LinkError::Refused(refusal)),
            reply => Ok(reply),
        }
    }

    /// A request that is answered by nothing but "done".
    ///
    /// # Errors
    /// As [`Client::request`], and [`LinkError::Unexpected`].
    pub fn command(&mut self, request: &Request) -> Result<(), LinkError> {
        match self.request(request)? {
            Reply::Done => Ok(()),
            _ => Err(self.unexpected(request)),
        }
    }

    /// The error for a reply that does not belong to its request.
    pub fn unexpected(&self, request: &Request) -> LinkError {
        LinkError::Unexpected { place: self.transport.place().to_owned(), request: name(request) }
    }
}

/// A version as people write it.
#[must_use]
pub fn version([major, minor, patch]: [u16; 3]) -> String {
    format!("{major}.{minor}.{patch}")
}

/// A request without its contents.
fn name(request: &Request) -> String {
    let text = format!("{request:?}");
    text.split([' ', '(', '{']).next().unwrap_or(&text).to_owned()
}
