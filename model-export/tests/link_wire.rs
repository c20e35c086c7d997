//! The bytes on the wire. They were made by an independent encoder from the format's description, not by the code under test, so that
//! neither a new library version nor a moved field can change them unnoticed.

use heapless::Vec;
use model_export::blob::crc32;
use model_export::link::adaptation::{AdaptationReport, Adapting};
use model_export::link::fault::{AdaptationCondition, Blocker, Fault, Notice, explain};
use model_export::link::frame::{Decoder, FrameError, MAX_PAYLOAD, MAX_WIRE, encode};
use model_export::link::hello::{Build, Hello, HelloError};
use model_export::link::history::{HistoryPiece, MAX_PIECE_ROWS, ROW_BYTES};
use model_export::link::message::*;
use model_export::link::settings::{INFO, SettingError, SettingValue, Settings, by_name};
use model_export::link::state::{ResetCause, State};
use model_export::link::trace::{MAX_PIECE_BYTES, TracePiece};
use model_export::link::{Kind, SCHEMA_HASH, abuse};
use proptest::prelude::*;

/// Name and frame of one example of everything that can be said.
#[rustfmt::skip]
const WIRE: &[(&str, &str)] = &[
    ("hello request", "06011bdf05a500"),
    ("hello answer", "070243415448010202020302011befbeadde01020304050607080473746d3332663430352d726967010106fecaad0ba10ba3a4a5a6a7a813640710100102030405060708090a0b9c955d8300"),
    ("request Status", "0910b424ef9bafcd080513aae52600"),
    ("request Arm", "0e10b424ef9bafcd0801859ae25100"),
    ("request Disarm", "0e10b424ef9bafcd08023fcbebc800"),
    ("request Start", "0e10b424ef9bafcd0803a9fbecbf00"),
    ("request Stop", "0e10b424ef9bafcd08040a6e882100"),
    ("request Vent", "0e10b424ef9bafcd08059c5e8f5600"),
    ("request Acknowledge", "0e10b424ef9bafcd0806260f86cf00"),
    ("request SetPoint pressure", "0a10b424ef9bafcd0807010107c03f8ab8dacf00"),
    ("request SetPoint displacement", "0b10b424ef9bafcd080701010710c0a8bb805e00"),
    ("request Playback", "0e10b424ef9bafcd0808ac0201030101010101010a3f52b83e4049c31d2600"),
    ("request PlaybackClear", "0e10b424ef9bafcd0809b712395f00"),
    ("request SettingGet", "0f10b424ef9bafcd080a3d62ef1df400"),
    ("request SettingSet float", "0b10b424ef9bafcd080b010101072040943f75f900"),
    ("request SettingSet integer", "1210b424ef9bafcd080b0501fa013aef9b9e00"),
    ("request SettingSet flag", "0c10b424ef9bafcd080b1102054daa7a9d00"),
    ("request SettingsDifference", "1010b424ef9bafcd080c0128a15f813300"),
    ("request SettingsSave", "0e10b424ef9bafcd080daed6545800"),
    ("request SettingsRevert", "0a10b424ef9bafcd080e05776619c800"),
    ("request ModelBegin", "1610b424ef9bafcd080ff0a204effdb6f50d4d1b931f00"),
    ("request ModelChunk", "0d10b424ef9bafcd0810800405020107ff80285e9ce100"),
    ("request ModelFinish", "0e10b424ef9bafcd0811e18a554c00"),
    ("request ModelActivate", "0d10b424ef9bafcd081201020309050607ff30c9427200"),
    ("request Models", "0e10b424ef9bafcd0813cdeb5ba200"),
    ("request FaultRecord", "0e10b424ef9bafcd08146e7e3f3c00"),
    ("request PreviousFaultRecord", "0e10b424ef9bafcd0815f84e384b00"),
    ("request ControlReport", "0e10b424ef9bafcd0816421f31d200"),
    ("request TraceBegin", "0e10b424ef9bafcd0817d42f36a500"),
    ("request TraceEnd", "0e10b424ef9bafcd08184532893500"),
    ("request AdaptationReport", "0e10b424ef9bafcd0819d3028e4200"),
    ("request History", "1010b424ef9bafcd081abc0ffde54bdf00"),
    ("request EnterBootloader", "0e10b424ef9bafcd081bff6380ac00"),
    ("request RestNoise", "0e10b424ef9bafcd081c5cf6e43200"),
    ("reply Done", "031107059286e4ad00"),
    ("reply Refused Blocked", "04110701064803d2b07f00"),
    ("reply Refused State", "0a1107010104f9eec11900"),
    ("reply Refused NotUnderstood", "09110701020ea9bb3b00"),
    ("reply Refused Busy", "09110701039899bc4c00"),
    ("reply Refused Setting", "0a110701040289bfd58d00"),
    ("reply Refused SettingsInconsistent", "0a110701050afa06159a00"),
    ("reply Refused WrongQuantity", "0911070106176dd63c00"),
    ("reply Refused NotFinite", "0911070107815dd14b00"),
    ("reply Refused PlaybackIndex", "0a110701084039d0b2b900"),
    ("reply Refused PlaybackFull", "0a110701090cc3ecc3df00"),
    ("reply Refused NoUpload", "091107010a3c21603500"),
    ("reply Refused UploadOffset", "0b1107010b80026edd0caa00"),
    ("reply Refused TooLong", "0c1107010c8080084de51be200"),
    ("reply Refused Checksum", "091107010d9fb404ab00"),
    ("reply Refused PieceLength", "091107010e25e50d3200"),
    ("reply Refused NotAModel", "091107010fb3d50a4500"),
    ("reply Refused NoOtherModel", "091107011046d802c800"),
    ("reply Refused Storage", "0911070111d0e805bf00"),
    ("reply Refused NoRecord", "09110701126ab90c2600"),
    ("reply Refused LogFull", "0911070113fc890b5100"),
    ("reply Refused Traced", "09110701145f1c6fcf00"),
    ("reply Refused Uncertified", "0a11070115053a09684000"),
    ("reply Refused ModelTooSlow", "0911070116737d612100"),
    ("reply Refused OtherSession", "0911070117e54d665600"),
    ("reply Refused ModelInputs", "09110701187450d9c600"),
    ("reply Status", "231107020311808008020894b4e4f4cb0305c8dc038010010904018005c801e3f70dd400"),
    ("reply Playback", "0b11070360a0013c440a4800"),
    ("reply Setting", "041107040101074040d19ca00d00"),
    ("reply Differences", "06110705020101010320400101054040110203020105f0f3d88e00"),
    ("reply Uploaded", "0a11070680065a3018d000"),
    ("reply FaultRecord", "17110707101f8080848008cd830604c08db701ff1ff40a0103c03f0103e8400103f0400108c03f026697992900"),
    ("reply ControlReport", "0b110708a09c01ac02280c0103803e0103e8400101063e968c5a0600"),
    ("reply AdaptationReport", "0511070902010380be010a903ff0a204681bd6d600"),
    ("reply Models", "0c11070a010203040506070801010101010101057fcc8e5e00"),
    ("reply History", "0711070bd00f180c0102030405060708090a0b010101010101010101010105275fa38a00"),
    ("reply RestNoise", "0411070c0107c03f0ad7a33b010b10406f12033bfbbae11700"),
    ("telemetry", "0912e807a09c0103040a08a01fb8178eda96010103a03f0108c03f019a99993f02010104d0404d0bc8dc03801001333353400553cb8dc000"),
    ("trace", "0613f0a20405020107ff8061dd2f3300"),
];

