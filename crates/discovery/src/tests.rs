//! What discovery promises: it names what was hidden, keeps quiet when nothing was, and repeats itself.

use std::collections::BTreeMap;
use std::path::Path;

use virtual_rig::{self as rig, Case, CaseConfig, Generator};

use crate::data::{mask, noise};
use crate::model::structure::Scope;
use crate::selection::find;
use recording::{Channel, ExtraColumn, Recording, Signal};

use super::*;

/// Seeds of these tests; tuning used 100 to 199, figures are reported on 1000 and above.
const SEED: u64 = 500;

/// A session of one recording whose output is its input, a function of the time, s.
pub fn session_of(samples: u32, period_s: f64, input: impl Fn(f64) -> f64) -> Session {
    let time_s: Vec<f64> = (0..samples).map(|sample| f64::from(sample) * period_s).collect();
    let input: Vec<f64> = time_s.iter().map(|time_s| input(*time_s)).collect();
    let signals = (Signal::pressure_bar(), Signal::displacement_mm());
    let recording = Recording::new(Path::new("run.csv"), signals.0, signals.1, time_s, input.clone(), input);
    Session::new(&[recording.expect("a recording")], &[]).expect("a session")
}

/// Nearly normal deviates of unit variance, the same for equal seeds: the sum of twelve uniform ones (xorshift; Marsaglia 2003).
pub fn deviates(seed: u64) -> impl FnMut() -> f64 {
    let mut kept = seed;
    move || {
        (0..12).fold(-6.0, |sum, _| {
            kept ^= kept << 13;
            kept ^= kept >> 7;
            kept ^= kept << 17;
            sum + (kept >> 11) as f64 / (1_u64 << 53) as f64
        })
    }
}

fn case(effects: &[&str], seed: u64, noise: f64) -> Case {
    let effects = effects.iter().map(|name| (*name).to_owned()).collect();
    rig::hide(&CaseConfig { effects, seed, noise, ..CaseConfig::default() }).expect("a case")
}

fn found(case: &Case) -> Discovery {
    // One effect is hidden; a second round is what the verdict must survive.
    discover(&case.recordings, &case.kept_out, &DiscoverConfig { most_effects: 2, ..DiscoverConfig::default() })
        .expect("a finding")
        .discovery
}

#[test]
fn names_a_hidden_dead_time_with_its_delay_and_closes_the_gap() {
    let case = case(&["dead-time"], SEED, 0.005);
    let discovery = found(&case);
    assert_eq!(discovery.verdict, Verdict::Named, "{discovery:?}");
    assert_eq!(discovery.effects.len(), 1);
    assert_eq!(discovery.effects[0].name, "dead-time");
    let (delay_s, truth_s) = (discovery.effects[0].parameters["delay_s"], case.truth.parameters["dead-time.delay_s"]);
    assert!((delay_s / truth_s - 1.0).abs() < 0.05, "{delay_s} instead of {truth_s}");
    assert!(discovery.gap_closed > 0.97, "{}", discovery.gap_closed);
    assert!(discovery.rmse_before > 2.0 * discovery.rmse_after);
}

/// The recordings of a case with a second muscle beside the first: play operators of a command of its own, which bend it the other way.
fn with_a_second_muscle(recordings: &[Recording]) -> Vec<Recording> {
    let beside = |(index, recording): (usize, &Recording)| {
        let speed = 0.5 + 0.37 * (index % 7) as f64;
        let command: Vec<f64> = recording.time_s.iter().map(|time| 1.0 - (-0.05 * time).exp() * (speed * time).cos()).collect();
        let mut recording = recording.clone();
        for (threshold, weight) in [(0.0, 0.3), (0.2, 0.25), (0.6, 0.2)] {
            let mut state = command[0];
            for (output, &value) in recording.output.iter_mut().zip(&command) {
                state = f64::clamp(state, value - threshold, value + threshold);
                *output -= weight * state;
            }
        }
        recording.with_more_inputs(vec![Channel { signal: Signal { quantity: "second".into(), unit: "bar".into() }, values: command }])
    };
    recordings.iter().enumerate().map(beside).collect()
}

