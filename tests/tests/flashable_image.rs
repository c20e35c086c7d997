//! The flashable image, byte for byte, in the emulator: a chip whose HSE never starts.
//!
//! The emulated chip has no clock control, so the HSE never reports ready; no converter that a timer triggers, so every tick is one that
//! the guard started without a sample; and no flash that could be written. The image must come up all the same, say what is wrong, and
//! stay vented. `cargo xtask test` builds the image and runs this; by hand, `FLASHABLE_IMAGE` names it.

use std::path::PathBuf;

use model_export::link::fault::{Blocker, Fault};
use model_export::link::message::{Message, Refusal, Reply, Request, Telemetry};
use model_export::link::settings::SettingValue;
use model_export::link::state::{ResetCause, State};
use model_export::link::{PROTOCOL, SCHEMA_HASH};
use rig_tests::flashable::Emulator;

/// How often the certificate that takes most of the stack is asked for.
const CERTIFICATES: usize = 30;

fn image() -> PathBuf {
    std::env::var_os("FLASHABLE_IMAGE").expect("FLASHABLE_IMAGE names the image; `cargo xtask test` sets it").into()
}

#[test]
#[ignore = "needs the emulator and the image: `cargo xtask test`"]
fn the_image_finds_no_hse_says_so_and_refuses_to_arm() {
    let mut device = Emulator::start(&image());

    device.hello();
    // Noise on the line between two words.
    device.send(&[0xff, 0x00, 0x13, 0x37, 0x00]);
    let hello = device.hello();
    assert_eq!((hello.board.as_str(), hello.protocol, hello.schema_hash), ("custom-f405", PROTOCOL, SCHEMA_HASH));
    assert_eq!((hello.model_id, hello.reset_cause), ([0; 8], ResetCause::Unknown));

    let status = device.status();
    assert_eq!(status.state, State::Fault);
    assert_eq!(status.first_fault, Fault::ClockFailed.number());
    assert!(!status.faults.contains(Fault::FlashCorrupt), "the seal is right: {:?}", status.faults);
    assert!(status.damaged_frames >= 1);

    let sample = device.wait_for("telemetry", |payload| Telemetry::from_payload(payload).ok());
    assert_eq!((sample.state, sample.output_ubar, sample.first_fault), (State::Fault, 0, Fault::ClockFailed.number()));
    assert_eq!((sample.laser_code, sample.pressure_code), (u16::MAX, u16::MAX), "there is no converter");

    let Reply::Refused(Refusal::Blocked(blockers)) = device.ask(Request::Arm) else { panic!("armed") };
    for blocker in [Blocker::WrongState, Blocker::FaultLatched, Blocker::LaserNotPlausible, Blocker::PressureNotPlausible] {
        assert!(blockers.contains(blocker), "{blocker:?} in {blockers:?}");
    }
    assert!(matches!(device.ask(Request::Acknowledge), Reply::Refused(Refusal::Blocked(_))));
    assert!(matches!(device.ask(Request::FaultRecord), Reply::FaultRecord(record) if record.first == Fault::ClockFailed.number()));
    assert_eq!(device.ask(Request::PreviousFaultRecord), Reply::Refused(Refusal::NoRecord));

    // The certificate of adaptation for a feedback loop, which takes more of the stack than any other setting.
    let loops = [(60, 2), (62, 3), (63, 3)].map(|(number, value)| (number, SettingValue::Integer(value)));
    let gains = [(101, SettingValue::Float(2.0)), (120, SettingValue::Flag(true))];
    for (number, value) in loops.into_iter().chain(gains) {
        assert_eq!(device.ask(Request::SettingSet { number, value }), Reply::Done, "setting {number}");
    }
    let too_fast = || Request::SettingSet { number: 101, value: SettingValue::Float(100.0) };
    // Often enough that a tick interrupts it where it is deepest.
    for _ in 0..CERTIFICATES {
        assert_eq!(device.ask(too_fast()), Reply::Refused(Refusal::Uncertified(4)));
    }
    // Settings work; flash is not written while nobody can say that the pressure is gone.
    assert_eq!(device.ask(Request::SettingSet { number: 1, value: SettingValue::Float(2.5) }), Reply::Done);
    assert_eq!(device.ask(Request::SettingGet { number: 1 }), Reply::Setting(SettingValue::Float(2.5)));
    let not_vented = Refusal::Blocked([Blocker::VentNotVerified].into_iter().collect());
    assert_eq!(device.ask(Request::SettingsSave), Reply::Refused(not_vented));
    assert_eq!(device.ask(Request::Vent), Reply::Done);

    let status = device.status();
    assert!(!status.faults.contains(Fault::StorageFailed) && status.settings_unsaved);
    assert_eq!((status.state, status.first_fault), (State::Fault, Fault::ClockFailed.number()));
    eprintln!("stack never used: {} bytes", status.stack_unused_bytes);
    // 10,136 of 16,384 bytes, in every run. A model's check, under a tick with a model, is measured on the board's model:
    // `an_upload_and_its_check_leave_a_quarter_of_the_stack`.
    assert!(status.stack_unused_bytes >= 9 * 1024 + 512, "{} bytes of stack left", status.stack_unused_bytes);
}

#[test]
#[ignore = "needs the emulator and the image: `cargo xtask test`"]
fn an_image_with_one_flipped_bit_knows_it() {
    let mut bytes = std::fs::read(image()).unwrap();
    // A letter of its name, which the answer shows and nothing else depends on.
    let place = bytes.windows(11).position(|window| window == b"custom-f405").expect("the board's name is in the image");
    bytes[place] ^= 1;
    let folder = tempfile::tempdir().unwrap();
    let damaged = folder.path().join("damaged");
    std::fs::write(&damaged, bytes).unwrap();
    let mut device = Emulator::start(&damaged);
    assert_eq!(device.hello().board.as_str(), "bustom-f405");
    let status = device.status();
    assert_eq!((status.state, status.first_fault), (State::Fault, Fault::FlashCorrupt.number()));
}
