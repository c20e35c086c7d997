//! A recording made over the link runs again on the desktop, to the bit: from the board's own tasks, and from the rig in this process.

use std::time::Duration;

use host_tool::experiment;
use host_tool::link::{Client, Cut, FlashMemory, Hardware, HardwareConfig, InProcess, LinkError, Lockstep, Transport};
use host_tool::network::Mode;
use host_tool::plant::{Plant, PlantConfig};
use host_tool::replay_log::{Event, ReplayLog, Tracing, replay, story};
use host_tool::track::run;
use model_export::link::fault::Fault;
use model_export::link::message::{Refusal, Reply, Request};
use model_export::link::settings::{SettingValue, Settings, by_name};
use model_export::link::state::State;
use model_export::link::trace::TraceCommand;
use rig_tests::board::Board;
use rig_tests::models;

fn hardware() -> Hardware {
    let plant = Plant::new(PlantConfig::default()).unwrap();
    Hardware::new(HardwareConfig::default(), Box::new(plant.start(0.0)))
}

/// A model with a network and with what controllers need of the actuator.
fn blob() -> Vec<u8> {
    let front_end = models::physics_front_end(5, 8, 2);
    let network = models::network(4, front_end.features.len(), &[8], host_tool::network::Activation::Hard, 4.0);
    let hybrid = models::model(front_end, Some(network), Mode::Streaming);
    models::exported_with(&hybrid, 5, Some(models::compensation()))
}

fn flash(blob: &[u8]) -> FlashMemory {
    let settings = Settings {
        control_law: 2,
        feed_forward: 3,
        feedback_sensor: 3,
        pid_proportional: 0.2,
        pid_integral_per_s: 2.0,
        pid_limit_mm: 8.0,
        mismatch_displacement_mm: 0.0,
        maximum_late_ticks: 10,
        ..Settings::default()
    };
    FlashMemory::with_model(blob).unwrap().with_settings(&settings).unwrap()
}

fn points_mm(seed: u32) -> Vec<f64> {
    (0..150).map(|point| 4.0 - 2.0 * (f64::from(point + seed) * 0.08).cos() + f64::from(point / 100)).collect()
}

fn board(seed: u32, blob: &[u8]) -> Client<Board> {
    let mut client = Client::connect(Board::new(flash(blob), hardware(), seed)).unwrap();
    experiment::settle(&mut client).unwrap();
    client
}

fn idle<T: Transport>(client: &mut Client<T>) {
    while experiment::status(client).unwrap().state != State::Idle {
        client.listen_for(Duration::from_millis(20)).unwrap();
    }
}

/// What a tick took, by kind, over a replay log.
fn commands(replay_log: &ReplayLog, is: impl Fn(&TraceCommand) -> bool) -> usize {
    let named = |event: &Event| match event {
        Event::Traced(tick) => tick.record.extra.is_some_and(|extra| is(&extra.command)),
        _ => false,
    };
    replay_log.events.iter().filter(|event| named(event)).count()
}

fn identical(replay_log: &ReplayLog) {
    // Through a file, as everybody gets it.
    let replay_log = ReplayLog::from_bytes(&replay_log.to_bytes().unwrap()).unwrap();
    let replay = replay(&replay_log).unwrap();
    assert_eq!(replay.first_difference, None, "{} ticks", replay.ticks);
    assert_eq!(replay.cut, None);
    assert_eq!(replay.ticks, replay_log.ticks() as u64);
}

