//! A rig in this process, operated without a page: what keeps a task alive, and what does not.

use std::time::{Duration, Instant};

use dashboard::{Action, Phase, Rig as _, Sample};
use serde_json::{Value, json};
use simulation::plant::{Plant, PlantConfig};

use super::{Controller, Line, Offers, OperatedRig};
use crate::link::{FlashMemory, Hardware, HardwareConfig, InProcess, Lockstep};

/// The default of `limits.host_timeout_ms`, and the device's way to safe outputs.
const SAFE_WITHIN: Duration = Duration::from_millis(250 + 50);

const OFFERS: Offers = Offers {
    controllers: &[Controller { name: "open-loop", feed_forward: 1, sensor: 0 }],
    references: &["ramp"],
    reference_period_s: 0.02,
    reference: |name, [low_mm, high_mm], _| {
        (name == "ramp").then(|| (0..100).map(|point| low_mm + (high_mm - low_mm) * f64::from(point) / 100.0).collect())
    },
    calibration_page: |board, _, saved, findings, changes| format!("{board} {saved} {} {}", findings.len(), changes.len()),
};

fn rig() -> OperatedRig {
    let plant = Plant::new(PlantConfig::default()).unwrap();
    let hardware = Hardware::new(HardwareConfig::default(), Box::new(plant.start(0.0)));
    let lockstep = Lockstep::new(InProcess::new(FlashMemory::default()), hardware, (), "the rig in this process", "virtual").unwrap();
    OperatedRig::new(Line::Virtual(Box::new(lockstep)), "pi", 1, OFFERS).unwrap()
}

/// Listens, with signs of life or without, until something holds; the samples meanwhile.
fn until(rig: &mut OperatedRig, lives: bool, limit: Duration, holds: impl Fn(&mut OperatedRig) -> bool) -> (bool, Vec<Sample>) {
    let (begun, mut lived, mut samples) = (Instant::now(), Instant::now(), Vec::new());
    while begun.elapsed() < limit {
        if lives && lived.elapsed() >= Duration::from_millis(20) {
            lived = Instant::now();
            rig.renew().unwrap();
        }
        rig.listen(Duration::from_millis(4), &mut samples).unwrap();
        if holds(rig) {
            return (true, samples);
        }
    }
    (false, samples)
}

fn setting(rig: &mut OperatedRig, name: &str) -> Value {
    rig.settings().unwrap().into_iter().find(|setting| setting.name == name).unwrap().value
}

fn step(rig: &mut OperatedRig, name: &str) -> Value {
    let told = rig.calibration().unwrap();
    told["steps"].as_array().unwrap().iter().find(|step| step["name"] == name).unwrap().clone()
}

fn asks(rig: &mut OperatedRig) -> bool {
    rig.told_task().is_some_and(|task| task.asks.is_some())
}

#[test]
fn a_step_is_energised_by_signs_of_life_alone_and_vents_without_them() {
    let mut rig = rig();
    rig.act(&Action::Calibrate { step: "pressure".to_owned() }).unwrap();
    assert!(rig.act(&Action::Arm { mode: dashboard::Mode::Pressure }).is_err(), "nothing else while a step runs");
    assert!(until(&mut rig, true, Duration::from_secs(5), asks).0, "the gauge at rest");
    rig.act(&Action::Answer { value: 0.0 }).unwrap();
    // Two seconds of listening pass, and then the device would be armed; nobody gives a sign of life.
    let (_, samples) = until(&mut rig, false, Duration::from_secs(4), |_| false);
    assert!(samples.iter().all(|sample| !sample.phase.is_energised()), "it armed by itself");
    assert_eq!(rig.told_task().unwrap().does, "waits until the rig is ready");
    let (runs, _) = until(&mut rig, true, Duration::from_secs(5), |rig| rig.phase == Phase::Running && asks(rig));
    assert!(runs, "the gauge under pressure");
    // The operator is silent: nothing but the device's own time-to-live is left.
    let last = rig.client.elapsed();
    let (ended, samples) = until(&mut rig, false, Duration::from_secs(2), |rig| !rig.phase.is_energised());
    assert!(ended, "it stays energised");
    let safe = samples.iter().rev().find(|sample| sample.phase.is_energised()).unwrap();
    let safe = Duration::from_millis(safe.time_ms).saturating_sub(last);
    assert!(safe <= SAFE_WITHIN, "energised {safe:?} after the last sign of life");
    until(&mut rig, false, Duration::from_millis(100), |_| false);
    let told = step(&mut rig, "pressure");
    assert!(told["state"] == "failed" && told["problem"].as_str().unwrap().contains("the rig vented with"), "{told}");
    assert!(rig.told_task().is_none());
}