fn hello() -> Hello {
    Hello {
        firmware: [1, 2, 3],
        protocol: 1,
        schema_hash: 0xdead_beef,
        model_id: [1, 2, 3, 4, 5, 6, 7, 8],
        reset_cause: ResetCause::Watchdog,
        board: heapless::String::try_from("stm32f405-rig").unwrap(),
        session: 0x0bad_cafe,
        build: Build {
            source: [0xa1, 0, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7, 0xa8],
            chip: 0x1007_6413,
            chip_number: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
        },
    }
}

fn requests() -> std::vec::Vec<Request> {
    let values_bar = Vec::from_slice(&[0.0, 0.5, 2.98]).unwrap();
    let bytes = Vec::from_slice(&[0, 1, 0, 255, 128]).unwrap();
    vec![
        Request::Status,
        Request::Arm,
        Request::Disarm,
        Request::Start,
        Request::Stop,
        Request::Vent,
        Request::Acknowledge,
        Request::SetPoint { quantity: Quantity::Pressure, value: 1.5 },
        Request::SetPoint { quantity: Quantity::Displacement, value: -2.25 },
        Request::Playback(PlaybackChunk { first_index: 300, last: true, values_bar }),
        Request::PlaybackClear,
        Request::SettingGet { number: 61 },
        Request::SettingSet { number: 1, value: SettingValue::Float(2.5) },
        Request::SettingSet { number: 5, value: SettingValue::Integer(250) },
        Request::SettingSet { number: 17, value: SettingValue::Flag(false) },
        Request::SettingsDifference { baseline: Baseline::Defaults, from_number: 40 },
        Request::SettingsSave,
        Request::SettingsRevert(Baseline::Saved),
        Request::ModelBegin { length: 70_000, crc32: 0xdead_beef },
        Request::ModelChunk { offset: 512, bytes },
        Request::ModelFinish,
        Request::ModelActivate { id: [1, 2, 3, 0, 5, 6, 7, 0xff] },
        Request::Models,
        Request::FaultRecord,
        Request::PreviousFaultRecord,
        Request::ControlReport,
        Request::TraceBegin,
        Request::TraceEnd,
        Request::AdaptationReport,
        Request::History { from_row: 1980 },
        Request::EnterBootloader,
        Request::RestNoise,
    ]
}

