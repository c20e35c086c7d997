//! The client against the rig in this process: what a host may rely on.

use std::time::Duration;

use firmware::device::exchange::InjectedFault;
use model_export::link::fault::Fault;
use model_export::link::frame;
use model_export::link::hello::Hello;
use model_export::link::message::{Quantity, Reply, Request, Status};
use model_export::link::settings::{SettingValue, by_name};
use model_export::link::state::{ResetCause, State};
use model_export::link::{PROTOCOL, SCHEMA_HASH};

use super::*;
use simulation::plant::{Plant, PlantConfig};

type VirtualRig = Client<Lockstep<InProcess>>;

fn rig() -> VirtualRig {
    let plant = Plant::new(PlantConfig::default()).unwrap();
    let hardware = Hardware::new(HardwareConfig::default(), Box::new(plant.start(0.0)));
    let processor = InProcess::new(FlashMemory::default());
    Client::connect(Lockstep::new(processor, hardware, (), "the rig in this process", "virtual").unwrap()).unwrap()
}

fn status(rig: &mut VirtualRig) -> Status {
    match rig.request(&Request::Status).unwrap() {
        Reply::Status(status) => status,
        other => panic!("{other:?}"),
    }
}

fn until(rig: &mut VirtualRig, state: State) {
    for _ in 0..200 {
        if status(rig).state == state {
            return;
        }
        rig.listen(Duration::from_millis(50)).unwrap();
    }
    panic!("never {state:?}: {:?}", status(rig));
}

/// Running on pressure set-points, 1.5 bar in the muscle.
fn running() -> VirtualRig {
    let mut rig = rig();
    until(&mut rig, State::Idle);
    let law = by_name("control.law").unwrap().number;
    rig.command(&Request::SettingSet { number: law, value: SettingValue::Integer(1) }).unwrap();
    // New settings make the sensors prove themselves again.
    rig.transport().advance_for(200).unwrap();
    rig.command(&Request::Arm).unwrap();
    rig.command(&Request::Start).unwrap();
    for _ in 0..100 {
        rig.send(&Request::SetPoint { quantity: Quantity::Pressure, value: 1.5 }).unwrap();
        rig.transport().advance_for(10).unwrap();
    }
    assert_eq!(status(&mut rig).state, State::Running);
    assert!((rig.transport().hardware().pressure_bar() - 1.5).abs() < 0.01);
    rig
}

#[test]
fn the_client_runs_a_rig_without_knowing_that_it_is_simulated() {
    let mut rig = rig();
    assert_eq!((rig.hello().protocol, rig.hello().board.as_str()), (PROTOCOL, "virtual"));
    assert_eq!(rig.hello().firmware, FIRMWARE);
    until(&mut rig, State::Idle);
    let mut rig = running();
    rig.begin_account();
    rig.command(&Request::Vent).unwrap();
    rig.transport().advance_for(300).unwrap();
    assert!(rig.transport().hardware().pressure_bar() < 0.1);
    assert_eq!(status(&mut rig).state, State::Idle);
    let account = rig.account().clone();
    assert!(account.received >= 15 && account.gaps.is_empty(), "{account:?}");
}

#[test]
fn a_lost_host_vents_the_rig() {
    let mut rig = running();
    rig.transport().advance_for(252).unwrap();
    assert!(!rig.transport().hardware().is_energised());
    assert_eq!(status(&mut rig).first_fault, Fault::HostLost.number());
}

#[test]
fn a_processor_that_crashes_or_hangs_is_reset_with_the_pins_released_and_says_why() {
    for (injected, within_ms, cause, fault) in [
        (InjectedFault::Hang, 40, ResetCause::Watchdog, Fault::WatchdogReset),
        (InjectedFault::StackOverflow, 1, ResetCause::Software, Fault::HardFault),
        (InjectedFault::Panic, 1, ResetCause::Software, Fault::Panicked),
    ] {
        let mut rig = running();
        rig.transport().injected(injected);
        rig.transport().advance_for(within_ms).unwrap();
        assert!(!rig.transport().hardware().is_energised(), "{injected:?}");
        assert_eq!(rig.transport().resets(), 1);
        rig.transport().advance_for(300).unwrap();
        let status = status(&mut rig);
        assert_eq!((status.state, status.first_fault, status.reset_cause), (State::Fault, fault.number(), cause), "{injected:?}");
    }
}

