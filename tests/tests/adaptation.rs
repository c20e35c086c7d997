//! Adaptation on the drifting realistic rig: what the estimate is worth when the laser is lost, and what a laser that lies can do.
//!
//! A slice runs with every test; `CATHETER_DRIFT_S=3600 CATHETER_DRIFT_SEEDS=801,802,803 cargo test --release -p rig-tests --test adaptation --
//! --nocapture` runs the hour on three rigs that the book tells of. Constants were chosen on seed 701.

use host_tool::link::{Breakage, Client, LinkError, refusal_in_words};
use host_tool::rig::live::STROKE_MM;
use host_tool::track::{SettingValues, controller, rig, run, setting};
use model_export::link::adaptation::Adapting;
use model_export::link::fault::{AdaptationCondition, Blocker, Notice};
use model_export::link::message::{Refusal, Request};
use model_export::link::settings::{SettingValue, Settings};
use rig_tests::drift::{self, Drift, Outcome, Session, adapting, laser_lost, moves_and_holds};

/// Time until the laser is lost in a test run, s.
const SLICE_S: f64 = 600.0;
/// Seed of its rig.
const SLICE_SEEDS: [u64; 1] = [801];
/// Drift in an hour, share of the span.
const DRIFT_PER_H: f64 = 0.1;
/// How long the estimate is watched without the laser, s.
const WATCHED_S: f64 = 600.0;

fn length_s() -> f64 {
    std::env::var("CATHETER_DRIFT_S").ok().and_then(|seconds| seconds.parse().ok()).unwrap_or(SLICE_S)
}

fn seeds() -> Vec<u64> {
    let given = std::env::var("CATHETER_DRIFT_SEEDS").ok();
    given.map_or_else(|| SLICE_SEEDS.to_vec(), |seeds| seeds.split(',').map(|seed| seed.parse().expect("a seed")).collect())
}

fn flag(name: &str, value: bool) -> (u16, SettingValue) {
    setting(name, SettingValue::Flag(value))
}