#[test]
fn a_boards_run_with_stops_faults_and_other_settings_is_run_again_to_the_bit_whatever_its_tasks_order_was() {
    let blob = blob();
    for seed in 11..15 {
        let mut client = board(seed, &blob);
        // A past that a replay knows nothing of: a run, and a memory of it in every filter.
        run::run(&mut client, &points_mm(seed), &mut |_, _| {}).unwrap();
        let tracing = Tracing::begin(&mut client, "test", Some(&blob)).unwrap();
        run::run(&mut client, &points_mm(2 * seed), &mut |_, _| {}).unwrap();
        // Another controller.
        let number = by_name("control.feed_forward").unwrap().number;
        client.command(&Request::SettingSet { number, value: SettingValue::Integer(2) }).unwrap();
        client.listen_for(Duration::from_millis(500)).unwrap();
        // A stop in mid-motion, and the way back to idle through another self-test, in which the model goes and comes.
        let stopped = run::run(&mut client, &points_mm(3 * seed), &mut |board: &mut Board, sample| {
            if sample.playback_index > 80 {
                board.press(true);
            }
        });
        assert!(stopped.is_err(), "seed {seed}");
        client.transport().press(false);
        client.listen_for(Duration::from_millis(300)).unwrap();
        client.command(&Request::Acknowledge).unwrap();
        idle(&mut client);
        // And one by request.
        let vented = run::run(&mut client, &points_mm(seed), &mut |_, sample| assert!(sample.first_fault == 0)).unwrap();
        assert!(vented.len() > 100);
        client.listen_for(Duration::from_millis(300)).unwrap();
        client.command(&Request::Arm).unwrap();
        client.command(&Request::Vent).unwrap();
        client.listen_for(Duration::from_millis(100)).unwrap();
        let replay_log = tracing.end(&mut client);

        identical(&replay_log);
        assert!(replay_log.ticks() > 8_000, "seed {seed}: {} ticks", replay_log.ticks());
        assert!(commands(&replay_log, |command| matches!(command, TraceCommand::Request(_))) > 50);
        assert_eq!(commands(&replay_log, |command| matches!(command, TraceCommand::SelfTestReport { .. })), 2);
        let lost = |event: &Event| matches!(event, Event::Traced(tick) if tick.record.extra.is_some_and(|extra| extra.lost_ticks > 0));
        assert!(replay_log.events.iter().any(lost), "seed {seed}: a tick was lost and none of it came");
        // The story knows what stopped it.
        let told = story(&replay_log, None).unwrap();
        let causes: Vec<String> = told.turnings.iter().map(|turning| turning.cause.in_words()).collect();
        assert!(causes.iter().any(|cause| cause.contains("emergency-stop")), "{causes:?}");
        assert!(causes.iter().any(|cause| cause.contains("`Vent`")), "{causes:?}");
    }
}

#[test]
fn a_run_with_adaptation_is_run_again_to_the_bit() {
    let blob = blob();
    let mut client = board(21, &blob);
    let set = |client: &mut Client<Board>, name: &str, value| {
        let number = by_name(name).unwrap().number;
        client.command(&Request::SettingSet { number, value }).unwrap();
    };
    // The model is none of this rig: laser and estimate are far apart.
    set(&mut client, "pid.proportional", SettingValue::Float(0.0));
    set(&mut client, "adaptation.gate_share", SettingValue::Float(0.25));
    set(&mut client, "adaptation.span_mm", SettingValue::Float(14.0));
    set(&mut client, "adaptation.loop_delay_ms", SettingValue::Integer(200));
    set(&mut client, "adaptation.enabled", SettingValue::Flag(true));
    client.listen_for(Duration::from_millis(500)).unwrap();
    let learned = |client: &mut Client<Board>| match client.request(&Request::AdaptationReport).unwrap() {
        Reply::AdaptationReport(report) => report,
        reply => panic!("{reply:?}"),
    };
    run::run(&mut client, &points_mm(21), &mut |_, _| {}).unwrap();
    assert!(learned(&mut client).updates > 20, "{:?}", learned(&mut client));
    let tracing = Tracing::begin(&mut client, "test", Some(&blob)).unwrap();
    assert_eq!(learned(&mut client).updates, 0, "a rig that begins again has learned nothing");
    run::run(&mut client, &points_mm(42), &mut |_, _| {}).unwrap();
    // What has nothing to do with it leaves it alone, a new range does not.
    let before = learned(&mut client);
    set(&mut client, "telemetry.period_ms", SettingValue::Integer(40));
    assert_eq!(learned(&mut client).updates, before.updates);
    client.listen_for(Duration::from_millis(500)).unwrap();
    run::run(&mut client, &points_mm(63), &mut |_, _| {}).unwrap();
    assert!(learned(&mut client).updates > before.updates);
    set(&mut client, "adaptation.span_mm", SettingValue::Float(13.0));
    assert_eq!(learned(&mut client).updates, 0);
    identical(&tracing.end(&mut client));
}

