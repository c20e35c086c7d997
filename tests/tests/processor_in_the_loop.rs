//! The firmware as ARM code in QEMU against the same firmware in this process: equal to the bit, and safe when something breaks.
//!
//! `cargo xtask test` builds the image and names it in `CATHETER_PIL_IMAGE`; without that name the tests say so and pass, since an image
//! that lies about may be of other sources.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use firmware::device::exchange::InjectedFault;
use firmware::storage::Slot;
use host_tool::excitation::{ExcitationConfig, Limits, Segment, Signal};
use host_tool::experiment;
use host_tool::link::{Breakage, Client, FlashMemory, Hardware, HardwareConfig, InProcess, Lockstep, Processor, Qemu, QemuConfig};
use host_tool::network::Mode;
use host_tool::plant::{Plant, PlantConfig};
use host_tool::replay_log::{Event, Header, Recorder, ReplayLog, Tracing, replay};
use model_export::link::fault::{Blocker, Fault};
use model_export::link::message::{PlaybackChunk, Quantity, Refusal, Reply, Request, Telemetry};
use model_export::link::settings::Settings;
use model_export::link::state::{ResetCause, State};
use rig_tests::models;

type Rig<P> = Client<Lockstep<P, Recorder>>;

/// The image, if `cargo xtask test` has built one.
fn image() -> Option<QemuConfig> {
    let Some(image) = std::env::var_os("CATHETER_PIL_IMAGE") else {
        println!("skipped: needs QEMU and the image, `cargo xtask test` brings both");
        return None;
    };
    let config = QemuConfig::find(Some(Path::new(&image))).expect("the image that CATHETER_PIL_IMAGE names");
    Some(QemuConfig { hung_after: Duration::from_secs(5), ..config })
}

fn connected<P: Processor>(processor: P, flash: &FlashMemory) -> Rig<P> {
    let plant = Plant::new(PlantConfig::default()).unwrap();
    let hardware = Hardware::new(HardwareConfig::default(), Box::new(plant.start(0.0)));
    let recorder = Recorder::new(Header::new("test", "qemu", String::new(), flash));
    Client::connect(Lockstep::new(processor, hardware, recorder, "the test's rig", "qemu").unwrap()).unwrap()
}

fn qemu(config: &QemuConfig, flash: &FlashMemory) -> Rig<Qemu> {
    connected(Qemu::start(config.clone(), flash).unwrap(), flash)
}

fn host(flash: &FlashMemory) -> Rig<InProcess> {
    connected(InProcess::new(flash.clone()), flash)
}

/// Flash with settings for pressure set-points.
fn set_point_flash() -> FlashMemory {
    FlashMemory::default().with_settings(&Settings { control_law: 1, ..Settings::default() }).unwrap()
}

/// Brings a rig to running at 1.5 bar.
fn run_up<P: Processor>(rig: &mut Rig<P>) {
    experiment::settle(rig).unwrap();
    rig.command(&Request::Arm).unwrap();
    rig.command(&Request::Start).unwrap();
    for _ in 0..60 {
        rig.send(&Request::SetPoint { quantity: Quantity::Pressure, value: 1.5 }).unwrap();
        rig.transport().advance_for(10).unwrap();
    }
    assert_eq!(experiment::status(rig).unwrap().state, State::Running);
    assert!(rig.transport().hardware().pressure_bar() > 1.4);
}

fn replay_log<P: Processor>(rig: Rig<P>) -> ReplayLog {
    rig.into_transport().observer().replay_log().clone()
}

/// Both journals have the same events, and the library runs the target's again to the bit.
fn agree(host: &ReplayLog, target: &ReplayLog) {
    let difference = (0..host.events.len().max(target.events.len())).find(|at| host.events.get(*at) != target.events.get(*at));
    if let Some(at) = difference {
        panic!("event {at}:\n host   {:?}\n target {:?}", host.events.get(at), target.events.get(at));
    }
    assert!(replay(target).unwrap().is_identical());
}

