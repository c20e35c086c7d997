//! The rig is deterministic, hides what it says and knows every name of the vocabulary.

use super::*;

fn case(effects: &[&str], seed: u64, noise: f64) -> Case {
    let effects = effects.iter().map(|name| (*name).to_owned()).collect();
    hide(&CaseConfig { effects, seed, noise, ..CaseConfig::default() }).expect("a case")
}

#[test]
fn equal_seeds_give_equal_recordings_and_other_seeds_do_not() {
    let (first, second, third) = (case(&["creep"], 3, 0.005), case(&["creep"], 3, 0.005), case(&["creep"], 4, 0.005));
    assert_eq!(first.recordings, second.recordings);
    assert_ne!(first.recordings[0].output, third.recordings[0].output);
}

#[test]
fn every_effect_changes_the_recordings_by_more_than_half_a_percent_of_range() {
    let plain = case(&[], 11, 0.0);
    for name in EFFECTS.iter().chain(&ALIENS) {
        let hidden = case(&[name], 11, 0.0);
        let pairs = plain.recordings.iter().zip(&hidden.recordings);
        let (mut sum, mut count, mut top) = (0.0, 0, 0.0_f64);
        for (before, after) in pairs {
            for (x, y) in before.output.iter().zip(&after.output) {
                assert!(y.is_finite(), "{name} made a value that is not finite");
                sum += (x - y).powi(2);
                count += 1;
                top = top.max(*x);
            }
        }
        let share = (sum / f64::from(count)).sqrt() / top;
        assert!(share > 0.004, "{name} changes the output by {share:.5} of range");
        assert!(share < 0.6, "{name} changes the output by {share:.5} of range");
    }
}

#[test]
fn the_noise_has_the_size_asked_for() {
    for coloured_noise in [false, true] {
        let config = |noise| CaseConfig { seed: 5, noise, coloured_noise, excitation: Excitation::Rich, ..CaseConfig::default() };
        let (clean, noisy) = (hide(&config(0.0)).expect("a case"), hide(&config(0.005)).expect("a case"));
        let mut sum = 0.0;
        let mut count = 0.0;
        for (x, y) in clean.recordings.iter().zip(&noisy.recordings) {
            sum += x.output.iter().zip(&y.output).map(|(x, y)| (x - y).powi(2)).sum::<f64>();
            count += x.output.len() as f64;
        }
        // 26,400 samples, a tenth of that independent when coloured: 3 % is more than three standard deviations.
        let deviation = (sum / count).sqrt();
        assert!((deviation / noisy.truth.noise_mm - 1.0).abs() < 0.03, "{deviation} instead of {}", noisy.truth.noise_mm);
    }
}

#[test]
fn an_unknown_name_is_refused() {
    let config = CaseConfig { effects: vec!["magnetism".into()], ..CaseConfig::default() };
    let message = hide(&config).expect_err("no such effect").to_string();
    assert!(message.contains("magnetism") && message.contains("creep"), "{message}");
}

#[test]
fn every_effect_of_the_other_rigs_changes_their_recordings_too() {
    [Generator::Rival, Generator::ComposedTuning, Generator::ComposedReporting]
        .into_iter()
        .for_each(every_effect_changes_the_recordings_of);
}

fn every_effect_changes_the_recordings_of(generator: Generator) {
    let make =
        |effects: Vec<String>| hide(&CaseConfig { effects, seed: 11, noise: 0.0, generator, ..CaseConfig::default() }).expect("a case");
    let plain = make(Vec::new());
    let top = plain.recordings.iter().flat_map(|run| &run.output).copied().fold(0.0, f64::max);
    for name in EFFECTS.iter().chain(generator.aliens()) {
        let hidden = make(vec![(*name).to_owned()]);
        let (mut sum, mut count) = (0.0, 0.0);
        for (before, after) in plain.recordings.iter().zip(&hidden.recordings) {
            assert!(after.output.iter().all(|value| value.is_finite()), "{generator:?}: {name} made a value that is not finite");
            sum += before.output.iter().zip(&after.output).map(|(x, y)| (x - y).powi(2)).sum::<f64>();
            count += before.output.len() as f64;
        }
        let share = (sum / count).sqrt() / top;
        assert!((0.004..0.6).contains(&share), "{generator:?}: {name} changes the output by {share:.5} of range");
    }
}

#[test]
fn the_sets_of_laws_share_the_muscle_and_no_effect() {
    let make = |effect: &str, generator| {
        let effects = vec![effect.to_owned()];
        hide(&CaseConfig { effects, seed: 12, noise: 0.0, generator, ..CaseConfig::default() }).expect("a case")
    };
    for name in EFFECTS.iter().filter(|name| !["dead-time", "clock-skew", "outliers"].contains(name)) {
        let [tuning, reporting] = [Generator::ComposedTuning, Generator::ComposedReporting].map(|generator| make(name, generator));
        assert_eq!(tuning.truth.slack_bar, reporting.truth.slack_bar, "{name}");
        let alike = |one: &Case, other: &Case| one.recordings.iter().zip(&other.recordings).all(|(x, y)| x.output == y.output);
        assert!(!alike(&tuning, &reporting), "{name} has the same law in both sets");
        assert!(alike(&tuning, &make(name, Generator::ComposedTuning)), "{name}: equal seeds, equal recordings");
    }
}