#[test]
fn the_rig_in_this_process_tells_its_trace_over_its_link_like_a_board() {
    let blob = blob();
    let lockstep = Lockstep::new(InProcess::new(flash(&blob)), hardware(), (), "the test's rig", "virtual").unwrap();
    let mut client = Client::connect(lockstep).unwrap();
    experiment::settle(&mut client).unwrap();
    run::run(&mut client, &points_mm(1), &mut |_, _| {}).unwrap();
    let tracing = Tracing::begin(&mut client, "test", Some(&blob)).unwrap();
    let samples = run::run(&mut client, &points_mm(2), &mut |_, _| {}).unwrap();
    let replay_log = tracing.end(&mut client);
    identical(&replay_log);
    // And it says where a moment's output came from.
    let begin_ms = match replay_log.events[0] {
        Event::Begin { time_ms, .. } => time_ms,
        _ => panic!("a trace begins"),
    };
    let sample = samples[100];
    let told = story(&replay_log, Some((sample.time_ms - begin_ms) as f64 * 1e-3)).unwrap();
    let moment = told.moment.unwrap();
    assert_eq!((moment.output_bar * 1e6).round() as i32, sample.output_ubar);
    assert_eq!(moment.set_point, sample.set_point);
    assert!(moment.why.iter().any(|why| why.contains("of the playback")), "{:?}", moment.why);
}

#[test]
fn one_code_that_differs_is_found_in_its_tick() {
    let blob = blob();
    let mut client = board(3, &blob);
    let tracing = Tracing::begin(&mut client, "test", Some(&blob)).unwrap();
    run::run(&mut client, &points_mm(1), &mut |_, _| {}).unwrap();
    let mut replay_log = tracing.end(&mut client);
    let at = replay_log.events.len() / 2;
    let Event::Traced(tick) = &mut replay_log.events[at] else { panic!("a tick") };
    tick.record.pressure_code ^= 1;
    // Event 0 is the beginning. A pressure shows in the checked outputs when its window ends, at the latest.
    let found = replay(&replay_log).unwrap().first_difference.unwrap().tick;
    assert!((at as u64 - 1..at as u64 + 20).contains(&found), "changed {at}, found {found}");
}

#[test]
fn a_lost_frame_cuts_the_replay_log_there_and_all_before_it_is_run_again() {
    let blob = blob();
    let mut client = board(5, &blob);
    let tracing = Tracing::begin(&mut client, "test", Some(&blob)).unwrap();
    client.command(&Request::PlaybackClear).unwrap();
    let before = client.elapsed();
    for attempt in 1..40 {
        // Some frame, until one of the trace is hit; replies that are lost are asked for again.
        client.transport().lose_frame(1 + attempt % 3);
        client.listen_for(Duration::from_millis(40)).unwrap();
    }
    let passed_ms = (client.elapsed() - before).as_millis() as usize;
    let replay_log = tracing.end(&mut client);
    let replay = replay(&replay_log).unwrap();
    // A piece, or two in a row where the next loss follows at once.
    assert!(matches!(replay.cut, Some(Cut::Lost { bytes: 128..=512 })), "{:?}", replay.cut);
    assert!(replay.is_identical() && replay.ticks > 100 && (replay.ticks as usize) < passed_ms, "{} ticks", replay.ticks);
}