/// A session with everything a host may send, sense and nonsense, from a small generator.
fn session<P: Processor>(rig: &mut Rig<P>, seed: u32) {
    experiment::settle(rig).unwrap();
    let mut random = seed;
    let mut next = move |below: u32| {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 8) % below
    };
    // It begins as a sensible host would, so that the nonsense strikes a rig under pressure.
    let mut index = 3;
    rig.send(&Request::Playback(PlaybackChunk { first_index: 0, last: false, values_bar: [0.5, 1.0, 1.5].into_iter().collect() })).unwrap();
    rig.send(&Request::Arm).unwrap();
    rig.transport().advance_for(3).unwrap();
    rig.send(&Request::Start).unwrap();
    for _ in 0..400 {
        let value = next(4_000) as f32 * 1e-3 - 0.3;
        let request = match next(100) {
            0 => Request::Arm,
            1 => Request::Start,
            2 => Request::Stop,
            3 => Request::Disarm,
            4 => Request::Vent,
            5 => Request::Acknowledge,
            6 => Request::Status,
            7 => Request::FaultRecord,
            8 => Request::PlaybackClear,
            9 => Request::SettingGet { number: u16::try_from(next(100)).unwrap() },
            10 => Request::SetPoint { quantity: Quantity::Displacement, value },
            11 => Request::SetPoint { quantity: Quantity::Pressure, value: f32::NAN },
            12..60 => {
                let values_bar = [value, value + 0.01, value].into_iter().collect();
                index += 3;
                Request::Playback(PlaybackChunk { first_index: index - 3, last: next(9) == 0, values_bar })
            }
            _ => Request::SetPoint { quantity: Quantity::Pressure, value },
        };
        rig.send(&request).unwrap();
        if next(50) == 0 {
            let noise: Vec<u8> = (0..next(30)).map(|_| next(256).to_le_bytes()[0]).collect();
            host_tool::link::Transport::send(rig.transport(), &noise).unwrap();
        }
        rig.transport().advance_for(next(12)).unwrap();
    }
}

#[test]
fn adaptation_is_equal_to_the_bit() {
    let Some(config) = image() else { return };
    let physics = models::model(models::physics_front_end(5, 8, 2), None, Mode::Streaming);
    let blob = models::exported_with(&physics, 5, Some(models::compensation()));
    let settings = Settings {
        control_law: 2,
        feed_forward: 3,
        feedback_sensor: 2,
        pid_integral_per_s: 2.0,
        mismatch_displacement_mm: 0.0,
        adaptation: true,
        // The model is none of this rig: laser and estimate are far apart.
        adaptation_gate_share: 0.25,
        adaptation_span_mm: 14.0,
        adaptation_time_constant_s: 20.0,
        host_timeout_ms: 1000,
        ..Settings::default()
    };
    let flash = FlashMemory::with_model(&blob).unwrap().with_settings(&settings).unwrap();
    let points_mm: Vec<f64> = (0..300).map(|point| 5.0 - 2.5 * (f64::from(point) * 0.06).cos()).collect();
    fn play<P: Processor>(mut rig: Rig<P>, points_mm: &[f64]) -> (ReplayLog, Reply) {
        experiment::settle(&mut rig).unwrap();
        host_tool::track::run::run(&mut rig, points_mm, &mut |_, _| {}).unwrap();
        let report = rig.request(&Request::AdaptationReport).unwrap();
        (replay_log(rig), report)
    }
    let (target, learned) = play(qemu(&config, &flash), &points_mm);
    let (here, also_learned) = play(host(&flash), &points_mm);
    agree(&here, &target);
    assert_eq!(learned, also_learned);
    assert!(matches!(learned, Reply::AdaptationReport(report) if report.updates > 50), "{learned:?}");
}

#[test]
fn sessions_of_sense_and_nonsense_are_equal_to_the_bit() {
    let Some(config) = image() else { return };
    for seed in [11, 12] {
        let flash = if seed == 11 { set_point_flash() } else { FlashMemory::default() };
        let (mut target, mut here) = (qemu(&config, &flash), host(&flash));
        session(&mut target, seed);
        session(&mut here, seed);
        let (target, here) = (replay_log(target), replay_log(here));
        agree(&here, &target);
        let ticks_in = |state| here.events.iter().filter(|event| matches!(event, Event::Tick(tick) if tick.outputs.state == state)).count();
        let running = ticks_in(State::Running);
        assert!(running > 200, "seed {seed}: the session was of no use, {running} ticks running");
    }
}