#[test]
fn a_step_is_repeated_taken_and_reverted_and_leaves_no_setting_behind() {
    let mut rig = rig();
    let own = setting(&mut rig, "mismatch.pressure_bar");
    let begin = Action::Calibrate { step: "laser".to_owned() };
    for shift_mm in [0.0, 0.5] {
        rig.act(&begin).unwrap();
        for distance_mm in [2.0, 6.0, 10.0, 14.0, 18.0] {
            assert!(until(&mut rig, false, Duration::from_secs(5), asks).0, "the target at {distance_mm} mm");
            rig.act(&Action::Answer { value: distance_mm }).unwrap();
            // A target elsewhere than the simulation was told: the laser is off by so much.
            rig.client.transport().line().hardware().unwrap().place_target(Some(distance_mm + shift_mm));
        }
        assert!(until(&mut rig, false, Duration::from_secs(5), |rig| rig.told_task().is_none()).0, "the end of the step");
    }
    assert_eq!(step(&mut rig, "laser")["state"], "found");
    assert!(rig.calibration_page().is_err(), "nothing is taken yet");
    let before = setting(&mut rig, "laser.low_mm");
    rig.act(&Action::Accept).unwrap();
    let after = setting(&mut rig, "laser.low_mm");
    let moved_mm = after.as_f64().unwrap() - before.as_f64().unwrap();
    assert!((moved_mm + 0.5).abs() < 0.01, "from {before} to {after}");
    assert!(rig.act(&Action::Accept).is_err(), "it is taken once");
    assert_eq!(rig.calibration_page().unwrap(), "virtual false 1 2");
    rig.act(&Action::Save).unwrap();
    assert_eq!(rig.calibration_page().unwrap(), "virtual true 1 2");

    // A vent ends a step, and what it had lent is back.
    rig.act(&Action::Calibrate { step: "valve".to_owned() }).unwrap();
    assert!(until(&mut rig, true, Duration::from_secs(5), |rig| rig.phase == Phase::Running).0);
    rig.act(&Action::Vent).unwrap();
    let told = step(&mut rig, "valve");
    assert!(told["state"] == "failed" && told["problem"] == "it was vented", "{told}");
    assert!(until(&mut rig, false, Duration::from_secs(3), |rig| rig.phase == Phase::Idle && rig.lent.is_empty()).0);
    rig.act(&Action::Revert { defaults: true }).unwrap();
    assert_eq!(setting(&mut rig, "mismatch.pressure_bar"), own);
    assert_eq!(setting(&mut rig, "laser.low_mm"), before);
    assert!(rig.calibration_page().is_err(), "what was found is not in use any more");
}

#[test]
fn a_reference_ends_vented_or_with_its_operator() {
    let mut rig = rig();
    let follow = Action::Follow { controller: "open-loop".to_owned(), reference: json!({ "name": "ramp", "low_mm": 0.5, "high_mm": 2.5 }) };
    let reach = rig.controllers().unwrap()["reach"].clone();
    assert!(reach["source"] == "simulated" && reach["offered_mm"] == json!([0.5, 2.5]), "{reach}");
    assert_eq!(
        rig.reference(&json!({ "name": "ramp", "low_mm": 0.2, "high_mm": 1.0 })).unwrap()["points_mm"].as_array().unwrap().len(),
        100
    );
    for wrong in [
        json!({ "name": "ramp", "low_mm": 2.0, "high_mm": 1.0 }),
        json!({ "name": "ramp", "low_mm": 1.0, "high_mm": 5.0 }),
        json!({ "name": "stairs", "low_mm": 0.0, "high_mm": 1.0 }),
        json!(1),
    ] {
        assert!(rig.reference(&wrong).is_err(), "{wrong}");
        assert!(rig.act(&Action::Follow { controller: "open-loop".to_owned(), reference: wrong }).is_err());
    }
    rig.act(&follow).unwrap();
    let (ended, samples) = until(&mut rig, true, Duration::from_secs(10), |rig| rig.told_task().is_none());
    assert!(ended, "the end of the reference: {:?}", rig.told_task());
    assert!(samples.iter().any(|sample| sample.phase == Phase::Running && sample.set_point > 2.4), "the reference is the set-point");
    let told = rig.controllers().unwrap()["followed"].clone();
    // 0.5 to 2.5 mm at the default of 4 mm/bar, from no pressure.
    let span_bar = told["output_span_bar"].as_f64().unwrap();
    assert!(told["problem"].is_null() && told["rmse_mm"].is_f64() && (0.45..0.7).contains(&span_bar), "{told}");
    rig.act(&follow).unwrap();
    assert!(until(&mut rig, true, Duration::from_secs(5), |rig| rig.phase == Phase::Running).0);
    rig.abandon("the operator left").unwrap();
    assert!(until(&mut rig, false, Duration::from_secs(1), |rig| !rig.phase.is_energised()).0);
    assert_eq!(rig.controllers().unwrap()["followed"]["problem"], "the operator left");
}