fn replies() -> std::vec::Vec<Reply> {
    let refusals = [
        Refusal::Blocked([Blocker::EmergencyStopPressed, Blocker::VentNotVerified].into_iter().collect()),
        Refusal::State(State::Running),
        Refusal::NotUnderstood,
        Refusal::Busy,
        Refusal::Setting(SettingError::OutOfBounds),
        Refusal::SettingsInconsistent(10),
        Refusal::WrongQuantity,
        Refusal::NotFinite,
        Refusal::PlaybackIndex(64),
        Refusal::PlaybackFull(12),
        Refusal::NoUpload,
        Refusal::UploadOffset(256),
        Refusal::TooLong(131_072),
        Refusal::Checksum,
        Refusal::PieceLength,
        Refusal::NotAModel,
        Refusal::NoOtherModel,
        Refusal::Storage,
        Refusal::NoRecord,
        Refusal::LogFull,
        Refusal::Traced,
        Refusal::Uncertified(5),
        Refusal::ModelTooSlow,
        Refusal::OtherSession,
        Refusal::ModelInputs,
    ];
    let status = Status {
        state: State::Armed,
        first_fault: 17,
        faults: [Fault::LaserStuck].into_iter().collect(),
        blockers: [Blocker::WrongState].into_iter().collect(),
        notices: [Notice::Slew].into_iter().collect(),
        time_ms: 123_456_789_012,
        late_ticks: 5,
        longest_tick_cycles: 61_000,
        stack_unused_bytes: 2_048,
        damaged_frames: 1,
        telemetry_dropped: 9,
        reset_cause: ResetCause::Watchdog,
        settings_unsaved: true,
        playback_next_index: 640,
        playback_free: 200,
    };
    let entries = [
        SettingDifference { number: 1, in_use: SettingValue::Float(2.5), baseline: SettingValue::Float(3.0) },
        SettingDifference { number: 17, in_use: SettingValue::Flag(false), baseline: SettingValue::Flag(true) },
    ];
    let record = FaultRecord {
        first: 16,
        second: 31,
        all: [Fault::LaserRange, Fault::VentNotVerified].into_iter().collect(),
        time_ms: 98_765,
        state: State::Running,
        output_ubar: 1_500_000,
        pressure_code: 4_095,
        laser_code: 1_396,
        pressure_bar: 1.5,
        displacement_mm: 7.25,
        estimate_mm: 7.5,
        set_point: 1.5,
        late_ticks: 2,
    };
    let mut replies = vec![Reply::Done];
    replies.extend(refusals.map(Reply::Refused));
    replies.extend([
        Reply::Status(status),
        Reply::Playback { next_index: 96, free: 160 },
        Reply::Setting(SettingValue::Float(3.0)),
        Reply::Differences { entries: Vec::from_slice(&entries).unwrap(), next_number: 0 },
        Reply::Uploaded(768),
        Reply::FaultRecord(record),
        Reply::ControlReport(ControlReport {
            ticks: 20_000,
            limited_ticks: 300,
            outside_domain_ticks: 40,
            fallback_ticks: 12,
            correction_mm: 0.25,
            blend_mm: 7.25,
            bound_mm: 0.125,
        }),
        Reply::AdaptationReport(AdaptationReport { adapting: Adapting::ZeroOnly, zero_mm: -0.25, gain: 1.125, updates: 70_000 }),
        Reply::Models { active: [1, 2, 3, 4, 5, 6, 7, 8], other: [0; 8] },
        Reply::History(HistoryPiece { rows: 2000, bytes: (0..12).chain([0; 12]).collect() }),
        Reply::RestNoise(RestNoise { laser_codes: 1.5, laser_mm: 0.005, pressure_codes: 2.25, pressure_bar: 0.002 }),
    ]);
    replies
}

fn telemetry() -> Telemetry {
    Telemetry {
        sequence: 1_000,
        time_ms: 20_000,
        dropped: 3,
        state: State::Running,
        first_fault: 0,
        notices: [Notice::Slew].into_iter().collect(),
        laser_code: 4_000,
        pressure_code: 3_000,
        output_ubar: 1_234_567,
        command_bar: 1.25,
        set_point: 1.5,
        pressure_bar: Some(1.2),
        displacement_mm: None,
        estimate_mm: Some(6.5),
        playback_index: 77,
        late_ticks: 0,
        longest_tick_cycles: 61_000,
        stack_unused_bytes: 2_048,
        supply_v: Some(3.3),
        chip_celsius: None,
    }
}