#[test]
fn an_experiment_with_the_model_in_the_tick_is_equal_to_the_bit_on_both_kernels() {
    let Some(config) = image() else { return };
    // The largest network that a blob may hold needs the most memory, stack included.
    for units in [&[16][..], &[64, 64]] {
        let settings = Settings { mismatch_displacement_mm: 0.0, ..Settings::default() };
        let flash = FlashMemory::with_model(&rig_tests::hybrid::exported(units)).unwrap().with_settings(&settings).unwrap();
        let signal = Signal::DescendingSine { amplitude_bar: 1.2, frequency_hz: 0.8, decay_per_s: 0.05, offset_bar: 0.0 };
        let segments = vec![Segment { duration_s: 3.0, signal }];
        let excitation = ExcitationConfig { sample_period_s: 0.02, noise_bar: 0.0, seed: 1, segments };
        let (mut target, mut here) = (qemu(&config, &flash), host(&flash));
        let outcome = experiment::record(&mut target, &excitation, &Limits::default(), None).unwrap();
        experiment::record(&mut here, &excitation, &Limits::default(), None).unwrap();
        assert!(outcome.fault.is_none() && outcome.samples.len() == 150, "{units:?}: {:?}", outcome.fault);
        let estimates: Vec<f32> = outcome.samples.iter().filter_map(|sample| sample.estimate_mm).collect();
        let (low, high) = estimates.iter().fold((f32::MAX, f32::MIN), |(low, high), value| (low.min(*value), high.max(*value)));
        assert!(estimates.len() == 150 && high - low > 5.0, "{units:?}: {} estimates from {low} to {high} mm", estimates.len());
        agree(&replay_log(here), &replay_log(target));
    }
}

#[test]
fn tracking_by_every_feed_forward_and_through_a_lost_laser_is_equal_to_the_bit() {
    let Some(config) = image() else { return };
    let physics = models::model(models::physics_front_end(5, 8, 2), None, Mode::Streaming);
    let blob = models::exported_with(&physics, 5, Some(models::compensation()));
    // Three seconds of a sine with a corner in it, within reach of the simulated muscle.
    let points_mm: Vec<f64> = (0..150).map(|point| 4.0 - 2.0 * (f64::from(point) * 0.08).cos() + f64::from(point / 100)).collect();
    for (feed_forward, feedback_sensor) in [(0, 1), (1, 2), (2, 1), (3, 3)] {
        let settings = Settings {
            control_law: 2,
            feed_forward,
            feedback_sensor,
            pid_proportional: 0.2,
            pid_integral_per_s: 2.0,
            pid_limit_mm: 8.0,
            laser_required: false,
            mismatch_displacement_mm: 0.0,
            ..Settings::default()
        };
        let flash = FlashMemory::with_model(&blob).unwrap().with_settings(&settings).unwrap();
        let (mut target, mut here) = (qemu(&config, &flash), host(&flash));
        let samples = track(&mut target, &points_mm);
        assert_eq!(samples, track(&mut here, &points_mm));
        let outputs = samples.iter().map(|sample| sample.output_ubar);
        let (low, high) = outputs.fold((i32::MAX, i32::MIN), |(low, high), output| (low.min(output), high.max(output)));
        assert!(high - low > 200_000, "feed-forward {feed_forward}: from {low} to {high} microbar");
        assert!(samples.iter().any(|sample| sample.displacement_mm.is_none()), "the laser was lost");
        agree(&replay_log(here), &replay_log(target));
    }
}

/// Follows a path and loses the laser on the way.
fn track<P: Processor>(rig: &mut Rig<P>, points_mm: &[f64]) -> Vec<Telemetry> {
    experiment::settle(rig).unwrap();
    let lose = |transport: &mut Lockstep<P, Recorder>, sample: &Telemetry| {
        if sample.playback_index > 75 {
            transport.hardware().set_breakage(Some(Breakage::LaserCode(1396)));
        }
    };
    host_tool::track::run::run(rig, points_mm, &mut { lose }).unwrap()
}

/// The replay log that a device tells over its serial line, which is all that a board has.
fn told<P: Processor>(rig: &mut Rig<P>, blob: &[u8], points_mm: &[f64]) -> ReplayLog {
    experiment::settle(rig).unwrap();
    let tracing = Tracing::begin(rig, "test", Some(blob)).unwrap();
    track(rig, points_mm);
    rig.transport().hardware().set_breakage(Some(Breakage::EmergencyStop));
    rig.ask(&Request::Vent).unwrap();
    rig.transport().advance_for(100).unwrap();
    tracing.end(rig)
}

#[test]
fn what_the_emulated_board_tells_over_its_serial_line_is_run_again_to_the_bit() {
    let Some(config) = image() else { return };
    let physics = models::model(models::physics_front_end(5, 8, 2), None, Mode::Streaming);
    let blob = models::exported_with(&physics, 5, Some(models::compensation()));
    let points_mm: Vec<f64> = (0..150).map(|point| 4.0 - 2.0 * (f64::from(point) * 0.08).cos()).collect();
    let settings = Settings {
        control_law: 2,
        feed_forward: 3,
        feedback_sensor: 3,
        laser_required: false,
        mismatch_displacement_mm: 0.0,
        ..Settings::default()
    };
    let flash = FlashMemory::with_model(&blob).unwrap().with_settings(&settings).unwrap();
    let (mut target, mut here) = (qemu(&config, &flash), host(&flash));
    let (told_by_target, told_here) = (told(&mut target, &blob, &points_mm), told(&mut here, &blob, &points_mm));
    assert!(told_by_target.ticks() > 3_000, "{} ticks", told_by_target.ticks());
    agree(&told_here, &told_by_target);
    assert_eq!(replay(&told_by_target).unwrap().cut, None);
    agree(&replay_log(here), &replay_log(target));
}