#[test]
fn an_effect_behind_one_of_two_inputs_is_named_and_the_model_that_is_written_needs_both() {
    for (hidden, seed) in [(&["pneumatic-lag"][..], SEED + 40), (&[], SEED + 41)] {
        let case = case(hidden, seed, 0.005);
        let [recordings, kept] = [&case.recordings, &case.kept_out].map(|some| with_a_second_muscle(some));
        let finding = discover(&recordings, &kept, &DiscoverConfig::default()).expect("a finding");
        let discovery = &finding.discovery;
        let names: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
        assert_eq!(names, hidden, "{discovery:?}");
        assert_eq!(discovery.verdict, if hidden.is_empty() { Verdict::None } else { Verdict::Named }, "{discovery:?}");
        assert!(discovery.rmse_after < 1.3 * discovery.noise_floor, "{} {}", discovery.rmse_after, discovery.noise_floor);
        // As `evaluate` has it, from the file.
        let written = file::DiscoveredModel::bare(&finding.after, &finding.session, &recordings[0]);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("model.toml");
        std::fs::write(&path, written.encode().expect("TOML")).expect("a file");
        let read = file::DiscoveredModel::read(&path).expect("a model");
        let (mut sum, mut count) = (0.0, 0.0_f64);
        for recording in &kept {
            let simulated = read.simulate_recording(recording, 0.0).expect("a prediction");
            sum += simulated.iter().zip(&recording.output).map(|(one, other)| (one - other).powi(2)).sum::<f64>();
            count += simulated.len() as f64;
        }
        assert!(((sum / count).sqrt() / discovery.rmse_after - 1.0).abs() < 1e-9, "{} {}", (sum / count).sqrt(), discovery.rmse_after);
        assert!(read.simulate(&kept[0].input).expect_err("refused").contains("2 inputs"));
        assert!(read.simulate_recording(&case.kept_out[0], 0.0).expect_err("refused").contains("was given 1"));
    }
}

#[test]
fn recordings_with_other_inputs_than_the_first_are_refused_with_both() {
    let mut case = case(&[], SEED, 0.005);
    case.kept_out[1] = with_a_second_muscle(&case.kept_out[1..2]).remove(0);
    let name = case.kept_out[1].path.display().to_string();
    let refusal = discover(&case.recordings, &case.kept_out, &DiscoverConfig::default()).err().expect("a refusal").to_string();
    assert!([&name, "second", "first recording"].iter().all(|part| refusal.contains(*part)), "{refusal}");
}

#[test]
fn names_nothing_when_nothing_is_hidden() {
    let discovery = found(&case(&[], SEED + 1, 0.005));
    assert_eq!(discovery.verdict, Verdict::None, "{discovery:?}");
    assert!(discovery.effects.is_empty());
    // The noise is known: half a percent of the range, and 26,000 samples tell it to a few percent.
    assert!((discovery.rmse_after / discovery.noise_floor - 1.0).abs() < 0.1, "{} {}", discovery.rmse_after, discovery.noise_floor);
}

#[test]
fn coloured_noise_alone_is_no_unknown_effect() {
    // What the play operators of the second rig leave of coloured noise is worse on the test recordings: where nothing was found, that
    // is no reason to look for something unknown.
    let config = CaseConfig { seed: SEED + 1, coloured_noise: true, generator: Generator::Rival, ..CaseConfig::default() };
    let discovery = found(&rig::hide(&config).expect("a case"));
    assert_eq!(discovery.verdict, Verdict::None, "{discovery:?}");
}

#[test]
fn names_what_another_rig_with_other_laws_hides() {
    for (effect, seed) in [("pneumatic-lag", SEED + 20), ("supply-saturation", SEED + 21)] {
        let config = CaseConfig { effects: vec![effect.to_owned()], seed, generator: Generator::Rival, ..CaseConfig::default() };
        let case = rig::hide(&config).expect("a case");
        let config = DiscoverConfig { most_effects: 1, ..DiscoverConfig::default() };
        let discovery = discover(&case.recordings, &case.kept_out, &config).expect("a finding").discovery;
        assert_eq!(discovery.effects.first().map(|effect| effect.name.as_str()), Some(effect), "seed {seed}: {discovery:?}");
        assert!(discovery.gap_closed > 0.97, "seed {seed}: {}", discovery.gap_closed);
        assert!(discovery.rmse_after < 1.2 * discovery.noise_floor, "seed {seed}: {} mm", discovery.rmse_after);
    }
}

