//! Tests of the switching selection.

use crate::chain::form::Drive;
use crate::data::noise;
use crate::data::session::Session;
use crate::discover;
use crate::model::initial_state::InitialState;
use crate::model::structure::{Model, Scope};
use crate::result::{DiscoverConfig, Discovery, Verdict};
use crate::selection::switching_likelihood::QuasiStatic;
use crate::tests::deviates;
use recording::{Recording, Signal};
use std::collections::BTreeMap;
use std::path::Path;
use virtual_rig as rig;
use virtual_rig::{CaseConfig, Excitation, Generator};

/// Twelve decaying sines of a closed-form rig: three play operators, and a tip on a stick band of 0.5 mm that jumps by 0.35 mm. The full
/// stroke is about 8 mm and the noise 0.5 % of it. A slip takes `slip_s`, at one speed.
fn stick_band(band_mm: f64, travel_mm: f64, slip_s: f64) -> Vec<Recording> {
    const STEPS: usize = 40;
    let mut noise = deviates(0x2545_F491_4F6C_DD1D);
    let command = |frequency_hz: f64, decay_per_s: f64, time_s: f64| {
        let time_s = (time_s - 2.0_f64).max(0.0);
        1.4 * (-decay_per_s * time_s).exp() * (1.0 - (std::f64::consts::TAU * frequency_hz * time_s).cos())
    };
    let mut record = |index: u32| {
        let (frequency_hz, decay_per_s) = ([0.15, 0.3, 0.5, 0.7][(index % 4) as usize], [0.02, 0.06, 0.12][(index / 4) as usize]);
        let mut plays = [(0.1, 1.2, 0.0), (0.35, 0.9, 0.0), (0.8, 0.9, 0.0)];
        let mut place_mm: f64 = 0.0;
        let (mut way_mm, mut left) = (0.0, 0);
        let slip_steps = ((slip_s / 0.02 * STEPS as f64).round() as usize).max(1);
        let (mut times, mut inputs, mut outputs) = (Vec::new(), Vec::new(), Vec::new());
        for step in 0..1100 * STEPS {
            let time_s = step as f64 * 0.02 / STEPS as f64;
            let input = command(frequency_hz, decay_per_s, time_s);
            let response_mm: f64 = plays
                .iter_mut()
                .map(|(threshold, weight, state)| {
                    *state = f64::max(*state, input - *threshold).min(input + *threshold);
                    *weight * *state
                })
                .sum();
            let stretch_mm = response_mm - place_mm;
            if band_mm <= 0.0 {
                place_mm = response_mm;
            } else if left == 0 && stretch_mm.abs() > band_mm {
                (way_mm, left) = (stretch_mm.signum() * (stretch_mm.abs() - band_mm + travel_mm) / slip_steps as f64, slip_steps);
            }
            if left > 0 {
                (place_mm, left) = (place_mm + way_mm, left - 1);
            }
            if step % STEPS == 0 {
                times.push(time_s);
                inputs.push(input);
                outputs.push(place_mm + 0.035 * noise());
            }
        }
        let path = format!("run{index:02}.csv");
        Recording::new(Path::new(&path), Signal::pressure_bar(), Signal::displacement_mm(), times, inputs, outputs).expect("a recording")
    };
    (0..12).map(&mut record).collect()
}

fn found(recordings: &[Recording]) -> Discovery {
    discover(recordings, &[], &DiscoverConfig { most_effects: 1, ..DiscoverConfig::default() }).expect("a finding").discovery
}

#[test]
fn a_stick_band_in_closed_form_is_named_with_its_travel() {
    let (band_mm, travel_mm) = (0.5, 0.35);
    let discovery = found(&stick_band(band_mm, travel_mm, 0.0));
    assert_eq!(discovery.verdict, Verdict::Named, "{:?}", discovery.effects);
    assert_eq!(discovery.effects[0].name, "stick-slip");
    let parameters: &BTreeMap<String, f64> = &discovery.effects[0].parameters;
    let found_mm = parameters["travel_mm"];
    assert!((found_mm / travel_mm - 1.0).abs() < 0.05, "{found_mm} instead of {travel_mm}; {parameters:?}");
    let closed = discovery.gap_closed_one_step.expect("figures of the observers");
    assert!(closed > 0.5, "{closed}");
}

