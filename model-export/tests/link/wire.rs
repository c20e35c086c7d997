//! The bytes on the wire, against those of an independent encoder, so that neither a new library version nor a moved field can change them
//! unnoticed.

use heapless::Vec;
use model_export::blob::crc32;
use model_export::link::adaptation::{AdaptationReport, Adapting};
use model_export::link::frame::{Decoder, FrameError, MAX_PAYLOAD, MAX_WIRE, encode};
use model_export::link::hello::{Build, Hello, HelloError};
use model_export::link::history::{HistoryPiece, MAX_PIECE_ROWS, ROW_BYTES};
use model_export::link::message::*;
use model_export::link::settings::SettingValue;
use model_export::link::state::ResetCause;
use model_export::link::trace::{MAX_PIECE_BYTES, TracePiece};
use model_export::link::{Kind, SCHEMA_HASH, fuzzing};
use proptest::prelude::*;

use crate::examples::{WIRE, hello, replies, requests, telemetry, trace};

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(text: &str) -> std::vec::Vec<u8> {
    (0..text.len()).step_by(2).map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap()).collect()
}

/// The payload of one whole frame.
fn payload(wire: &[u8]) -> std::vec::Vec<u8> {
    let mut decoder = Decoder::new();
    let payloads: std::vec::Vec<_> =
        wire.iter().filter_map(|byte| decoder.push(*byte).map(|payload| payload.map(<[u8]>::to_vec))).collect();
    assert_eq!(payloads.len(), 1);
    payloads[0].clone().unwrap()
}

/// Every example as this code encodes it, in the order of [`WIRE`].
fn encoded() -> std::vec::Vec<Vec<u8, MAX_WIRE>> {
    let mut frames = vec![encode(&[Kind::HelloRequest.byte()]).unwrap(), encode(&hello().encode()).unwrap()];
    frames.extend(requests().into_iter().map(|request| RequestFrame { token: 0x1234, session: 0x89ab_cdef, request }.to_wire().unwrap()));
    frames.extend(replies().into_iter().map(|reply| ReplyFrame { token: 7, reply }.to_wire().unwrap()));
    frames.push(telemetry().to_wire().unwrap());
    frames.push(trace().to_wire().unwrap());
    frames
}

#[test]
fn every_message_has_the_recorded_bytes_and_the_schema_hash_is_theirs() {
    let frames = encoded();
    assert_eq!(frames.len(), WIRE.len());
    let mut hash = 0;
    for (frame, (name, wire)) in frames.iter().zip(WIRE) {
        assert_eq!(hex(frame), *wire, "{name}");
        hash = crc32(hash, frame);
    }
    assert_eq!(hash, SCHEMA_HASH, "0x{hash:08x}");
}

/// What is cut short or goes on is refused.
#[test]
fn every_message_has_one_length() {
    fn one_length<T: Message + PartialEq + core::fmt::Debug>(message: &T) {
        let payload = payload(&message.to_wire().unwrap());
        assert_eq!(T::from_payload(&payload).as_ref(), Ok(message));
        for length in 1..payload.len() {
            assert_eq!(T::from_payload(&payload[..length]), Err(MessageError::Content), "{message:?}");
        }
        let longer = [&payload[..], &[0]].concat();
        assert_eq!(T::from_payload(&longer), Err(MessageError::Content));
    }
    requests().into_iter().for_each(|request| one_length(&RequestFrame { token: 0x1234, session: 0x89ab_cdef, request }));
    replies().into_iter().for_each(|reply| one_length(&ReplyFrame { token: 7, reply }));
    one_length(&telemetry());
    one_length(&trace());
}

