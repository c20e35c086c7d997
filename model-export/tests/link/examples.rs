//! One example of everything that can be said, and the bytes of each: made by an independent encoder from the format's description.

use heapless::Vec;
use model_export::link::adaptation::{AdaptationReport, Adapting};
use model_export::link::fault::{Blocker, Fault, Notice};
use model_export::link::hello::{Build, Hello};
use model_export::link::history::HistoryPiece;
use model_export::link::message::*;
use model_export::link::settings::{SettingError, SettingValue};
use model_export::link::state::{ResetCause, State};
use model_export::link::trace::TracePiece;

/// Name and frame of one example of everything that can be said.
#[rustfmt::skip]
pub const WIRE: &[(&str, &str)] = &[
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

pub fn hello() -> Hello {
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

pub fn requests() -> std::vec::Vec<Request> {
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

pub fn replies() -> std::vec::Vec<Reply> {
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

pub fn telemetry() -> Telemetry {
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

pub fn trace() -> TracePiece {
    TracePiece { offset: 70_000, bytes: Vec::from_slice(&[0, 1, 0, 255, 128]).unwrap() }
}
