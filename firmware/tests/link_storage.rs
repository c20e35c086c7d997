//! What a host keeps in the device over the line: settings and models, and when flash may be written.

mod common;
mod session;

use common::set_point_settings;
use firmware::link::Event;
use firmware::settings;
use firmware::storage::Store;
use firmware::supervisor::Vent;
use firmware::tick::Action;
use model_export::blob::crc32;
use model_export::link::fault::{Blocker, Fault};
use model_export::link::message::*;
use model_export::link::settings::{SettingError, SettingValue, Settings, by_name};
use model_export::link::state::State;
use session::{Ram, Session, number};

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