#[test]
fn settings_and_models_survive_in_the_emulated_flash() {
    let Some(config) = image() else { return };
    let flash = FlashMemory::default();
    let mut rig = qemu(&config, &flash);
    experiment::settle(&mut rig).unwrap();
    let number = model_export::link::settings::by_name("limits.ceiling_bar").unwrap().number;
    rig.command(&Request::SettingSet { number, value: model_export::link::settings::SettingValue::Float(2.25) }).unwrap();
    rig.command(&Request::SettingsSave).unwrap();
    let kept = rig.transport().processor().read_flash().unwrap();
    assert_ne!(kept, flash);
    for value in [
        host_tool::device_settings::setting(&mut qemu(&config, &kept), "limits.ceiling_bar").unwrap(),
        host_tool::device_settings::setting(&mut host(&kept), "limits.ceiling_bar").unwrap(),
    ] {
        assert_eq!(value, model_export::link::settings::SettingValue::Float(2.25));
    }
}

#[test]
fn a_processor_that_hangs_overflows_its_stack_or_panics_ends_vented_within_50_ms_and_says_why() {
    let Some(config) = image() else { return };
    let flash = set_point_flash();
    for (injected, cause, fault) in [
        (InjectedFault::Hang, ResetCause::Watchdog, Fault::WatchdogReset),
        (InjectedFault::StackOverflow, ResetCause::Software, Fault::HardFault),
        (InjectedFault::Panic, ResetCause::Software, Fault::Panicked),
    ] {
        let broken = |rig: &mut dyn FnMut(u32) -> (bool, f64)| (1..=50).find(|_| !rig(1).0);
        let mut target = qemu(&config, &flash);
        run_up(&mut target);
        target.transport().injected(injected);
        let safe_after_ms = broken(&mut |ticks| {
            target.transport().advance_for(ticks).unwrap();
            let hardware = target.transport().hardware();
            (hardware.is_energised(), hardware.pressure_bar())
        });
        assert!(safe_after_ms.is_some_and(|ms| ms <= 50), "{injected:?}: energised after 50 ms");
        target.transport().advance_for(400).unwrap();
        assert!(target.transport().hardware().pressure_bar() < 0.1);
        assert!(target.transport().hardware().peak_bar() <= 3.0);
        let status = experiment::status(&mut target).unwrap();
        assert_eq!((status.state, status.first_fault, status.reset_cause), (State::Fault, fault.number(), cause), "{injected:?}");
        assert!(matches!(target.ask(&Request::Arm), Ok(Reply::Refused(Refusal::Blocked(set))) if set.contains(Blocker::FaultLatched)));

        // The same in this process, to the bit, the resets included.
        let mut here = host(&flash);
        run_up(&mut here);
        here.transport().injected(injected);
        for _ in 1..=safe_after_ms.unwrap_or(0) {
            here.transport().advance_for(1).unwrap();
        }
        here.transport().advance_for(400).unwrap();
        experiment::status(&mut here).unwrap();
        here.ask(&Request::Arm).unwrap();
        agree(&replay_log(here), &replay_log(target));
    }
}

#[test]
fn a_lost_host_is_a_fault_within_its_timeout_and_50_ms() {
    let Some(config) = image() else { return };
    let mut rig = qemu(&config, &set_point_flash());
    run_up(&mut rig);
    rig.transport().advance_for(300).unwrap();
    assert!(!rig.transport().hardware().is_energised());
    assert_eq!(experiment::status(&mut rig).unwrap().first_fault, Fault::HostLost.number());
}