#[test]
fn every_recorded_frame_reads_back_as_its_message() {
    let mut wires = WIRE.iter().map(|(_, wire)| payload(&unhex(wire)));
    assert_eq!(wires.next().unwrap().as_slice(), [Kind::HelloRequest.byte()]);
    assert_eq!(Hello::decode(&wires.next().unwrap()), Ok(hello()));
    for request in requests() {
        assert_eq!(RequestFrame::from_payload(&wires.next().unwrap()), Ok(RequestFrame { token: 0x1234, session: 0x89ab_cdef, request }));
    }
    for reply in replies() {
        assert_eq!(ReplyFrame::from_payload(&wires.next().unwrap()), Ok(ReplyFrame { token: 7, reply }));
    }
    assert_eq!(Telemetry::from_payload(&wires.next().unwrap()), Ok(telemetry()));
    assert_eq!(TracePiece::from_payload(&wires.next().unwrap()), Ok(trace()));
}

/// An example is missing if a variant is: these matches stop compiling when one is added.
#[test]
fn every_variant_has_an_example() {
    let request_number = |request: &Request| match request {
        Request::Status => 0,
        Request::Arm => 1,
        Request::Disarm => 2,
        Request::Start => 3,
        Request::Stop => 4,
        Request::Vent => 5,
        Request::Acknowledge => 6,
        Request::SetPoint { .. } => 7,
        Request::Playback(_) => 8,
        Request::PlaybackClear => 9,
        Request::SettingGet { .. } => 10,
        Request::SettingSet { .. } => 11,
        Request::SettingsDifference { .. } => 12,
        Request::SettingsSave => 13,
        Request::SettingsRevert(_) => 14,
        Request::ModelBegin { .. } => 15,
        Request::ModelChunk { .. } => 16,
        Request::ModelFinish => 17,
        Request::ModelActivate { .. } => 18,
        Request::Models => 19,
        Request::FaultRecord => 20,
        Request::PreviousFaultRecord => 21,
        Request::ControlReport => 22,
        Request::TraceBegin => 23,
        Request::TraceEnd => 24,
        Request::AdaptationReport => 25,
        Request::History { .. } => 26,
        Request::EnterBootloader => 27,
        Request::RestNoise => 28,
    };
    let mut numbers: std::vec::Vec<_> = requests().iter().map(request_number).collect();
    numbers.dedup();
    assert_eq!(numbers, (0..=28).collect::<std::vec::Vec<_>>());
    let reply_number = |reply: &Reply| match reply {
        Reply::Done => 0,
        Reply::Refused(_) => 1,
        Reply::Status(_) => 2,
        Reply::Playback { .. } => 3,
        Reply::Setting(_) => 4,
        Reply::Differences { .. } => 5,
        Reply::Uploaded(_) => 6,
        Reply::FaultRecord(_) => 7,
        Reply::ControlReport(_) => 8,
        Reply::AdaptationReport(_) => 9,
        Reply::Models { .. } => 10,
        Reply::History(_) => 11,
        Reply::RestNoise(_) => 12,
    };
    let mut numbers: std::vec::Vec<_> = replies().iter().map(reply_number).collect();
    numbers.dedup();
    assert_eq!(numbers, (0..=12).collect::<std::vec::Vec<_>>());
}

#[test]
fn every_reason_that_adaptation_can_give_has_its_number() {
    for (number, adapting) in (0u8..).zip(Adapting::ALL) {
        let report = AdaptationReport { adapting, ..AdaptationReport::default() };
        let payload = payload(&ReplyFrame { token: 7, reply: Reply::AdaptationReport(report) }.to_wire().unwrap());
        assert_eq!(payload[..4], [0x11, 7, 9, number]);
        assert_eq!(ReplyFrame::from_payload(&payload).unwrap().reply, Reply::AdaptationReport(report));
    }
}

