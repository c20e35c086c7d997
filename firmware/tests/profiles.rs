//! The profiles of valves and sensors: their settings go together, their signals read right, and each ends in its safe state.

mod common;

use common::{Bench, Breakage, FACTS, set_point_settings};
use firmware::calibration::Calibration;
use firmware::control::SetPoint;
use firmware::number::MicroBar;
use firmware::tick::{Action, TickConfig, ValveOutput};
use model_export::link::fault::Fault;
use model_export::link::message::Quantity;
use model_export::link::profiles::{PROFILES, Profile};
use model_export::link::settings::Settings;

/// The figure: from the moment a fault can be seen to the safe state.
const SAFE_WITHIN_MS: u32 = 50;

fn with(profile: &Profile) -> Settings {
    let mut settings = set_point_settings();
    profile.apply(&mut settings).unwrap_or_else(|error| panic!("{}: {error:?}", profile.name));
    settings
}

/// Holds 1 bar for half a second.
fn holding(settings: &Settings) -> Bench {
    let mut bench = Bench::new(settings).into_running();
    for _ in 0..50 {
        bench.step_with(Some(Action::SetPoint(SetPoint::Value(Quantity::Pressure, 1.0))));
        bench.run(9);
    }
    assert!(bench.outputs.energised && bench.outputs.output == MicroBar::from_bar(1.0).unwrap(), "{:?}", bench.outputs);
    bench
}

fn code_of(v: f32) -> u16 {
    (v / FACTS.converter.full_scale_v * f32::from(FACTS.converter.full_scale_code)).round() as u16
}

/// After a fault: the drive is at zero and the dump valve without current, and stays so.
fn ends_safe(bench: &mut Bench, breakage: Breakage, fault: Fault, name: &str) {
    bench.breakage = Some(breakage);
    let mut safe_after = None;
    for tick in 1..=500 {
        let outputs = bench.step();
        let safe = outputs.valve_share == 0 && !outputs.energised;
        assert!(safe || safe_after.is_none(), "{name}: {tick}");
        if safe {
            safe_after.get_or_insert(tick);
        }
    }
    assert!(safe_after.is_some_and(|tick| tick <= SAFE_WITHIN_MS), "{name}: {safe_after:?}");
    assert_eq!(bench.first_fault(), fault.number(), "{name}");
}

#[test]
fn every_profile_has_settings_that_go_together_a_source_and_a_name_of_its_own() {
    for (index, profile) in PROFILES.iter().enumerate() {
        assert!(TickConfig { settings: &with(profile), facts: FACTS }.build().is_ok(), "{}", profile.name);
        assert!(!profile.data_sheet.is_empty() && PROFILES[index + 1..].iter().all(|other| other.name != profile.name));
        assert_eq!(profile.is_sensor(), !profile.error_signals.is_empty(), "{}", profile.name);
    }
}

#[test]
fn every_valve_gets_its_drive_and_none_at_all_when_it_vents() {
    for profile in PROFILES.iter().filter(|profile| !profile.is_sensor()) {
        let settings = with(profile);
        let mut bench = holding(&settings);
        let span = settings.valve_highest_share - settings.valve_lowest_share;
        let expected = (settings.valve_lowest_share + span / settings.valve_full_scale_bar) * 65535.0;
        assert!(
            (f32::from(bench.outputs.valve_share) - expected).abs() <= 1.5,
            "{}: {} of {expected}",
            profile.name,
            bench.outputs.valve_share
        );
        let output = bench.rig.built().valve_output();
        assert_eq!(output == ValveOutput::PulseWidth, settings.valve_drive == 1, "{}", profile.name);
        assert_eq!(bench.rig.built().pulse_hz(), settings.pulse_hz);
        ends_safe(&mut bench.clone(), Breakage::EmergencyStop, Fault::EmergencyStop, profile.name);
        ends_safe(&mut bench, Breakage::PressureCode(0), Fault::PressureRange, profile.name);
    }
}

#[test]
fn every_sensor_reads_its_ends_and_each_of_its_error_signals_vents() {
    for profile in PROFILES.iter().filter(|profile| profile.is_sensor()) {
        let settings = with(profile);
        let tick = TickConfig { settings: &settings, facts: FACTS }.build().unwrap();
        let calibration: &Calibration = tick.laser().calibration();
        for (v, mm) in [(settings.laser_low_v, settings.laser_low_mm), (settings.laser_high_v, settings.laser_high_mm)] {
            let code = code_of(v);
            assert!(
                calibration.is_measurement(code) && (calibration.value(code) - mm).abs() <= calibration.resolution(),
                "{}: {v} V",
                profile.name
            );
        }
        let running = holding(&settings);
        for signal in profile.error_signals {
            let code = code_of(profile.circuit.pin_v(*signal));
            assert!(!calibration.is_measurement(code), "{}: {signal}", profile.name);
            ends_safe(&mut running.clone(), Breakage::LaserCode(code), Fault::LaserRange, profile.name);
        }
    }
}

#[test]
fn a_dead_band_without_room_above_it_is_refused() {
    let settings = Settings { valve_lowest_share: 0.5, valve_highest_share: 0.5, ..set_point_settings() };
    assert!(TickConfig { settings: &settings, facts: FACTS }.build().is_err());
}
