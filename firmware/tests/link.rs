//! The line between host and device: sessions, frames, playback, set-points, and what gets lost.

mod common;
mod session;

use common::{Breakage, FACTS, set_point_settings};
use firmware::link::{Link, LinkConfig, Measured, REPLY_QUEUE, TELEMETRY_QUEUE};
use model_export::link::fault::{Blocker, Fault};
use model_export::link::frame::Decoder;
use model_export::link::hello::Hello;
use model_export::link::message::*;
use model_export::link::settings::Settings;
use model_export::link::state::{ResetCause, State};
use model_export::link::{Kind, PROTOCOL, SCHEMA_HASH};
use session::{QUEUE, Queue, Ram, Session};

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
fn a_host_that_finds_the_playback_full_is_there() {
    let mut session = Session::idle(&Settings::default());
    let chunk = |first_index, count: usize| {
        Request::Playback(PlaybackChunk { first_index, last: false, values_bar: heapless::Vec::from_slice(&vec![0.5; count]).unwrap() })
    };
    for index in 0..8 {
        assert!(matches!(session.ask(chunk(32 * index, 32)), Reply::Playback { .. }));
    }
    session.ask(Request::Arm);
    session.ask(Request::Start);
    let started = session.bench.time_ms;
    let mut full = 0;
    while session.bench.time_ms < started + 2_000 {
        // Always more than fits: the buffer takes a point every 20 ms.
        full += u32::from(matches!(session.ask(chunk(256, 32)), Reply::Refused(Refusal::PlaybackFull(_))));
        if session.bench.time_ms > started + 600 {
            break;
        }
    }
    assert!(full > 10 && session.bench.first_fault() == 0, "{full} refusals, E{:03}", session.bench.first_fault());
    assert_eq!(session.bench.state(), State::Running);
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
