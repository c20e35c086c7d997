//! A host and a device in one process: frames in, the whole tick behind them, frames out.
#![allow(dead_code, reason = "every test file uses its own part of the session")]

use std::cell::Cell;
use std::collections::VecDeque;

use firmware::link::{CommandSink, Event, Link, LinkConfig, Measured};
use firmware::settings;
use firmware::storage::{Flash, Slot, Store};
use firmware::tick::{Answer, Command};
use model_export::link::Kind;
use model_export::link::fault::Fault;
use model_export::link::frame::Decoder;
use model_export::link::hello::Hello;
use model_export::link::message::{Message, Reply, ReplyFrame, Request, RequestFrame, Status, Telemetry};
use model_export::link::settings::{Settings, by_name};
use model_export::link::state::ResetCause;

use crate::common::{Bench, FACTS};

/// Commands that wait for a tick at most.
pub const QUEUE: usize = 4;

#[derive(Clone, Debug)]
pub struct Ram(pub [Vec<u8>; 2], pub bool);

impl Ram {
    pub fn new() -> Self {
        Self([vec![0xff; 8192], vec![0xff; 8192]], false)
    }
}

impl Flash for Ram {
    type Error = ();
    fn contents(&self, slot: Slot) -> &[u8] {
        &self.0[usize::from(slot == Slot::B)]
    }
    fn erase(&mut self, slot: Slot) -> Result<(), ()> {
        if self.1 {
            return Err(());
        }
        self.0[usize::from(slot == Slot::B)].fill(0xff);
        Ok(())
    }
    fn program(&mut self, slot: Slot, offset: u32, word: u32) -> Result<(), ()> {
        let bytes = &mut self.0[usize::from(slot == Slot::B)][offset as usize..][..4];
        bytes.iter_mut().zip(word.to_le_bytes()).for_each(|(byte, new)| *byte &= new);
        Ok(())
    }
}

#[derive(Default)]
pub struct Queue {
    pub commands: VecDeque<Command>,
    pub vent: bool,
}

impl CommandSink for Queue {
    fn send(&mut self, command: Command) -> bool {
        let fits = self.commands.len() < QUEUE;
        if fits {
            self.commands.push_back(command);
        }
        fits
    }
    fn vent(&mut self) {
        self.vent = true;
    }
}

/// Device and host.
pub struct Session {
    pub bench: Bench,
    pub link: Link<Ram, Ram>,
    pub queue: Queue,
    pub token: u32,
    pub session: u32,
    pub decoder: Decoder,
    pub replies: Vec<ReplyFrame>,
    pub telemetry: Vec<Telemetry>,
    pub hello: Option<Hello>,
    pub model_is_good: Cell<bool>,
    pub events: Vec<Event>,
    pub host_reads: bool,
}

impl Session {
    pub fn new(settings: &Settings) -> Self {
        let mut store = Store::new(Ram::new(), settings::STORE_KIND, settings::STORE_VERSION);
        store.save(&settings::encode(settings).unwrap()).unwrap();
        Self::with_flash(store.release(), Ram::new())
    }

    pub fn with_flash(settings_flash: Ram, model_flash: Ram) -> Self {
        let config = LinkConfig {
            firmware: [0, 1, 0],
            board: heapless::String::try_from("bench").unwrap(),
            reset_cause: ResetCause::PowerOn,
            previous_record: None,
            facts: FACTS,
        };
        let link = Link::new(config, settings_flash, model_flash);
        let mut session = Self {
            bench: Bench::new(link.settings()),
            link,
            queue: Queue::default(),
            token: 0,
            session: 0,
            decoder: Decoder::new(),
            replies: Vec::new(),
            telemetry: Vec::new(),
            hello: None,
            model_is_good: Cell::new(true),
            events: Vec::new(),
            host_reads: true,
        };
        session.greet();
        session
    }

    /// Begins a session.
    pub fn greet(&mut self) {
        self.bytes(&model_export::link::frame::encode(&[Kind::HelloRequest.byte()]).unwrap());
        self.hear();
        self.session = self.hello.as_ref().unwrap().session;
    }

    pub fn idle(settings: &Settings) -> Self {
        let mut session = Self::new(settings);
        session.bench = session.bench.into_idle();
        session.step();
        session
    }

    pub fn bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let event = self.link.receive(*byte, &mut self.queue);
            if event == Some(Event::ModelUploaded) {
                assert!(self.link.uploaded_model().is_some());
                self.link.finish_upload(if self.model_is_good.get() { Ok(()) } else { Err(Fault::GoldenMismatch) }, &mut self.queue);
            } else {
                self.events.extend(event);
            }
        }
    }

    pub fn send(&mut self, request: Request) -> u32 {
        self.token += 1;
        let wire = RequestFrame { token: self.token, session: self.session, request }.to_wire().unwrap();
        self.bytes(&wire);
        self.token
    }

    /// One millisecond: a tick, its answer and sample to the link, what the link has to say to the host.
    pub fn step(&mut self) {
        self.bench.vent = std::mem::take(&mut self.queue.vent);
        let command = self.queue.commands.pop_front();
        let token = command.as_ref().and_then(|command| command.token);
        let answered = self.bench.replies.len();
        self.bench.step_with(command.map(|command| command.action));
        let outputs = &self.bench.outputs;
        self.link.observe(
            outputs.state,
            outputs.vent_verified,
            Measured { longest_tick_cycles: 5, stack_unused_bytes: 6, noise: 77, ..Measured::default() },
        );
        if let Some(sample) = outputs.telemetry {
            self.link.telemetry(sample);
        }
        // The bench puts its own token on every command; the queue remembers the host's.
        for reply in self.bench.replies.drain(answered..) {
            if let Some(token) = token {
                self.link.answer(Answer { token, reply });
            }
        }
        self.hear();
    }

    /// What the link has to say.
    pub fn hear(&mut self) {
        while self.host_reads
            && let Some(wire) = self.link.transmit()
        {
            for byte in wire {
                let Some(payload) = self.decoder.push(*byte) else { continue };
                let payload = payload.unwrap();
                match Kind::from_byte(payload[0]).unwrap() {
                    Kind::HelloAnswer => self.hello = Some(Hello::decode(payload).unwrap()),
                    Kind::Reply => self.replies.push(ReplyFrame::from_payload(payload).unwrap()),
                    Kind::Telemetry => self.telemetry.push(Telemetry::from_payload(payload).unwrap()),
                    other => panic!("a device does not send {other:?}"),
                }
            }
        }
    }

    pub fn ask(&mut self, request: Request) -> Reply {
        let token = self.send(request);
        self.step();
        let frame = self.replies.last().expect("an answer within a tick");
        assert_eq!(frame.token, token);
        frame.reply.clone()
    }

    pub fn status(&mut self) -> Status {
        let Reply::Status(status) = self.ask(Request::Status) else { panic!("no status") };
        status
    }
}

/// Number of a setting.
pub fn number(name: &str) -> u16 {
    by_name(name).unwrap().number
}