#[test]
fn a_tip_that_slips_fast_over_little_friction_stays_on_its_band() {
    use stages::{LuGreTip, Stage};
    for static_mm in [0.002, 0.02, 0.2, 1.0] {
        let mut tip = LuGreTip::stiff(static_mm, 0.2 * static_mm);
        for response_mm in [5.0, -5.0, 0.1, 10.0] {
            let still = Moment { session_s: 0.0, recording: 0 };
            let place_mm = (0..10_000).map(|_| tip.step(response_mm, &still)).last().unwrap_or(f64::NAN);
            assert!((place_mm - response_mm).abs() <= 1.01 * static_mm, "{static_mm}: {place_mm} at {response_mm}");
        }
    }
}

#[test]
fn rubber_heals_in_the_pause_whatever_the_line_held_before() {
    let hidden = |effects: &[&str], seed| {
        let effects = effects.iter().map(|&name| name.to_owned()).collect();
        hide(&CaseConfig { effects, seed, noise: 0.0, excitation: Excitation::Rich, ..CaseConfig::default() }).expect("a case")
    };
    let soft = |seed| hidden(&["first-cycle-softening"], seed);
    let case = (520..540).map(soft).find(|case| !case.truth.continuous).expect("a muscle that forgets");
    let fresh = hidden(&[], case.truth.seed);
    let of = |name: &str| case.truth.parameters[&format!("first-cycle-softening.{name}")];
    for (soft, plain) in case.recordings.iter().zip(&fresh.recordings) {
        let top = plain.output.iter().copied().fold(0.0, f64::max);
        let first = plain.output.iter().position(|value| *value > 0.1 * top).expect("a stroke");
        let expected = 1.0 - of("missing_gain") * (-plain.output[first] / of("distance_mm")).exp();
        let ratio = soft.output[first] / plain.output[first];
        assert!((ratio - expected).abs() < 0.01, "{}: {ratio} instead of {expected}", soft.path.display());
    }
}

#[test]
fn a_muscle_that_forgets_begins_every_recording_at_rest_whatever_the_line_held_before() {
    let effects = vec!["pneumatic-lag".to_owned()];
    let hidden = |seed| hide(&CaseConfig { effects: effects.clone(), seed, noise: 0.0, ..CaseConfig::default() }).expect("a case");
    // A slow line before the muscle still holds pressure when a recording ends, and lets it go before the next.
    let slow = |case: &Case| {
        !case.truth.continuous && case.truth.sensor_side.is_empty() && case.truth.parameters["pneumatic-lag.time_constant_s"] > 0.2
    };
    let case = (520..560).map(hidden).find(slow).expect("a slow line before a muscle that forgets");
    let top = case.recordings.iter().flat_map(|run| &run.output).copied().fold(0.0, f64::max);
    for recording in &case.recordings {
        let rest = recording.output[..50].iter().copied().fold(0.0, |most: f64, value| most.max(value.abs()));
        assert!(rest < 1e-6 * top, "seed {}: {} begins at {rest} mm of {top} mm", case.truth.seed, recording.path.display());
    }
}

#[test]
fn a_muscle_that_remembers_has_been_through_nothing_that_no_recording_tells() {
    let hidden = |seed| {
        let config = CaseConfig { seed, noise: 0.0, excitation: Excitation::Rich, generator: Generator::Rival, ..CaseConfig::default() };
        hide(&config).expect("a case")
    };
    for case in (40..60).map(hidden).filter(|case| case.truth.continuous).take(3) {
        let range = case.recordings.iter().flat_map(|recording| &recording.output).fold(0.0_f64, |top, value| top.max(*value));
        let mut states = vec![0.0; case.truth.slack_bar.len()];
        for recording in &case.recordings {
            let mut first = None;
            for &input in &recording.input {
                for (state, slack) in states.iter_mut().zip(&case.truth.slack_bar) {
                    *state = f64::max(input - slack, *state).min(input + slack);
                }
                first.get_or_insert_with(|| {
                    states.iter().zip(&case.truth.pull_mm_per_bar).map(|(state, weights)| state * weights).sum::<f64>()
                });
            }
            // Peaks between two samples are missed by up to 0.16 % of the span; strokes after the last sample had moved it by ten times that.
            let off = (first.expect("samples") - recording.output[0]).abs() / range;
            assert!(off < 0.002, "seed {}, {}: {off} of the range", case.truth.seed, recording.path.display());
        }
    }
}