#[test]
fn hardware_that_breaks_ends_vented_within_50_ms_as_arm_code_too() {
    let Some(config) = image() else { return };
    let flash = set_point_flash();
    for (breakage, allowed) in [
        (Breakage::EmergencyStop, [Fault::EmergencyStop, Fault::EmergencyStop]),
        (Breakage::LaserCode(1396), [Fault::LaserRange, Fault::LaserRange]),
        (Breakage::SupplyFails, [Fault::PressureMismatch, Fault::PressureMismatch]),
        (Breakage::PressureCode(8190), [Fault::PressureRange, Fault::PressureRange]),
    ] {
        let mut rig = qemu(&config, &flash);
        run_up(&mut rig);
        rig.transport().hardware().set_breakage(Some(breakage));
        let mut ticks = 0;
        while rig.transport().hardware().is_energised() && ticks < 200 {
            // The host goes on as if nothing had happened.
            if ticks % 10 == 0 {
                rig.send(&Request::SetPoint { quantity: Quantity::Pressure, value: 1.5 }).unwrap();
            }
            rig.transport().advance_for(1).unwrap();
            ticks += 1;
        }
        assert!(ticks <= 50, "{breakage:?}: {ticks} ms");
        let first = experiment::status(&mut rig).unwrap().first_fault;
        assert!(allowed.iter().any(|fault| fault.number() == first), "{breakage:?}: E{first:03}");
    }
}

#[test]
fn damaged_flash_is_a_named_fault_and_nothing_arms() {
    let Some(config) = image() else { return };
    // A settings slot whose payload lost a bit.
    let mut flash = set_point_flash();
    flash.settings.contents_mut(Slot::A)[1032] ^= 1;
    let mut rig = qemu(&config, &flash);
    rig.transport().advance_for(400).unwrap();
    let status = experiment::status(&mut rig).unwrap();
    assert_eq!((status.state, status.first_fault), (State::Fault, Fault::SettingsInvalid.number()));
    assert!(matches!(rig.ask(&Request::Arm), Ok(Reply::Refused(Refusal::Blocked(_)))));

    // A model that is whole and not what its exporter saw: one play weight differs in its last place.
    let bytes = rig_tests::hybrid::exported(&[16]);
    let mut model = model_export::blob::decode(&bytes).unwrap().model;
    model.front_end.play_weights[0] = model.front_end.play_weights[0].next_up();
    let flash = FlashMemory::with_model(&model_export::blob::encode(&model).unwrap()).unwrap();
    let mut rig = qemu(&config, &flash);
    rig.transport().advance_for(400).unwrap();
    let status = experiment::status(&mut rig).unwrap();
    assert_eq!((status.state, status.first_fault), (State::Fault, Fault::GoldenMismatch.number()));
    assert!(matches!(rig.ask(&Request::Arm), Ok(Reply::Refused(Refusal::Blocked(_)))));

    // A model slot whose payload lost a bit; what the payload is does not matter to the slot's own checksum.
    let mut store =
        firmware::storage::Store::new(FlashMemory::default().models, firmware::model::STORE_KIND, firmware::model::STORE_VERSION);
    store.save(&[7; 400]).unwrap();
    let mut flash = FlashMemory { models: store.release(), ..FlashMemory::default() };
    flash.models.contents_mut(Slot::A)[1212] ^= 1;
    let (mut rig, mut here) = (qemu(&config, &flash), host(&flash));
    rig.transport().advance_for(400).unwrap();
    here.transport().advance_for(400).unwrap();
    let status = experiment::status(&mut rig).unwrap();
    assert_eq!((status.state, status.first_fault), (State::Fault, Fault::ModelCorrupt.number()));
    experiment::status(&mut here).unwrap();
    agree(&replay_log(here), &replay_log(rig));
}

/// A host that is killed has no time to end the emulator, which would use up a core for ever.
#[test]
fn an_emulator_whose_host_is_gone_ends() {
    let Some(config) = image() else { return };
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("flash.bin"), FlashMemory::default().to_bytes()).unwrap();
    let mut qemu = Command::new("qemu-system-arm")
        .args(["-M", "netduinoplus2", "-nographic", "-monitor", "none", "-serial", "null"])
        .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
        .arg(&config.image)
        .current_dir(folder.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let ends_within = |qemu: &mut std::process::Child, limit: Duration| {
        let begun = Instant::now();
        while qemu.try_wait().unwrap().is_none() && begun.elapsed() < limit {
            std::thread::sleep(Duration::from_millis(20));
        }
        qemu.try_wait().unwrap()
    };
    let early = ends_within(&mut qemu, Duration::from_secs(1));
    drop(qemu.stdin.take());
    let ended = ends_within(&mut qemu, config.hung_after);
    // Killed in any case; it may have ended.
    let _ = qemu.kill();
    qemu.wait().unwrap();
    assert!(early.is_none(), "it ended while its host was there: {early:?}");
    assert!(ended.is_some_and(|status| !status.success()), "it goes on without its host: {ended:?}");
}