#[test]
fn the_ladder_of_laws_tells_slips_that_take_several_samples_from_slips_at_once() {
    for slip_s in [0.0, 0.06] {
        let session = Session::new(&stick_band(0.5, 0.35, slip_s), &[]).expect("a session");
        let mut model = Model::baseline(InitialState::Fresh, false).refined();
        model.fit(&session, Scope::Both);
        let noise = noise::floor(&session, &model.residuals(&session));
        let law = QuasiStatic::new(&session, &model, noise, false).law(Drive::QuasiStatic, 0.0);
        // To a sample: the response that it stands on is fitted as if what jumps were noise.
        assert!((law.slip_s - slip_s).abs() < 0.02, "{} s instead of {slip_s} s", law.slip_s);
    }
}

#[test]
fn without_a_band_the_same_rig_has_no_jumps() {
    let discovery = found(&stick_band(0.0, 0.0, 0.0));
    assert_eq!(discovery.verdict, Verdict::None, "{:?}", discovery.effects);
}

#[test]
fn what_jumps_is_named_beside_what_does_not() {
    // A large smooth effect beside which the jumps are a twelfth of the energy, one that the quasi-static response alone shows, and a heart behind the tip.
    let cases = [
        (Generator::Rival, "slew-limit", 343),
        (Generator::Physics, "setup-change", 326),
        (Generator::Physics, "periodic-disturbance", 325),
    ];
    for (generator, beside, seed) in cases {
        let effects = vec!["stick-slip".to_owned(), beside.to_owned()];
        let case = rig::hide(&CaseConfig { effects, seed, generator, ..CaseConfig::default() }).expect("a case");
        let discovery = found(&case.recordings);
        let mut names: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
        names.sort_unstable();
        assert_eq!(names, [beside, "stick-slip"], "{generator:?}: {discovery:?}");
        // Beside a limit of the rate a valve gains three quarters of what the tip gains, more or less: then that has a confidence of a half.
        let least = if beside == "slew-limit" { 0.4 } else { 0.9 };
        let sticks = discovery.effects.iter().find(|effect| effect.name == "stick-slip").map_or(0.0, |effect| effect.confidence);
        assert!(sticks > least && discovery.verdict != Verdict::Unknown, "{generator:?}, {beside}: {discovery:?}");
        assert_eq!(discovery.verdict == Verdict::Named, sticks > 0.5, "{generator:?}, {beside}: {discovery:?}");
    }
}

#[test]
fn stick_slip_is_named_through_steps_of_many_slips_and_fast_strokes() {
    for (generator, seed) in [(Generator::Physics, 572), (Generator::Rival, 575)] {
        let effects = vec!["stick-slip".to_owned()];
        let case = CaseConfig { effects, seed, generator, excitation: Excitation::Rich, ..CaseConfig::default() };
        let discovery = found(&rig::hide(&case).expect("a case").recordings);
        let names: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
        assert_eq!(names, ["stick-slip"], "{generator:?}: {discovery:?}");
        assert_ne!(discovery.verdict, Verdict::Unknown, "{generator:?}: {discovery:?}");
        assert!(discovery.gap_closed_one_step.is_some_and(|closed| closed > 0.6), "{generator:?}: {discovery:?}");
    }
}

#[test]
fn what_jumps_in_either_virtual_rig_is_named() {
    let cases = [
        (Generator::Physics, "stick-slip", 531),
        (Generator::Physics, "valve-dead-band", 530),
        (Generator::Rival, "stick-slip", 530),
        (Generator::Rival, "valve-dead-band", 530),
    ];
    for (generator, effect, seed) in cases {
        let case = rig::hide(&CaseConfig { effects: vec![effect.to_owned()], seed, generator, ..CaseConfig::default() }).expect("a case");
        let discovery = found(&case.recordings);
        let name = discovery.effects.first().map(|effect| effect.name.as_str());
        assert_eq!(name, Some(effect), "{generator:?}: {discovery:?}");
        assert_ne!(discovery.verdict, Verdict::Unknown, "{generator:?}, {effect}: {discovery:?}");
    }
}