#[test]
fn names_two_effects_where_the_best_single_one_is_neither() {
    // What a drift of the gain and a small lag do together looks most like a drift of the zero.
    let effects: Vec<String> = ["pneumatic-lag", "gain-drift"].map(str::to_owned).into();
    let case = rig::hide(&CaseConfig { effects: effects.clone(), seed: SEED + 50, generator: Generator::Rival, ..CaseConfig::default() });
    let case = case.expect("a case");
    let finding = discover(&case.recordings, &case.kept_out, &DiscoverConfig::default()).expect("a finding");
    let discovery = finding.discovery;
    assert!(!effects.contains(&discovery.candidates[0].name), "this case would be no test: {:?}", discovery.candidates[0]);
    let mut named: Vec<&String> = discovery.effects.iter().map(|effect| &effect.name).collect();
    named.sort();
    assert_eq!(named, [&effects[1], &effects[0]], "{discovery:?}");
    assert_eq!(discovery.verdict, Verdict::Named);
    assert!(discovery.unexplained < 0.02, "{discovery:?}");
}

#[test]
fn names_a_slow_rhythm_that_passes_for_noise_beside_a_dead_time() {
    // 0.91 Hz, of one and a half times the noise's energy: at rest it raises what counts as noise to all that the dead time leaves.
    let case = case(&["periodic-disturbance", "dead-time"], 1302, 0.005);
    let config = DiscoverConfig { most_effects: 2, ..DiscoverConfig::default() };
    let discovery = discover(&case.recordings, &case.kept_out, &config).expect("a finding").discovery;
    let named: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
    assert_eq!(named, ["dead-time", "periodic-disturbance"], "{discovery:?}");
    let frequency_hz = discovery.effects[1].parameters["frequency_hz"];
    assert!((frequency_hz / case.truth.parameters["periodic-disturbance.frequency_hz"] - 1.0).abs() < 0.01, "{frequency_hz}");
    assert!((discovery.noise_floor / case.truth.noise_mm - 1.0).abs() < 0.05, "{}", discovery.noise_floor);
}

#[test]
fn operators_that_remember_remember_what_a_slow_valve_made_of_earlier_recordings() {
    let hidden = |seed| {
        let effects = vec!["pneumatic-lag".to_owned()];
        rig::hide(&CaseConfig { effects, seed, generator: Generator::Rival, ..CaseConfig::default() }).expect("a case")
    };
    let slow = |case: &Case| case.truth.continuous && case.truth.parameters["pneumatic-lag.time_constant_s"] > 0.15;
    let case = (SEED + 60..SEED + 100).map(hidden).find(slow).expect("a slow valve before a muscle that remembers");
    let session = Session::new(&case.recordings, &[]).expect("a session");
    let lag = effects::pneumatic_lag::FORMS[0];
    let left = |carry: bool| {
        let time_s = case.truth.parameters["pneumatic-lag.time_constant_s"];
        let mut model = Model::baseline(InitialState::carrying(carry), false).with(lag, vec![time_s]).refined();
        model.fit(&session, Scope::Both).1.sqrt() * session.output_scale.abs() / case.truth.noise_mm
    };
    let (remembers, forgets) = (left(true), left(false));
    assert!(remembers < 1.1 && forgets > 1.3 * remembers, "seed {}: {remembers} and {forgets} times the noise", case.truth.seed);
}