#[test]
fn the_last_seconds_before_a_fault_or_a_crash_are_fetched_afterwards_and_written_as_a_recording() {
    use crate::history;

    let folder = tempfile::tempdir().unwrap();
    for injected in [InjectedFault::None, InjectedFault::Hang, InjectedFault::StackOverflow, InjectedFault::Panic] {
        let mut rig = running();
        assert_eq!(history::fetch(&mut rig).unwrap(), None, "it records");
        if injected != InjectedFault::None {
            rig.transport().injected(injected);
        }
        // By itself the rig notices that its host is silent.
        rig.transport().advance_for(600).unwrap();
        rig.greet_again().unwrap();
        assert_eq!(status(&mut rig).state, State::Fault);
        let rows = history::fetch(&mut rig).unwrap().expect("rows");
        // From the start of the run on: a second of it, and what it took to get there.
        assert!((1000..2000).contains(&rows.len()), "{} rows", rows.len());
        assert!(rows.iter().enumerate().all(|(index, row)| usize::from(row.0) == index), "a row is torn");
        let last = rows[rows.len() - 1].1;
        assert_eq!(last.energised, injected != InjectedFault::None, "{injected:?}");
        assert_eq!(last.state, if injected == InjectedFault::None { State::Fault } else { State::Running }, "{injected:?}");

        let mut settings = history::settings_in_use(&mut rig).unwrap();
        settings.control_law = 1;
        let written = history::in_units(&rows, &settings).unwrap();
        let row = &written[written.len() - 100];
        assert!((row.pressure_measured_bar - 1.5).abs() < 0.05 && (row.pressure_bar - 1.5).abs() < 0.01, "{row:?}");
        assert_eq!(row.set_point, Some(1.5));
        let path = folder.path().join("dump.csv");
        history::write(&path, &written).unwrap();
        assert_eq!(history::read(&path).unwrap().as_ref(), Some(&written));
        // Any recording's reader takes it as well.
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("time_s,pressure_bar,displacement_mm,pressure_measured_bar,"), "{}", &text[..80]);
        let events = history::events(&written);
        assert!(events.iter().any(|event| event.contains("`running` after `armed`")), "{events:?}");
        assert_eq!(history::ends_in_a_fault(&written), injected == InjectedFault::None);

        // A new run is a new recording.
        rig.command(&Request::Acknowledge).unwrap();
        until(&mut rig, State::Idle);
        rig.command(&Request::Arm).unwrap();
        assert_eq!(history::fetch(&mut rig).unwrap(), None);
    }
}

#[test]
fn a_rig_without_a_bootloader_says_so() {
    let mut rig = rig();
    until(&mut rig, State::Idle);
    assert!(matches!(rig.command(&Request::EnterBootloader), Err(LinkError::Refused(_))));
}

/// A transport that plays what a test tells it.
struct Scripted {
    answers: Vec<u8>,
    now: Duration,
}

impl Transport for Scripted {
    fn send(&mut self, _bytes: &[u8]) -> Result<(), LinkError> {
        Ok(())
    }

    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        self.now += limit;
        into.append(&mut self.answers);
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        self.now
    }

    fn place(&self) -> &str {
        "test"
    }
}

fn meets(answers: Vec<u8>) -> Result<(), LinkError> {
    Client::connect(Scripted { answers, now: Duration::ZERO }).map(|_| ())
}

fn hello(protocol: u16, schema_hash: u32) -> Vec<u8> {
    let hello = Hello {
        firmware: [9, 8, 7],
        protocol,
        schema_hash,
        model_id: [0; 8],
        reset_cause: ResetCause::PowerOn,
        board: heapless::String::try_from("other").unwrap(),
        session: 5,
        build: model_export::link::hello::Build::default(),
    };
    frame::encode(&hello.encode()).unwrap().to_vec()
}

#[test]
fn whoever_does_not_speak_our_language_is_named() {
    assert!(matches!(meets(hello(PROTOCOL, SCHEMA_HASH)), Ok(())));
    assert!(matches!(meets(hello(PROTOCOL - 1, SCHEMA_HASH)), Err(LinkError::OldFirmware { theirs, .. }) if theirs == PROTOCOL - 1));
    assert!(matches!(meets(hello(PROTOCOL + 1, 5)), Err(LinkError::NewFirmware { .. })));
    assert!(matches!(meets(hello(PROTOCOL, SCHEMA_HASH ^ 1)), Err(LinkError::OtherSchema { .. })));
    assert!(matches!(meets(Vec::new()), Err(LinkError::NoAnswer { .. })));
    assert!(matches!(meets(b"login: \x00 \x00\x00 password".to_vec()), Err(LinkError::Garbage { bytes: 20, .. })));
    let mut noisy = b"\xff\x13\x00boot".to_vec();
    noisy.push(0);
    noisy.extend(hello(PROTOCOL, SCHEMA_HASH));
    assert!(matches!(meets(noisy), Ok(())), "noise before the answer does no harm");
}
