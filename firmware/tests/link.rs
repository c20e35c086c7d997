//! A host and a device in one process: frames in, the whole tick behind them, frames out.

mod common;

use std::cell::Cell;
use std::collections::VecDeque;

use common::{Bench, Breakage, FACTS, set_point_settings};
use firmware::link::{CommandSink, Event, Link, LinkConfig, Measured, REPLY_QUEUE, TELEMETRY_QUEUE};
use firmware::settings;
use firmware::storage::{Flash, Slot, Store};
use firmware::supervisor::Vent;
use firmware::tick::{Action, Answer, Command};
use model_export::blob::crc32;
use model_export::link::fault::{Blocker, Fault};
use model_export::link::frame::Decoder;
use model_export::link::hello::Hello;
use model_export::link::message::*;
use model_export::link::settings::{SettingError, SettingValue, Settings, by_name};
use model_export::link::state::{ResetCause, State};
use model_export::link::{Kind, PROTOCOL, SCHEMA_HASH};

const QUEUE: usize = 4;

#[derive(Clone, Debug)]
struct Ram([Vec<u8>; 2], bool);

impl Ram {
    fn new() -> Self {
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
struct Queue {
    commands: VecDeque<Command>,
    vent: bool,
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
struct Session {
    bench: Bench,
    link: Link<Ram, Ram>,
    queue: Queue,
    token: u32,
    session: u32,
    decoder: Decoder,
    replies: Vec<ReplyFrame>,
    telemetry: Vec<Telemetry>,
    hello: Option<Hello>,
    model_is_good: Cell<bool>,
    events: Vec<Event>,
    host_reads: bool,
}

impl Session {
    fn new(settings: &Settings) -> Self {
        let mut store = Store::new(Ram::new(), settings::STORE_KIND, settings::STORE_VERSION);
        store.save(&settings::encode(settings).unwrap()).unwrap();
        Self::with_flash(store.release(), Ram::new())
    }

    fn with_flash(settings_flash: Ram, model_flash: Ram) -> Self {
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
    fn greet(&mut self) {
        self.bytes(&model_export::link::frame::encode(&[Kind::HelloRequest.byte()]).unwrap());
        self.hear();
        self.session = self.hello.as_ref().unwrap().session;
    }

    fn idle(settings: &Settings) -> Self {
        let mut session = Self::new(settings);
        session.bench = session.bench.into_idle();
        session.step();
        session
    }

    fn bytes(&mut self, bytes: &[u8]) {
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

    fn send(&mut self, request: Request) -> u32 {
        self.token += 1;
        let wire = RequestFrame { token: self.token, session: self.session, request }.to_wire().unwrap();
        self.bytes(&wire);
        self.token
    }

    /// One millisecond: a tick, its answer and sample to the link, what the link has to say to the host.
    fn step(&mut self) {
        self.bench.vent = std::mem::take(&mut self.queue.vent);
        let command = self.queue.commands.pop_front();
        let token = command.as_ref().and_then(|command| command.token);
        let answered = self.bench.replies.len();
        self.bench.step_with(command.map(|command| command.action));
        let outputs = &self.bench.outputs;
        self.link.observe(outputs.state, outputs.vent_verified, Measured { longest_tick_cycles: 5, stack_unused_bytes: 6, noise: 77 });
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
    fn hear(&mut self) {
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

    fn ask(&mut self, request: Request) -> Reply {
        let token = self.send(request);
        self.step();
        let frame = self.replies.last().expect("an answer within a tick");
        assert_eq!(frame.token, token);
        frame.reply.clone()
    }

    fn status(&mut self) -> Status {
        let Reply::Status(status) = self.ask(Request::Status) else { panic!("no status") };
        status
    }
}

fn number(name: &str) -> u16 {
    by_name(name).unwrap().number
}

#[test]
fn hello_is_answered_in_any_state_and_behind_garbage() {
    let mut session = Session::new(&Settings::default());
    session.bytes(&[0xa5, 0x00, 0x13, 0x37]);
    session.bytes(&[0x00]);
    session.bytes(&model_export::link::frame::encode(&[Kind::HelloRequest.byte(), 99, 98]).unwrap());
    session.step();
    let hello = session.hello.clone().unwrap();
    assert_eq!((hello.protocol, hello.schema_hash, hello.board.as_str()), (PROTOCOL, SCHEMA_HASH, "bench"));
    assert_eq!(hello.reset_cause, ResetCause::PowerOn);
    assert_eq!(session.session, hello.session, "no request came yet, so it is the same session");
    assert_eq!(session.status().damaged_frames, 2);
}

#[test]
fn frames_of_another_session_and_old_ones_move_nothing_and_a_vent_is_always_welcome() {
    let mut session = Session::idle(&set_point_settings());
    let frame = |session: &Session, token, request| RequestFrame { token, session: session.session, request }.to_wire().unwrap();
    let set_point = |value| Request::SetPoint { quantity: Quantity::Pressure, value };
    assert_eq!(session.ask(Request::Arm), Reply::Done);
    assert_eq!(session.ask(Request::Start), Reply::Done);
    let old = frame(&session, session.token + 1, set_point(2.0));
    for _ in 0..20 {
        session.ask(set_point(0.5));
    }
    session.replies.clear();
    let before = session.status().damaged_frames;
    // The same session: an old frame again, and the newest one twice.
    session.bytes(&old);
    let newest = frame(&session, session.token, set_point(2.0));
    session.bytes(&newest);
    session.step();
    assert_eq!(session.status().damaged_frames, before + 2);
    assert_eq!(session.bench.rig.insight().set_point, 0.5);

    // Everything that was ever said, after the next host has begun: the rig does not even arm.
    let arm_and_start: Vec<_> =
        (100..).zip([Request::Arm, Request::Start, set_point(2.0)]).map(|(token, request)| frame(&session, token, request)).collect();
    let first = session.session;
    session.ask(Request::Vent);
    session.greet();
    assert_ne!(session.session, first);
    for _ in 0..500 {
        session.step();
    }
    session.replies.clear();
    for frame in &arm_and_start {
        session.bytes(frame);
        session.step();
    }
    assert!(session.replies.iter().all(|frame| frame.reply == Reply::Refused(Refusal::OtherSession)) && session.replies.len() == 3);
    assert_eq!(session.bench.state(), State::Idle);

    // A vent of anybody.
    session.token = 0;
    assert_eq!(session.ask(Request::Arm), Reply::Done);
    let strange = RequestFrame { token: 0, session: 12_345, request: Request::Vent }.to_wire().unwrap();
    session.bytes(&strange);
    session.step();
    assert_eq!(session.bench.state(), State::Idle);
}

#[test]
fn a_device_that_nobody_greeted_takes_no_request_and_each_start_has_its_own_sessions() {
    let config = || LinkConfig {
        firmware: [0, 1, 0],
        board: heapless::String::new(),
        reset_cause: ResetCause::PowerOn,
        previous_record: None,
        facts: FACTS,
    };
    let greet = model_export::link::frame::encode(&[Kind::HelloRequest.byte()]).unwrap();
    let mut seen = std::collections::HashSet::new();
    for noise in 0..200 {
        let mut link = Link::new(config(), Ram::new(), Ram::new());
        let mut queue = Queue::default();
        link.observe(State::Idle, true, Measured { noise, ..Measured::default() });
        let arm = RequestFrame { token: 1, session: 0, request: Request::Arm }.to_wire().unwrap();
        for byte in &arm {
            link.receive(*byte, &mut queue);
        }
        assert!(queue.commands.is_empty());
        let _ = link.transmit();
        for byte in &greet {
            link.receive(*byte, &mut queue);
        }
        let mut decoder = Decoder::new();
        let hello =
            link.transmit().unwrap().iter().find_map(|byte| decoder.push(*byte).map(|payload| Hello::decode(payload.unwrap()).unwrap()));
        assert!(seen.insert(hello.unwrap().session));
    }
}

#[test]
fn a_whole_playback_comes_out_point_by_point() {
    // At this slew the tip's inertia, which the bench's model does not have, would be a mismatch when the end drops the pressure.
    let settings = Settings { slew_up_bar_per_s: 100.0, slew_down_bar_per_s: 100.0, mismatch_displacement_mm: 0.0, ..Settings::default() };
    let mut session = Session::idle(&settings);
    // Three seconds of the paper's eq. (1) at 0.8 Hz without noise: A = 1.5 bar, tau = 0.1.
    let points: Vec<f32> = (0..150u16)
        .map(|index| {
            let time_s = f32::from(index) * 0.02;
            1.5 * (-0.1 * time_s).exp() * ((core::f32::consts::TAU * 0.8 * time_s - core::f32::consts::FRAC_PI_2).sin() + 1.0)
        })
        .collect();
    let mut chunks = points.chunks(MAX_CHUNK_POINTS).enumerate().map(|(index, values)| PlaybackChunk {
        first_index: (index * MAX_CHUNK_POINTS) as u32,
        last: (index + 1) * MAX_CHUNK_POINTS >= points.len(),
        values_bar: heapless::Vec::from_slice(values).unwrap(),
    });
    assert_eq!(session.ask(Request::Playback(chunks.next().unwrap())), Reply::Playback { next_index: 32, free: 224 });
    assert_eq!(session.ask(Request::Arm), Reply::Done);
    assert_eq!(session.ask(Request::Start), Reply::Done);
    session.telemetry.clear();
    let mut sent_all = false;
    for tick in 0..4_000u32 {
        if tick.is_multiple_of(100) && session.bench.state() == State::Running {
            match chunks.next() {
                Some(chunk) => drop(session.ask(Request::Playback(chunk))),
                None => {
                    sent_all = true;
                    let chunk = PlaybackChunk { first_index: 150, last: true, values_bar: heapless::Vec::new() };
                    let reply = session.ask(Request::Playback(chunk));
                    assert!(matches!(reply, Reply::Playback { next_index: 150, .. }), "{reply:?}");
                }
            }
        } else {
            session.step();
        }
    }
    assert_eq!(session.bench.first_fault(), 0, "{:?}", session.bench.rig.supervisor().record());
    assert!(sent_all);
    assert_eq!(session.bench.state(), State::Armed, "the end of the experiment leads back to armed");
    // Every window of the filter saw one point but for the slew at its beginning: 0.1 bar a millisecond.
    let seen: Vec<_> = session.telemetry.iter().filter(|sample| sample.state == State::Running && sample.playback_index > 0).collect();
    assert!(seen.len() >= 150, "{} samples", seen.len());
    for (index, sample) in seen.iter().take(150).enumerate() {
        assert_eq!(sample.playback_index as usize, index + 1);
        assert!((sample.set_point - points[index]).abs() < 1e-6);
        let before = if index == 0 { 0.0 } else { points[index - 1] };
        let step = (points[index] - before).abs();
        let tolerance = step * (step / 0.1).ceil() / 20.0 + step / 20.0 + 1e-5;
        assert!((sample.command_bar - points[index]).abs() <= tolerance, "point {index}: {} {}", sample.command_bar, points[index]);
    }
    for pair in session.telemetry.windows(2) {
        assert_eq!((pair[1].sequence, pair[1].time_ms), (pair[0].sequence + 1, pair[0].time_ms + 20));
    }
}

#[test]
fn a_lost_or_repeated_chunk_is_told_and_changes_nothing() {
    let mut session = Session::idle(&Settings::default());
    let chunk = |first_index, count: usize, last| {
        Request::Playback(PlaybackChunk { first_index, last, values_bar: heapless::Vec::from_slice(&vec![0.5; count]).unwrap() })
    };
    assert_eq!(session.ask(chunk(0, 32, false)), Reply::Playback { next_index: 32, free: 224 });
    assert_eq!(session.ask(chunk(0, 32, false)), Reply::Playback { next_index: 32, free: 224 });
    assert_eq!(session.ask(chunk(64, 32, false)), Reply::Refused(Refusal::PlaybackIndex(32)));
    for index in 1..8 {
        session.ask(chunk(32 * index, 32, false));
    }
    assert_eq!(session.ask(chunk(256, 1, true)), Reply::Refused(Refusal::PlaybackFull(0)));
    assert_eq!(session.ask(Request::PlaybackClear), Reply::Done);
    let not_a_number = PlaybackChunk { first_index: 0, last: false, values_bar: heapless::Vec::from_slice(&[f32::NAN]).unwrap() };
    assert_eq!(session.ask(Request::Playback(not_a_number)), Reply::Refused(Refusal::NotFinite));
    let set_point = Request::SetPoint { quantity: Quantity::Pressure, value: 1.0 };
    assert_eq!(session.ask(set_point), Reply::Refused(Refusal::WrongQuantity));
    assert_eq!(session.ask(Request::Arm), Reply::Done);
    let Reply::Refused(Refusal::Blocked(blockers)) = session.ask(Request::Start) else { panic!("started with nothing to play") };
    assert!(blockers.contains(Blocker::PlaybackEmpty));
}

#[test]
fn only_set_points_keep_a_running_rig_alive() {
    let mut session = Session::idle(&set_point_settings());
    session.ask(Request::Arm);
    session.ask(Request::Start);
    let started = session.bench.time_ms;
    while session.bench.state() == State::Running && session.bench.time_ms < started + 1_000 {
        // A host that talks without end, but has no set-point to give, and one set-point that is none.
        session.ask(Request::Status);
        session.ask(Request::SetPoint { quantity: Quantity::Pressure, value: f32::NAN });
        session.ask(Request::SetPoint { quantity: Quantity::Displacement, value: 1.0 });
    }
    assert_eq!(session.bench.first_fault(), Fault::HostLost.number());
    let lasted = session.bench.time_ms - started;
    assert!((250..=254).contains(&lasted), "{lasted} ms");

    let mut session = Session::idle(&set_point_settings());
    session.ask(Request::Arm);
    session.ask(Request::Start);
    for _ in 0..10 {
        session.ask(Request::SetPoint { quantity: Quantity::Pressure, value: 0.5 });
        for _ in 0..240 {
            session.step();
        }
    }
    assert_eq!(session.bench.state(), State::Running);
    assert!((session.bench.outputs.output.bar() - 0.5).abs() < 1e-6);
}

#[test]
fn settings_are_checked_compared_saved_and_survive_a_restart() {
    let mut session = Session::idle(&Settings::default());
    let ceiling = number("limits.ceiling_bar");
    assert_eq!(session.ask(Request::SettingGet { number: ceiling }), Reply::Setting(SettingValue::Float(3.0)));
    let set = |number, value| Request::SettingSet { number, value };
    assert_eq!(session.ask(set(ceiling, SettingValue::Float(40.0))), Reply::Refused(Refusal::Setting(SettingError::OutOfBounds)));
    assert_eq!(session.ask(set(ceiling, SettingValue::Flag(true))), Reply::Refused(Refusal::Setting(SettingError::WrongType)));
    assert_eq!(session.ask(set(999, SettingValue::Flag(true))), Reply::Refused(Refusal::Setting(SettingError::Unknown)));
    // Each value is allowed, both together make no calibration.
    let laser_high = number("laser.high_v");
    assert_eq!(session.ask(set(laser_high, SettingValue::Float(0.5))), Reply::Refused(Refusal::SettingsInconsistent(10)));
    assert_eq!(session.ask(Request::SettingGet { number: laser_high }), Reply::Setting(SettingValue::Float(3.0)));

    assert_eq!(session.ask(set(ceiling, SettingValue::Float(2.0))), Reply::Done);
    assert_eq!(session.bench.rig.built().limiter().ceiling().0, 2_000_000, "in force");
    assert!(session.status().settings_unsaved);
    let difference = SettingDifference { number: ceiling, in_use: SettingValue::Float(2.0), baseline: SettingValue::Float(3.0) };
    let page = Reply::Differences { entries: heapless::Vec::from_slice(&[difference]).unwrap(), next_number: 0 };
    assert_eq!(session.ask(Request::SettingsDifference { baseline: Baseline::Saved, from_number: 0 }), page);
    assert_eq!(session.ask(Request::SettingsSave), Reply::Done);
    assert!(!session.status().settings_unsaved);

    assert_eq!(session.ask(Request::SettingsRevert(Baseline::Defaults)), Reply::Done);
    assert_eq!(session.bench.rig.built().limiter().ceiling().0, 3_000_000);
    let (settings_flash, model_flash) = session.link.release();
    let restarted = Session::with_flash(settings_flash, model_flash);
    assert_eq!(*restarted.link.settings(), Settings { ceiling_bar: 2.0, ..Settings::default() });
    assert!(restarted.link.boot_faults().is_empty());
}

#[test]
fn long_differences_come_in_pages() {
    let mut session = Session::idle(&Settings::default());
    let mut changed = 0;
    for info in model_export::link::settings::INFO {
        let value = match (info.default, info.maximum) {
            (SettingValue::Float(default), SettingValue::Float(maximum)) => SettingValue::Float((default * 1.01).min(maximum)),
            (SettingValue::Integer(default), _) if info.number < 50 => SettingValue::Integer(default + 1),
            _ => continue,
        };
        if session.ask(Request::SettingSet { number: info.number, value }) == Reply::Done && value != info.default {
            changed += 1;
        }
    }
    assert!(changed > MAX_PAGE, "{changed}");
    let (mut from_number, mut seen) = (0, Vec::new());
    loop {
        let Reply::Differences { entries, next_number } =
            session.ask(Request::SettingsDifference { baseline: Baseline::Defaults, from_number })
        else {
            panic!("no page")
        };
        seen.extend(entries.iter().map(|entry| entry.number));
        if next_number == 0 {
            break;
        }
        from_number = next_number;
    }
    assert_eq!(seen.len(), changed);
    assert!(seen.is_sorted_by(|a, b| a < b));
}

#[test]
fn nothing_is_configured_or_written_while_there_can_be_pressure() {
    let mut session = Session::idle(&set_point_settings());
    session.ask(Request::Arm);
    let refused = Reply::Refused(Refusal::State(State::Armed));
    let set = Request::SettingSet { number: number("limits.ceiling_bar"), value: SettingValue::Float(1.0) };
    assert_eq!(session.ask(set), refused);
    assert_eq!(session.link.settings().ceiling_bar, 3.0);
    assert_eq!(session.ask(Request::SettingsSave), refused);
    assert_eq!(session.ask(Request::ModelBegin { length: 4, crc32: 0 }), refused);
    assert_eq!(session.ask(Request::ModelActivate { id: [0x11; 8] }), refused);
}

#[test]
fn a_command_on_its_way_keeps_the_flash_untouched() {
    let mut session = Session::idle(&set_point_settings());
    session.send(Request::Arm);
    let token = session.send(Request::SettingsSave);
    session.step();
    let reply = session.replies.iter().find(|frame| frame.token == token).unwrap();
    assert_eq!(reply.reply, Reply::Refused(Refusal::Busy));
}

#[test]
fn a_model_arrives_in_pieces_is_checked_activated_and_rolled_back() {
    let mut session = Session::idle(&Settings::default());
    let upload = |session: &mut Session, blob: &[u8]| {
        assert_eq!(session.ask(Request::ModelBegin { length: blob.len() as u32, crc32: crc32(0, blob) }), Reply::Done);
        for (index, piece) in blob.chunks(MAX_CHUNK_BYTES).enumerate() {
            let bytes = heapless::Vec::from_slice(piece).unwrap();
            let next = (index * MAX_CHUNK_BYTES + piece.len()) as u32;
            let chunk = Request::ModelChunk { offset: (index * MAX_CHUNK_BYTES) as u32, bytes };
            assert_eq!(session.ask(chunk), Reply::Uploaded(next));
        }
        session.ask(Request::ModelFinish)
    };
    let (first, second) = (vec![0x11; 1001], vec![0x22; 2000]);
    assert_eq!(session.ask(Request::ModelFinish), Reply::Refused(Refusal::NoUpload));
    assert_eq!(session.ask(Request::ModelActivate { id: [0x11; 8] }), Reply::Refused(Refusal::NoOtherModel));
    assert_eq!(session.ask(Request::ModelBegin { length: 9_000, crc32: 0 }), Reply::Refused(Refusal::TooLong(7_168)));
    assert_eq!(upload(&mut session, &first), Reply::Done);
    assert_eq!(session.link.model_blob(), None, "uploaded is not active");
    assert_eq!(session.ask(Request::Models), Reply::Models { active: [0; 8], other: [0x11; 8] });
    assert_eq!(session.ask(Request::ModelActivate { id: [0x11; 8] }), Reply::Done);
    assert_eq!(session.link.model_blob(), Some(first.as_slice()));
    assert_eq!(session.events, [Event::ModelChanged]);
    assert_eq!(upload(&mut session, &second), Reply::Done);
    // A host that lost the reply asks again, and again.
    for _ in 0..3 {
        assert_eq!(session.ask(Request::ModelActivate { id: [0x22; 8] }), Reply::Done);
        assert_eq!(session.link.model_blob(), Some(second.as_slice()));
    }
    assert_eq!(session.events.len(), 2, "what changes nothing tests nothing");
    assert_eq!(session.ask(Request::ModelActivate { id: [0x33; 8] }), Reply::Refused(Refusal::NoOtherModel));
    assert_eq!(session.ask(Request::Models), Reply::Models { active: [0x22; 8], other: [0x11; 8] });
    assert_eq!(session.ask(Request::ModelActivate { id: [0x11; 8] }), Reply::Done);
    assert_eq!(session.link.model_blob(), Some(first.as_slice()));

    session.model_is_good.set(false);
    assert_eq!(upload(&mut session, &second), Reply::Refused(Refusal::NotAModel));
    let activate_second = Request::ModelActivate { id: [0x22; 8] };
    assert_eq!(session.ask(activate_second), Reply::Refused(Refusal::NoOtherModel), "what is no model cannot be activated");
    session.ask(Request::ModelBegin { length: 8, crc32: 0 });
    let bytes = heapless::Vec::from_slice(&[1, 2, 3]).unwrap();
    assert_eq!(session.ask(Request::ModelChunk { offset: 0, bytes }), Reply::Refused(Refusal::PieceLength));
    let bytes = heapless::Vec::from_slice(&[1, 2, 3, 4]).unwrap();
    assert_eq!(session.ask(Request::ModelChunk { offset: 4, bytes: bytes.clone() }), Reply::Refused(Refusal::UploadOffset(0)));
    session.ask(Request::ModelChunk { offset: 0, bytes });
    assert_eq!(session.ask(Request::ModelFinish), Reply::Refused(Refusal::Checksum));
    assert_eq!(session.link.model_blob(), Some(first.as_slice()));
}

#[test]
fn a_vent_gets_past_a_full_queue() {
    let mut session = Session::idle(&set_point_settings());
    session.ask(Request::Arm);
    session.ask(Request::Start);
    for _ in 0..QUEUE {
        session.send(Request::SetPoint { quantity: Quantity::Pressure, value: 3.0 });
    }
    let busy = session.send(Request::Status);
    let vent = session.send(Request::Vent);
    session.step();
    assert_eq!(session.bench.state(), State::Idle);
    assert!(!session.bench.outputs.energised);
    let reply = |token| session.replies.iter().find(|frame| frame.token == token).map(|frame| frame.reply.clone());
    assert_eq!(reply(vent), Some(Reply::Done));
    assert_eq!(reply(busy), Some(Reply::Refused(Refusal::Busy)));
}

#[test]
fn a_request_of_tomorrow_is_refused_by_its_token() {
    let mut session = Session::idle(&Settings::default());
    // Token 300, request number 99.
    session.bytes(&model_export::link::frame::encode(&[Kind::Request.byte(), 0xac, 0x02, 99, 1, 2, 3]).unwrap());
    session.step();
    assert_eq!(session.replies.last(), Some(&ReplyFrame { token: 300, reply: Reply::Refused(Refusal::NotUnderstood) }));
}

#[test]
fn a_host_that_does_not_read_loses_telemetry_by_count_and_the_rig_does_not_care() {
    let settings = Settings { telemetry_period_ms: 1, ..set_point_settings() };
    let mut session = Session::idle(&settings);
    session.telemetry.clear();
    session.host_reads = false;
    for _ in 0..100 {
        session.step();
    }
    let dropped = 100 - TELEMETRY_QUEUE as u32;
    assert_eq!(session.link.telemetry_dropped(), dropped);
    session.host_reads = true;
    assert_eq!(session.status().telemetry_dropped, dropped + 1);
    let gap: Vec<_> = session.telemetry.windows(2).filter(|pair| pair[1].sequence != pair[0].sequence + 1).collect();
    assert!(gap.is_empty(), "what arrives of the queue is its oldest part");
    session.step();
    let newest = session.telemetry.last().unwrap();
    assert!(newest.sequence - session.telemetry[TELEMETRY_QUEUE - 1].sequence > dropped);
    // Replies beyond their queue are lost too, not waited for.
    session.host_reads = false;
    for _ in 0..3 * REPLY_QUEUE {
        session.send(Request::SettingGet { number: 1 });
    }
    session.host_reads = true;
    session.replies.clear();
    session.step();
    assert_eq!(session.replies.len(), REPLY_QUEUE);
}

#[test]
fn damaged_settings_in_flash_start_with_safe_defaults_and_a_fault() {
    let mut store = Store::new(Ram::new(), settings::STORE_KIND, settings::STORE_VERSION);
    store.save(&settings::encode(&Settings { ceiling_bar: 1.0, ..Settings::default() }).unwrap()).unwrap();
    let mut flash = store.release();
    flash.0[0][1100] ^= 1;
    let session = Session::with_flash(flash, Ram::new());
    assert_eq!(*session.link.settings(), Settings::default());
    assert!(session.link.boot_faults().contains(Fault::SettingsInvalid));
    // A new chip has no settings, which is no fault.
    assert!(Session::with_flash(Ram::new(), Ram::new()).link.boot_faults().is_empty());
}

#[test]
fn damaged_settings_keep_the_rig_vented_until_settings_are_saved_again() {
    let mut store = Store::new(Ram::new(), settings::STORE_KIND, settings::STORE_VERSION);
    store.save(&settings::encode(&Settings { ceiling_bar: 0.8, ..set_point_settings() }).unwrap()).unwrap();
    let mut flash = store.release();
    // A bit of the header.
    flash.0[0][9] ^= 4;
    let mut session = Session::with_flash(flash, Ram::new());
    assert!(session.link.boot_faults().contains(Fault::SettingsInvalid));
    assert!(session.link.standing_faults().contains(Fault::SettingsInvalid), "every self-test says so");
    session.bench = session.bench.into_idle();
    session.step();
    let report = session.link.standing_faults();
    session.bench.ask(Action::SelfTestReport { faults: report, model_period: None });
    session.step();
    assert_eq!(session.bench.state(), State::Fault);
    assert!(matches!(session.ask(Request::Arm), Reply::Refused(_)));
    let number = by_name("limits.ceiling_bar").unwrap().number;
    assert_eq!(session.ask(Request::SettingSet { number, value: SettingValue::Float(0.8) }), Reply::Done);
    // The sensors prove themselves again, and the vent is seen to work.
    for _ in 0..300 {
        session.step();
    }
    assert_eq!(session.ask(Request::SettingsSave), Reply::Done);
    assert!(session.link.standing_faults().is_empty());
    let (saved, _) = session.link.release();
    let again = Session::with_flash(saved, Ram::new());
    assert!(again.link.boot_faults().is_empty());
    assert_eq!(again.link.settings().ceiling_bar, 0.8);
}

#[test]
fn flash_is_written_only_once_the_vent_is_verified() {
    let mut session = Session::idle(&set_point_settings());
    session.ask(Request::Arm);
    session.ask(Request::Start);
    for _ in 0..50 {
        session.ask(Request::SetPoint { quantity: Quantity::Pressure, value: 2.0 });
    }
    let not_vented = Reply::Refused(Refusal::Blocked([Blocker::VentNotVerified].into_iter().collect()));
    for request in [Request::Disarm, Request::Vent] {
        session.ask(request);
        assert_eq!(session.bench.state(), State::Idle);
        assert!(session.bench.plant.pressure_bar > 0.5 || session.bench.rig.supervisor().vent() != Vent::Verified);
        assert_eq!(session.ask(Request::SettingsSave), not_vented);
        assert_eq!(session.ask(Request::ModelBegin { length: 8, crc32: 0 }), not_vented);
        assert!(session.link.flash().1.0.iter().flatten().all(|byte| *byte == 0xff), "nothing was touched");
        for _ in 0..400 {
            session.step();
        }
        assert_eq!(session.ask(Request::SettingsSave), Reply::Done);
    }
}

#[test]
fn worn_out_flash_is_a_refusal_and_a_fault() {
    let mut worn_out = Ram::new();
    worn_out.1 = true;
    let mut session = Session::with_flash(worn_out, Ram::new());
    session.bench = session.bench.into_idle();
    session.step();
    assert_eq!(session.ask(Request::SettingsSave), Reply::Refused(Refusal::Storage));
    session.step();
    assert_eq!((session.bench.state(), session.bench.first_fault()), (State::Fault, Fault::StorageFailed.number()));
}

#[test]
fn unplugging_the_host_in_mid_frame_vents_and_the_next_host_is_understood() {
    let mut session = Session::idle(&set_point_settings());
    session.ask(Request::Arm);
    session.ask(Request::Start);
    let wire =
        RequestFrame { token: 9, session: 0, request: Request::SetPoint { quantity: Quantity::Pressure, value: 1.0 } }.to_wire().unwrap();
    session.bytes(&wire[..wire.len() / 2]);
    session.bench.breakage = Some(Breakage::HostSilent);
    for _ in 0..400 {
        session.step();
    }
    assert_eq!(session.bench.first_fault(), Fault::HostLost.number());
    // A host that begins with a zero flushes what the last one left behind.
    session.bytes(&[0]);
    assert_eq!(session.status().first_fault, Fault::HostLost.number());
}