#[test]
fn a_measured_pressure_tells_the_pneumatics_from_the_rest() {
    let discovery = |effect: &str| {
        let effects = vec![effect.to_owned()];
        let config = CaseConfig { effects, seed: SEED + 40, measured_pressure: true, ..CaseConfig::default() };
        let mut case = rig::hide(&config).expect("a case");
        case.recordings.truncate(12);
        let config = DiscoverConfig { most_effects: 1, ..DiscoverConfig::default() };
        discover(&case.recordings, &case.kept_out, &config).expect("a finding").discovery
    };
    // Two orifices lie before the sensor of the pressure: its recording shows them, and so does the displacement.
    let named = discovery("fill-vent-asymmetry");
    assert_eq!(named.pressure_path.as_deref(), Some(&["fill-vent-asymmetry".to_owned()][..]), "{named:?}");
    assert_eq!(named.effects.first().map(|effect| effect.name.as_str()), Some("fill-vent-asymmetry"));
    // A swinging tip lies behind it: the pressure follows the command, and no pneumatic effect is even tried on the displacement.
    let named = discovery("resonance");
    assert_eq!(named.pressure_path.as_deref(), Some(&[][..]), "{named:?}");
    assert_eq!(named.effects.first().map(|effect| effect.name.as_str()), Some("resonance"));
    assert!(named.candidates.iter().all(|candidate| !find::PNEUMATIC.contains(&candidate.name.as_str())), "{:?}", named.candidates);
}

#[test]
fn motion_during_rest_does_not_pass_for_noise() {
    let mut case = case(&[], SEED + 6, 0.005);
    case.recordings.truncate(6);
    let floor = |recordings: &[Recording]| {
        let session = Session::new(recordings, &[]).expect("a session");
        let mut before = Model::baseline(InitialState::Fresh, false);
        before.fit(&session, Scope::Fit);
        noise::floor(&session, &before.residuals(&session)) * session.output_scale.abs()
    };
    let quiet = floor(&case.recordings);
    assert!((quiet / case.truth.noise_mm - 1.0).abs() < 0.15, "{quiet} instead of {}", case.truth.noise_mm);
    // Something unseen quasi-static responses at 0.9 Hz, ten times the noise.
    for recording in &mut case.recordings {
        for (value, time_s) in recording.output.iter_mut().zip(&recording.time_s) {
            *value += 10.0 * case.truth.noise_mm * (5.65 * time_s).sin();
        }
    }
    let moved = floor(&case.recordings);
    assert!(moved < 1.5 * quiet, "{moved} where {quiet} is noise");
    // A pump of twice the noise at 6.3 Hz is too fast and too small for that, and stands in the spectrum as a line; a heart swings.
    for (coloured_noise, hz) in [(true, 6.3), (false, 1.36)] {
        let mut case = rig::hide(&CaseConfig { seed: SEED + 6, coloured_noise, ..CaseConfig::default() }).expect("a case");
        let quiet = floor(&case.recordings);
        assert!((quiet / case.truth.noise_mm - 1.0).abs() < 0.15, "{quiet} instead of {}", case.truth.noise_mm);
        for recording in &mut case.recordings {
            let start_s = recording.extra[0].values[0];
            for (value, time_s) in recording.output.iter_mut().zip(&recording.time_s) {
                *value += 2.0 * case.truth.noise_mm * (std::f64::consts::TAU * hz * (start_s + time_s)).sin();
            }
        }
        let moved = floor(&case.recordings);
        assert!(moved < 1.2 * quiet, "{hz} Hz: {moved} where {quiet} is noise");
    }
}

/// A triangle of so many strokes in 20 s, each followed by a rest if `rests`, and what becomes of the command; a play operator, and noise.
fn strokes_behind(mut stage: impl FnMut(f64) -> f64, strokes: u32, rests: bool, falling: f64) -> Recording {
    let command = |time_s: f64| {
        let place = (time_s / 20.0 * f64::from(strokes)).max(0.0);
        let share = place.fract() * if rests { 2.0 } else { 1.0 };
        let peak = 1.0 - falling * f64::from(place as u32 / 2);
        peak * if (place as u32).is_multiple_of(2) { share.min(1.0) } else { 1.0 - share.min(1.0) }
    };
    let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
    let input = time_s.iter().map(|&time_s| command(time_s)).collect();
    let (mut state, mut random) = (0.0, 1_u32);
    let output = time_s.iter().map(|&time_s| {
        let value = stage(command(time_s));
        state = f64::clamp(state, value - 0.1, value + 0.1);
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        0.5 * (value + state) + 0.01 * (f64::from(random) / f64::from(u32::MAX) - 0.5)
    });
    let output = output.collect();
    Recording::new("run.csv".as_ref(), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output).expect("a recording")
}