#[test]
fn hello_of_a_later_version_is_understood_and_anything_else_is_named() {
    let mut later = hello().encode().to_vec();
    later.extend_from_slice(&[9; 100]);
    later[11] = 0xff; // a later protocol
    later[25] = 200; // a reset cause of tomorrow
    let understood = Hello::decode(&later).unwrap();
    assert_eq!((understood.protocol, understood.reset_cause), (0x00ff, ResetCause::Other(200)));
    assert_eq!(Hello::decode(&later[..41]), Err(HelloError::TooShort));
    // One of protocol 1 ends where its frozen part ends.
    assert_eq!(Hello::decode(&hello().encode()[..42]), Ok(Hello { session: 0, build: Build::default(), ..hello() }));
    // One of protocol 2 ends behind the session.
    assert_eq!(Hello::decode(&hello().encode()[..46]), Ok(Hello { build: Build::default(), ..hello() }));
    assert_eq!(Hello::decode(&[Kind::Telemetry.byte(); 42]), Err(HelloError::NotHello));
    let mut name = hello().encode();
    name[26] = 0xe4;
    assert_eq!(Hello::decode(&name), Err(HelloError::BoardName));
}

#[test]
fn every_flipped_bit_of_every_frame_is_noticed() {
    for frame in encoded() {
        for bit in 0..(frame.len() - 1) * 8 {
            let mut damaged = frame.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            let mut decoder = Decoder::new();
            let sound = damaged.iter().any(|byte| decoder.push(*byte).is_some_and(|outcome| outcome.is_ok()));
            assert!(!sound, "bit {bit} of {}", hex(&frame));
        }
    }
}

#[test]
fn a_frame_is_found_behind_garbage_and_too_long_ones_are_dropped_whole() {
    let mut decoder = Decoder::new();
    let frame = RequestFrame { token: 1, session: 1, request: Request::Vent }.to_wire().unwrap();
    let garbage = [0xa5u8; 2 * MAX_WIRE];
    let outcomes: std::vec::Vec<_> = garbage
        .iter()
        .chain(&[0])
        .chain(&frame)
        .chain(&[0, 0])
        .chain(&frame)
        .filter_map(|byte| decoder.push(*byte).map(|payload| payload.map(<[u8]>::to_vec)))
        .collect();
    assert_eq!(outcomes.len(), 3);
    assert_eq!(outcomes[0], Err(FrameError::TooLong));
    assert!(outcomes[1].is_ok() && outcomes[2].is_ok());
    assert_eq!(encode(&[0; MAX_PAYLOAD + 1]), Err(FrameError::TooLong));
    assert!(encode(&[1; MAX_PAYLOAD]).is_ok());
}

/// Thousands of scripts of a bad line, from fixed seeds; the same body as the fuzz target `link_parser`.
#[test]
fn a_bad_line_breaks_nothing_forges_nothing_and_holds_nothing_up() {
    let mut noise = 0x9e37_79b9_7f4a_7c15u64;
    let mut sum = fuzzing::Account::default();
    for _ in 0..4000 {
        let script: std::vec::Vec<u8> = (0..3 * fuzzing::MAX_STEPS)
            .map(|_| {
                noise ^= noise << 13;
                noise ^= noise >> 7;
                noise ^= noise << 17;
                noise.to_le_bytes()[3]
            })
            .collect();
        let account = fuzzing::carry_out(&script);
        sum.accepted += account.accepted;
        sum.refused += account.refused;
        sum.understood += account.understood;
    }
    // All three happen, and often.
    assert!(sum.accepted > 60_000 && sum.refused > 60_000 && sum.understood > 40_000, "{sum:?}");
}