#[test]
fn a_line_that_is_too_slow_ends_the_trace_and_the_device_says_so() {
    let blob = blob();
    let mut client = board(6, &blob);
    let tracing = Tracing::begin(&mut client, "test", Some(&blob)).unwrap();
    client.transport().set_line(6);
    client.listen_for(Duration::from_secs(3)).unwrap();
    client.transport().set_line(92);
    let replay_log = tracing.end(&mut client);
    let replay = replay(&replay_log).unwrap();
    assert_eq!(replay.cut, Some(Cut::TooSlow));
    // What the queues held and what the line took of nine bytes a tick.
    assert!(replay.is_identical() && replay.ticks > 300, "{} ticks", replay.ticks);
    // The next one is whole again.
    let tracing = Tracing::begin(&mut client, "test", Some(&blob)).unwrap();
    client.listen_for(Duration::from_millis(200)).unwrap();
    identical(&tracing.end(&mut client));
}

#[test]
fn a_device_that_is_reset_leaves_the_replay_log_of_the_time_before() {
    let blob = blob();
    let lockstep = Lockstep::new(InProcess::new(flash(&blob)), hardware(), (), "the test's rig", "virtual").unwrap();
    let mut client = Client::connect(lockstep).unwrap();
    experiment::settle(&mut client).unwrap();
    let tracing = Tracing::begin(&mut client, "test", Some(&blob)).unwrap();
    client.listen_for(Duration::from_millis(200)).unwrap();
    client.transport().injected(firmware::device::exchange::InjectedFault::Panic);
    client.listen_for(Duration::from_millis(500)).unwrap();
    let replay = replay(&tracing.end(&mut client)).unwrap();
    assert_eq!(replay.cut, Some(Cut::NoEnd));
    assert!(replay.is_identical() && replay.ticks > 400, "{} ticks", replay.ticks);
    assert_eq!(experiment::status(&mut client).unwrap().first_fault, Fault::Panicked.number());
}

#[test]
fn a_trace_begins_only_idle_and_vented_and_with_the_model_at_hand_and_nothing_gets_past_it() {
    let blob = blob();
    let mut client = board(7, &blob);
    let refused = |client: &mut Client<Board>, request: &Request| match client.ask(request).unwrap() {
        Reply::Refused(refusal) => Some(refusal),
        _ => None,
    };
    let missing = Tracing::begin(&mut client, "test", None).map(|_| ()).unwrap_err().to_string();
    assert!(missing.contains("--model"), "{missing}");
    let other =
        models::exported_with(&models::model(models::physics_front_end(6, 8, 2), None, Mode::Streaming), 5, Some(models::compensation()));
    assert!(Tracing::begin(&mut client, "test", Some(&other)).is_err());

    client.command(&Request::Arm).unwrap();
    assert!(matches!(refused(&mut client, &Request::TraceBegin), Some(Refusal::Blocked(_))));
    assert_eq!(experiment::status(&mut client).unwrap().state, State::Armed);
    client.command(&Request::Disarm).unwrap();
    client.listen_for(Duration::from_millis(300)).unwrap();

    let tracing = Tracing::begin(&mut client, "test", Some(&blob)).unwrap();
    let number = by_name("limits.ceiling_bar").unwrap().number;
    client.command(&Request::SettingSet { number, value: SettingValue::Float(2.5) }).unwrap();
    for request in [
        Request::TraceBegin,
        Request::ModelBegin { length: 4, crc32: 0 },
        Request::ModelFinish,
        Request::ModelActivate { id: [7; 8] },
        Request::SettingsRevert(model_export::link::message::Baseline::Saved),
    ] {
        assert_eq!(refused(&mut client, &request), Some(Refusal::Traced), "{request:?}");
    }
    identical(&tracing.end(&mut client));
    client.command(&Request::SettingsRevert(model_export::link::message::Baseline::Saved)).unwrap();

    // A fault that is latched is not forgotten by way of a trace.
    client.transport().press(true);
    client.command(&Request::Arm).map(|()| panic!("armed with the stop pressed")).unwrap_or_else(|error| {
        assert!(matches!(error, LinkError::Refused(Refusal::Blocked(_))), "{error}");
    });
}