#[test]
fn where_nothing_is_found_the_model_is_the_same_before_and_after() {
    // A limit of four fifths of the command's speed: one stroke shows nothing of it for sure, and two do not confirm it.
    let behind_a_limit = |strokes: u32| {
        let (mut value, most) = (0.0_f64, 0.0008 * f64::from(strokes));
        let limited = |command: f64| {
            value += (command - value).clamp(-most, most);
            value
        };
        discover(&[strokes_behind(limited, strokes, false, 0.0)], &[], &DiscoverConfig::default()).expect("a finding").discovery
    };
    let two = behind_a_limit(2);
    assert!(two.verdict == Verdict::Ambiguous && two.effects[0].name == "slew-limit" && two.effects[0].confidence <= 0.5, "{two:?}");
    let discovery = behind_a_limit(1);
    assert!(discovery.effects.is_empty() && discovery.stands_out(), "{discovery:?}");
    assert_eq!(discovery.rmse_after.to_bits(), discovery.rmse_before.to_bits());
}

#[test]
fn a_few_strokes_confirm_nothing() {
    // So many strokes, rests between them, how much lower each peak is than the one before, and how many of the strokes are unlike all before.
    for (strokes, rests, falling, unlike) in
        [(2, false, 0.0, 2), (4, true, 0.04, 4), (12, false, 0.04, 12), (11, true, 0.04, 11), (12, true, 0.0, 2)]
    {
        let recording = strokes_behind(|command| command.min(0.7), strokes, rests, falling);
        let discovery = discover(&[recording], &[], &DiscoverConfig::default()).expect("a finding").discovery;
        let sure = discovery.effects.iter().map(|effect| effect.confidence).fold(0.0, f64::max);
        assert_eq!([discovery.strokes, discovery.unlike_strokes], [strokes as usize, unlike]);
        assert_eq!(discovery.few_strokes, unlike < 6);
        assert!(discovery.effects.iter().any(|effect| effect.name == "supply-saturation"), "{discovery:?}");
        if discovery.few_strokes {
            assert!(sure <= 0.5 && discovery.verdict == Verdict::Ambiguous, "{strokes} strokes: {discovery:?}");
        } else {
            assert!(sure > 0.9 && discovery.verdict == Verdict::Named, "{strokes} strokes: {discovery:?}");
        }
    }
}

#[test]
fn does_not_name_an_effect_outside_the_catalogue() {
    let discovery = found(&case(&["alien-loose-joint"], SEED + 2, 0.005));
    assert!(matches!(discovery.verdict, Verdict::Unknown | Verdict::Ambiguous), "{discovery:?}");
}