/// The largest of everything fits a frame.
#[test]
fn the_longest_messages_fit_their_frames() {
    let bytes = Vec::from_slice(&[0xff; MAX_CHUNK_BYTES]).unwrap();
    let values_bar = Vec::from_slice(&[f32::MAX; MAX_CHUNK_POINTS]).unwrap();
    let difference = SettingDifference { number: u16::MAX, in_use: SettingValue::Float(1.0), baseline: SettingValue::Integer(u32::MAX) };
    let entries = Vec::from_slice(&[difference; MAX_PAGE]).unwrap();
    for request in [
        Request::ModelChunk { offset: u32::MAX, bytes },
        Request::Playback(PlaybackChunk { first_index: u32::MAX, last: true, values_bar }),
    ] {
        RequestFrame { token: u32::MAX, session: u32::MAX, request }.to_wire().unwrap();
    }
    ReplyFrame { token: u32::MAX, reply: Reply::Differences { entries, next_number: u16::MAX } }.to_wire().unwrap();
    TracePiece { offset: u32::MAX, bytes: Vec::from_slice(&[0xff; MAX_PIECE_BYTES]).unwrap() }.to_wire().unwrap();
    let bytes = Vec::from_slice(&[0xff; MAX_PIECE_ROWS * ROW_BYTES]).unwrap();
    ReplyFrame { token: u32::MAX, reply: Reply::History(HistoryPiece { rows: u16::MAX, bytes }) }.to_wire().unwrap();
}

fn any_request() -> impl Strategy<Value = Request> {
    let examples = requests();
    (0..examples.len()).prop_map(move |index| examples[index].clone())
}

proptest! {
    /// The same body as the fuzz target `link_parser`.
    #[test]
    fn no_bytes_break_the_parser(bytes in prop::collection::vec(prop_oneof![3 => any::<u8>(), 1 => Just(0u8)], 0..2000)) {
        model_export::link::parse_anything(&bytes);
    }

    /// Random bytes seldom pass a CRC, so payloads are attacked behind it as well.
    #[test]
    fn no_payload_breaks_the_message_decoders(body in prop::collection::vec(any::<u8>(), 0..MAX_PAYLOAD - 1), kind in any::<u8>()) {
        for kind in [kind, 0x01, 0x02, 0x10, 0x11, 0x12] {
            let mut payload = vec![kind];
            payload.extend_from_slice(&body);
            model_export::link::parse_anything(&encode(&payload).unwrap());
        }
    }

    #[test]
    fn frames_survive_any_payload_and_any_chopping(payloads in prop::collection::vec(prop::collection::vec(any::<u8>(), 1..=MAX_PAYLOAD), 1..5)) {
        let mut decoder = Decoder::new();
        let mut received = std::vec::Vec::new();
        for payload in &payloads {
            let wire = encode(payload).unwrap();
            prop_assert!(wire.len() <= MAX_WIRE && !wire[..wire.len() - 1].contains(&0));
            received.extend(wire.iter().filter_map(|byte| decoder.push(*byte).map(|outcome| outcome.unwrap().to_vec())));
        }
        prop_assert_eq!(received, payloads);
    }

    /// Any bytes are a message, or none, for the crate `postcard` as for the reader here.
    #[test]
    fn any_bytes_are_a_message_or_not_as_others_see_it(
        mut body in prop::collection::vec(prop_oneof![3 => 0u8..24, 1 => any::<u8>()], 0..40),
        numbers in prop::collection::vec(any::<u64>(), 0..4),
    ) {
        fn agree<T: Message + PartialEq + core::fmt::Debug + for<'a> serde::Deserialize<'a>>(body: &[u8]) {
            let mine = T::from_payload(&[&[T::KIND.byte()], body].concat()).ok();
            let other = postcard::take_from_bytes::<T>(body).ok().filter(|(_, rest)| rest.is_empty()).map(|(message, _)| message);
            // By their text, since a number that is none equals nothing.
            assert_eq!(format!("{mine:?}"), format!("{other:?}"), "{body:?}");
        }
        for number in numbers {
            body.extend(postcard::to_stdvec(&number).unwrap());
        }
        agree::<RequestFrame>(&body);
        agree::<ReplyFrame>(&body);
        agree::<Telemetry>(&body);
        agree::<TracePiece>(&body);
    }

    #[test]
    fn requests_survive_the_wire(request in any_request(), token in any::<u32>(), session in any::<u32>()) {
        let frame = RequestFrame { token, session, request };
        prop_assert_eq!(RequestFrame::from_payload(&payload(&frame.to_wire().unwrap())), Ok(frame));
    }
}