#[test]
fn after_a_drift_at_a_tenth_of_the_span_an_hour_the_estimate_without_the_laser_is_within_a_hundredth() {
    let lost_s = length_s();
    let mut failed = Vec::new();
    for seed in seeds() {
        let tuned = drift::tuned(seed);
        let points_mm = moves_and_holds(tuned.reach, seed, lost_s + WATCHED_S);
        let per_h = if seed % 2 == 0 { DRIFT_PER_H } else { -DRIFT_PER_H };
        for (name, zero_per_h, gain_per_h) in [("zero", per_h, 0.0), ("gain", 0.0, per_h)] {
            let endings = [("then none", lost_s), ("going on", f64::INFINITY)];
            for (after, until_s) in endings.into_iter().take(if lost_s < 1800.0 { 1 } else { 2 }) {
                let run = |settings: &SettingValues| {
                    let drift = Drift { zero_per_h, gain_per_h, until_s };
                    let breakages = [(lost_s, f64::INFINITY, laser_lost())];
                    let controller = "sensorless";
                    drift::session(&Session {
                        seed,
                        tuned: &tuned,
                        controller,
                        settings,
                        drift,
                        points_mm: &points_mm,
                        breakages: &breakages,
                    })
                };
                let outcome = run(&adapting());
                // A drift that goes on is worth a hundredth in six minutes by itself.
                let watched_s = if until_s > lost_s { 240.0 } else { WATCHED_S };
                let errors = outcome.error(lost_s, lost_s + watched_s);
                let percent = |share: f64| 100.0 * share;
                println!(
                    "seed {seed}, {name} {:+.1} %/h for {lost_s} s, {after}; {watched_s} s without the laser: rms {:.2} %, mean {:+.2} %, \
                     95 % within {:.2} %, against the tip {:.2} %; with the laser before {:.2} %; {:?}",
                    percent(per_h),
                    percent(errors.rms),
                    percent(errors.mean),
                    percent(errors.most),
                    percent(errors.true_rms),
                    percent(outcome.error(lost_s - 300.0, lost_s).rms),
                    outcome.report
                );
                if errors.rms >= 0.01 {
                    failed.push((seed, name, after, errors));
                }
                if after == "then none" {
                    let without = run(&vec![flag("laser.required", false)]).error(lost_s, lost_s + WATCHED_S);
                    println!("  without adaptation: rms {:.2} %, mean {:+.2} %", percent(without.rms), percent(without.mean));
                    // Of ten minutes' gain there is less to see than of other errors.
                    assert!(
                        without.rms > errors.rms || (name == "gain" && lost_s < 1200.0),
                        "seed {seed}, {name}: {without:?} without, {errors:?} with"
                    );
                }
            }
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

fn within_limits(outcome: &Outcome) {
    let settings = Settings::default();
    let report = outcome.report;
    assert!(report.zero_mm.abs() <= 1.2 * settings.adaptation_zero_limit_share * STROKE_MM as f32, "{report:?}");
    assert!((settings.adaptation_gain_minimum..=settings.adaptation_gain_maximum).contains(&report.gain), "{report:?}");
    assert!(f64::from(outcome.peaks.output_ubar) <= f64::from(settings.ceiling_bar) * 1e6, "{:?}", outcome.peaks);
    assert!(outcome.peaks.pressure_bar <= f64::from(settings.ceiling_bar), "{:?}", outcome.peaks);
}

#[test]
fn a_laser_that_lies_moves_zero_and_gain_no_farther_than_their_limits_and_no_pressure_above_its_own() {
    let seed = 804;
    let tuned = drift::tuned(seed);
    let points_mm = moves_and_holds(tuned.reach, seed, 420.0);
    let session = |breakages: &[(f64, f64, Breakage)]| {
        let (controller, drift) = ("sensorless", Drift::default());
        drift::session(&Session { seed, tuned: &tuned, controller, settings: &adapting(), drift, points_mm: &points_mm, breakages })
    };
    let sound = session(&[]);
    within_limits(&sound);
    assert!(sound.report.updates > 10_000, "{:?}", sound.report);

    // An offset of a fifth of the span, from when the filter has settled to the end.
    let stepped = session(&[(200.0, f64::INFINITY, Breakage::LaserOffsetMm(0.2 * STROKE_MM))]);
    within_limits(&stepped);
    assert!(stepped.samples.last().unwrap().1.notices.contains(Notice::AdaptationFrozen) || stepped.report.updates < 11_000);
    assert!((stepped.report.zero_mm - sound.report.zero_mm).abs() < 0.02 * STROKE_MM as f32, "{:?} {:?}", stepped.report, sound.report);

    // Bursts of two seconds in every ten, up and down, and a laser that stands still or fails in between.
    let bursts: Vec<(f64, f64, Breakage)> = (0..40)
        .map(|burst| {
            let from_s = 10.0 + 10.0 * f64::from(burst);
            let breakage = match burst % 4 {
                0 => Breakage::LaserOffsetMm(0.3 * STROKE_MM),
                1 => Breakage::LaserFrozen,
                2 => Breakage::LaserOffsetMm(-0.1 * STROKE_MM),
                _ => laser_lost(),
            };
            (from_s, from_s + 2.0, breakage)
        })
        .collect();
    let burst = session(&bursts);
    within_limits(&burst);
    assert!((burst.report.zero_mm - sound.report.zero_mm).abs() < 0.02 * STROKE_MM as f32, "{:?} {:?}", burst.report, sound.report);
    assert!((burst.report.gain - sound.report.gain).abs() < 0.03, "{:?} {:?}", burst.report, sound.report);

    // Stuck for good.
    let stuck = session(&[(200.0, f64::INFINITY, Breakage::LaserFrozen)]);
    within_limits(&stuck);
    assert!((stuck.report.zero_mm - sound.report.zero_mm).abs() < 0.02 * STROKE_MM as f32, "{:?} {:?}", stuck.report, sound.report);
}

#[test]
fn a_long_rest_moves_no_gain() {
    let seed = 805;
    let tuned = drift::tuned(seed);
    let middle_mm = 0.5 * (tuned.reach.low_mm + tuned.reach.high_mm);
    let points_mm = vec![middle_mm; (length_s() * 50.0) as usize];
    let (controller, drift) = ("sensorless", Drift::default());
    let settings = adapting();
    let outcome =
        drift::session(&Session { seed, tuned: &tuned, controller, settings: &settings, drift, points_mm: &points_mm, breakages: &[] });
    within_limits(&outcome);
    // The way there is a motion of which something is learned.
    assert!((outcome.report.gain - 1.0).abs() < 0.03, "{:?}", outcome.report);
    assert!(f64::from(outcome.report.updates) > 0.7 * 50.0 * length_s(), "{:?}", outcome.report);
    println!("a rest of {} s: {:?}", length_s(), outcome.report);
}

#[test]
fn settings_of_adaptation_change_nothing_while_it_is_off() {
    let seed = 806;
    let tuned = drift::tuned(seed);
    let points_mm = moves_and_holds(tuned.reach, seed, 30.0);
    let session = |settings: &SettingValues| {
        let (controller, drift) = ("physics-inverse+pid", Drift::default());
        drift::session(&Session { seed, tuned: &tuned, controller, settings, drift, points_mm: &points_mm, breakages: &[] })
    };
    // As many settings, since each takes a while in which the rig goes on.
    let settings = |span_mm, time_constant_s, delay_ms| {
        vec![
            setting("adaptation.span_mm", SettingValue::Float(span_mm)),
            setting("adaptation.time_constant_s", SettingValue::Float(time_constant_s)),
            setting("adaptation.loop_delay_ms", SettingValue::Integer(delay_ms)),
        ]
    };
    let (one, other) = (session(&settings(10.0, 60.0, 120)), session(&settings(3.0, 10.0, 20)));
    assert_eq!(one.samples.len(), other.samples.len());
    for ((_, one), (_, other)) in one.samples.iter().zip(&other.samples) {
        let bits = |sample: &model_export::link::message::Telemetry| {
            (sample.output_ubar, sample.estimate_mm.map(f32::to_bits), sample.displacement_mm.map(f32::to_bits), sample.notices)
        };
        assert_eq!(bits(one), bits(other));
    }
    assert_eq!(one.report.adapting, Adapting::Off);
}

#[test]
fn a_device_refuses_adaptation_without_its_certificate_and_names_the_condition() {
    let seed = 807;
    let tuned = drift::tuned(seed);
    let (mut client, _) = rig::in_process(&rig::Mover::Realistic, seed, 1).unwrap();
    let sensorless = controller("sensorless").unwrap();
    let mut settings = host_tool::track::rig_settings();
    settings.extend(tuned.settings(sensorless));
    run::prepare(&mut client, &settings, Some(&tuned.blob)).unwrap();
    let on = flag("adaptation.enabled", true);
    let set = |client: &mut Client<_>, (number, value): (u16, SettingValue)| client.command(&Request::SettingSet { number, value });
    let named = |result: Result<(), LinkError>| match result {
        Err(LinkError::Refused(refusal @ Refusal::Uncertified(number))) => {
            let condition = AdaptationCondition::from_number(number).unwrap();
            assert!(refusal_in_words(&refusal).contains(condition.explanation().name), "{refusal:?}");
            condition
        }
        other => panic!("{other:?}"),
    };
    // Each made wrong and right again before it is switched on.
    let wrongs = [
        (setting("adaptation.span_mm", SettingValue::Float(30.0)), AdaptationCondition::SpanWithinLaser),
        (setting("adaptation.zero_limit_share", SettingValue::Float(0.25)), AdaptationCondition::NearTheRaw),
        (setting("control.feed_forward", SettingValue::Integer(1)), AdaptationCondition::LagsInverted),
        (setting("pid.integral_per_s", SettingValue::Float(60.0)), AdaptationCondition::LoopContracts),
        (setting("pid.integral_per_s", SettingValue::Float(0.2)), AdaptationCondition::SlowerThanLoop),
    ];
    for (wrong, condition) in wrongs {
        let Ok(model_export::link::message::Reply::Setting(right)) = client.request(&Request::SettingGet { number: wrong.0 }) else {
            panic!("a setting")
        };
        set(&mut client, wrong).unwrap();
        assert_eq!(named(set(&mut client, on)), condition);
        set(&mut client, (wrong.0, right)).unwrap();
    }
    set(&mut client, on).unwrap();
    // And what is on keeps its certificate.
    assert_eq!(named(set(&mut client, setting("pid.integral_per_s", SettingValue::Float(60.0)))), AdaptationCondition::LoopContracts);
    // A model that is slower than what the certificate was computed for is not armed.
    set(&mut client, setting("adaptation.loop_delay_ms", SettingValue::Integer(30))).unwrap();
    client.listen_for(std::time::Duration::from_millis(500)).unwrap();
    match client.command(&Request::Arm) {
        Err(LinkError::Refused(Refusal::Blocked(blockers))) => assert!(blockers.contains(Blocker::AdaptationUncertified), "{blockers:?}"),
        other => panic!("{other:?}"),
    }
}