#[test]
fn equal_recordings_give_equal_results_whatever_the_threads() {
    let mut case = case(&["pneumatic-lag"], SEED + 3, 0.01);
    case.recordings.truncate(6);
    let run = |threads| {
        let config = DiscoverConfig { threads, most_effects: 1, seed: 4 };
        let finding = discover(&case.recordings, &case.kept_out, &config).expect("a finding");
        serde_json::to_string(&finding.discovery).expect("JSON")
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn masks_spikes_and_leaves_a_true_step_alone() {
    let mut case = case(&[], SEED + 4, 0.002);
    case.recordings.truncate(6);
    let spiked = [200, 500, 501, 900];
    for &at in &spiked {
        case.recordings[2].output[at] += 4.0;
    }
    let mut session = Session::new(&case.recordings, &[]).expect("a session");
    let outputs: Vec<Vec<f64>> = session.runs.iter().map(|run| run.output.clone()).collect();
    assert_eq!(mask::outliers(&mut session, &outputs, mask::Residual::Output), spiked.len());
    assert!(spiked.iter().all(|&at| !session.runs[2].keep[at]));
    // A step of the output that stays is a step, not an outlier.
    for value in &mut case.recordings[3].output[600..] {
        *value += 4.0;
    }
    let mut session = Session::new(&case.recordings, &[]).expect("a session");
    let outputs: Vec<Vec<f64>> = session.runs.iter().map(|run| run.output.clone()).collect();
    mask::outliers(&mut session, &outputs, mask::Residual::Output);
    assert!(session.runs[3].keep.iter().all(|keep| *keep));
}

#[test]
fn the_steps_of_a_coarse_sensor_are_noise_and_a_fine_one_has_none() {
    let mut case = case(&[], SEED + 5, 0.002);
    let fine = Session::new(&case.recordings, &[]).expect("a session");
    assert!(fine.output_step < 1e-4, "{}", fine.output_step);
    let step = 0.02 * fine.output_scale;
    for value in case.recordings.iter_mut().chain(&mut case.kept_out).flat_map(|recording| &mut recording.output) {
        *value = (*value / step).round() * step;
    }
    let finding = discover(&case.recordings, &case.kept_out, &DiscoverConfig::default()).expect("a finding");
    let found = &finding.discovery;
    assert!((finding.session.output_step * finding.session.output_scale / step - 1.0).abs() < 1e-6);
    // At rest the sensor reads the same over and over; the noise is what the steps do to everything that moves.
    assert!((found.noise_floor / found.rmse_after - 1.0).abs() < 0.1, "{} is not {}", found.noise_floor, found.rmse_after);
    assert!(found.noise_floor > 0.2 * step, "{} of {step}", found.noise_floor);
    assert_eq!(found.verdict, Verdict::None, "{:?}", found.effects);
}

#[test]
fn a_kept_out_recording_about_when_the_set_up_changed_has_no_say_and_the_change_keeps_its_name() {
    use rand::{RngExt, SeedableRng};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(SEED);
    // Ten recordings, one every minute; the sensor is moved before or after the sixth, which is kept out with the second.
    for moved in [5.5, 4.5] {
        let recordings: Vec<Recording> = (0..10)
            .map(|number| {
                let time_s: Vec<f64> = (0..400).map(|sample| f64::from(sample) * 0.02).collect();
                let input: Vec<f64> = time_s.iter().map(|time| (1.0 - 0.05 * f64::from(number)) * (1.0 - (3.0 * time).cos())).collect();
                let shift = if f64::from(number) > moved { 0.3 } else { 0.0 };
                let output = input.iter().map(|value| value + shift + 0.02 * rng.random_range(-1.0..1.0)).collect();
                let session_s = time_s.iter().map(|time| time + 60.0 * f64::from(number)).collect();
                let path = format!("number_{number}.csv");
                let signals = (recording::Signal::pressure_bar(), recording::Signal::displacement_mm());
                let recording = Recording::new(std::path::Path::new(&path), signals.0, signals.1, time_s, input, output);
                let extra = vec![ExtraColumn { name: "session_time_s".to_owned(), values: session_s }];
                Recording { extra, ..recording.expect("a recording") }
            })
            .collect();
        let kept: Vec<Recording> = [1, 5].map(|number| recordings[number].clone()).to_vec();
        let learnt: Vec<Recording> = [0, 2, 3, 4, 6, 7, 8, 9].map(|number: usize| recordings[number].clone()).to_vec();
        let discovery = discover(&learnt, &kept, &DiscoverConfig::default()).expect("a finding").discovery;
        assert_eq!((discovery.verdict, discovery.effects[0].name.as_str()), (Verdict::Named, "setup-change"), "moved at {moved}");
        assert_eq!(discovery.side_unknown, ["number_5.csv"]);
    }
}

#[test]
fn every_name_of_the_vocabulary_has_a_form_or_is_the_mask() {
    let forms = catalogue::forms();
    for name in catalogue::NAMES {
        assert!(name == "outliers" || forms.iter().any(|form| form.name() == name), "{name} has no form");
    }
    for form in &forms {
        assert!(catalogue::NAMES.contains(&form.name()), "{} is not in the vocabulary", form.name());
        let twins = forms.iter().filter(|other| other.name() == form.name() && other.key() == form.key()).count();
        assert_eq!(twins, 1, "{} has two forms called {}", form.name(), form.key());
        let is_of_a_key = |letter: char| letter.is_ascii_lowercase() || letter == '-';
        assert!(form.key().chars().all(is_of_a_key), "{:?} is no key", form.key());
    }
}

#[test]
fn a_written_model_predicts_what_the_fitted_one_does() {
    let case = case(&["creep"], SEED + 5, 0.002);
    let config = DiscoverConfig { most_effects: 1, ..DiscoverConfig::default() };
    let finding = discover(&case.recordings[..8], &[], &config).expect("a finding");
    assert!(!finding.after.slots.is_empty(), "{:?}", finding.discovery);
    let effects = finding
        .after
        .slots
        .iter()
        .map(|slot| file::EffectEntry {
            name: slot.form.name().into(),
            form: slot.form.key().into(),
            definition: None,
            normalised: slot.parameters.clone(),
            weights: slot.weights.clone(),
            parameters: BTreeMap::new(),
            intervals: BTreeMap::new(),
        })
        .collect();
    let origin = file::Origin { program: String::new(), recordings: Vec::new(), rmse: 0.0, rmse_before: 0.0 };
    let signals = (case.recordings[0].input_signal.clone(), case.recordings[0].output_signal.clone());
    let written = file::DiscoveredModel::new(&finding.after, &finding.session, signals, origin, effects);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("model.toml");
    std::fs::write(&path, written.encode().expect("TOML")).expect("a file");
    let read = file::DiscoveredModel::read(&path).expect("a model");
    // The first of the session: a file knows nothing of what earlier recordings have left creeping.
    let recording = &case.recordings[0];
    let run = finding.session.runs.iter().find(|run| run.index == 0).expect("the run");
    assert!(run.source == (0, 0) && run.input.len() == recording.input.len());
    let fitted = finding.after.predict(run);
    if !finding.after.initial_state.is_carried() {
        for (from_file, normalised) in read.simulate(&recording.input).expect("a prediction").iter().zip(fitted) {
            // Printed numbers read back exactly; the scaling to units and back rounds.
            assert!((from_file - normalised * finding.session.output_scale).abs() < 1e-9);
        }
    }
    std::fs::write(&path, written.encode().expect("TOML").replace("\"creep\"", "\"creeps\"")).expect("a file");
    let message = file::DiscoveredModel::read(&path).expect_err("refused").to_string();
    assert!(message.contains("creeps"), "{message}");
}

#[test]
fn a_power_of_the_pressure_is_no_threshold_beside_a_curve() {
    let effects = vec!["static-nonlinearity".to_owned()];
    let case = rig::hide(&CaseConfig { effects, seed: 552, generator: Generator::Rival, ..CaseConfig::default() }).expect("a case");
    let finding = discover(&case.recordings, &case.kept_out, &DiscoverConfig::default()).expect("a finding").discovery;
    let names: Vec<&str> = finding.effects.iter().map(|effect| effect.name.as_str()).collect();
    assert_eq!(names, ["static-nonlinearity"], "{finding:?}");
    assert_eq!(
        (finding.verdict, finding.effects[0].form.as_str()),
        (Verdict::Named, "power of the input that saturates or steepens: v = b u^n / (1 + (b - 1) u^n)")
    );
}

#[test]
fn the_rig_and_the_catalogue_share_no_code() {
    // What hides effects does not know what finds them, nor the other way round, but in tests.
    let needs = |manifest: &'static str| {
        let needed = manifest.split_once("[dependencies]").expect("dependencies").1;
        needed.split("[dev-dependencies]").next().unwrap_or(needed)
    };
    let rig = needs(include_str!("../../virtual-rig/Cargo.toml"));
    assert!(!rig.contains("discovery") && !rig.contains("hysteresis"), "{rig}");
    let ours = needs(include_str!("../Cargo.toml"));
    assert!(!ours.contains("virtual-rig"), "{ours}");
}