fn trace() -> TracePiece {
    TracePiece { offset: 70_000, bytes: Vec::from_slice(&[0, 1, 0, 255, 128]).unwrap() }
}

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
    let mut sum = abuse::Account::default();
    for _ in 0..4000 {
        let script: std::vec::Vec<u8> = (0..3 * abuse::MAX_STEPS)
            .map(|_| {
                noise ^= noise << 13;
                noise ^= noise >> 7;
                noise ^= noise << 17;
                noise.to_le_bytes()[3]
            })
            .collect();
        let account = abuse::carry_out(&script);
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

#[test]
fn settings_have_unique_numbers_names_that_end_in_their_unit_and_defaults_within_bounds() {
    let mut settings = Settings::default();
    for (index, info) in INFO.iter().enumerate() {
        for other in &INFO[..index] {
            assert!(other.number < info.number && other.name != info.name, "{} {}", other.name, info.name);
        }
        assert_eq!(by_name(info.name), Some(info));
        assert_eq!(settings.get(info.number), Some(info.default), "{}", info.name);
        for value in [info.default, info.minimum, info.maximum] {
            assert_eq!(settings.set(info.number, value), Ok(()), "{} {value:?}", info.name);
        }
        settings.set(info.number, info.default).unwrap();
        let unit = info.unit.replace("1/", "per_").replace('/', "_per_").to_lowercase();
        assert!(unit.is_empty() || info.name.ends_with(&format!("_{unit}")), "{} in {}", info.name, info.unit);
        let wrong_type = if info.default == SettingValue::Flag(true) { SettingValue::Integer(1) } else { SettingValue::Flag(true) };
        if !matches!(info.default, SettingValue::Flag(_)) {
            assert_eq!(settings.set(info.number, wrong_type), Err(SettingError::WrongType), "{}", info.name);
        }
        if let (SettingValue::Float(low), SettingValue::Float(high)) = (info.minimum, info.maximum) {
            for value in [low.next_down(), high.next_up(), f32::NAN, f32::INFINITY] {
                assert_eq!(settings.set(info.number, SettingValue::Float(value)), Err(SettingError::OutOfBounds), "{}", info.name);
            }
        }
    }
    assert_eq!(settings, Settings::default());
    assert_eq!(settings.set(60_000, SettingValue::Flag(true)), Err(SettingError::Unknown));
}

#[test]
fn differences_name_both_values() {
    let changed = Settings { ceiling_bar: 2.0, laser_required: false, ..Settings::default() };
    let differences: std::vec::Vec<_> = changed.differences(&Settings::default()).collect();
    assert_eq!(
        differences,
        [(1, SettingValue::Float(2.0), SettingValue::Float(3.0)), (17, SettingValue::Flag(false), SettingValue::Flag(true)),]
    );
}

#[test]
fn everything_with_a_number_is_explained() {
    assert_eq!(explain("E017").unwrap().name, "laser-stuck");
    assert_eq!(explain("e17"), explain("E017"));
    assert_eq!(explain("B03").unwrap().name, "emergency-stop-pressed");
    assert_eq!(explain("N2").unwrap().name, "floor");
    assert_eq!(explain("C05").unwrap().name, "loop-margin");
    for nonsense in ["", "E", "17", "E999", "E000", "X01", "E-1", "Ä1"] {
        assert_eq!(explain(nonsense), None, "{nonsense}");
    }
    let all = Fault::ALL.iter().map(|fault| fault.explanation());
    let all = all.chain(AdaptationCondition::ALL.iter().map(|condition| condition.explanation()));
    let all = all.chain(Blocker::ALL.iter().map(|blocker| blocker.explanation()));
    for explanation in all.chain(Notice::ALL.iter().map(|notice| notice.explanation())) {
        assert!(explanation.meaning.ends_with('.') && explanation.remedy.ends_with('.'), "{explanation:?}");
        assert!(explanation.name.chars().all(|character| character.is_ascii_lowercase() || character == '-'), "{explanation:?}");
    }
}

/// Every setting that a text names exists.
#[test]
fn explanations_name_settings_that_exist() {
    let mut named = 0;
    for fault in Fault::ALL {
        let remedy = fault.explanation().remedy;
        for word in remedy.split([' ', ',', ';', '.']).filter(|word| word.contains('_')) {
            assert!(INFO.iter().any(|info| info.name.ends_with(&format!(".{word}"))), "{word} in {remedy}");
            named += 1;
        }
    }
    assert!(named >= 8);
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
