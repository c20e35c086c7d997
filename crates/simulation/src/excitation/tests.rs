use std::f64::consts::PI;

use super::sets::{SetConfig, families, lab, paper_training, rich_training};
use super::*;

fn one(signal: Signal) -> ExcitationConfig {
    ExcitationConfig { sample_period_s: 0.02, noise_bar: 0.0, seed: 5, segments: vec![Segment { duration_s: 20.0, signal }] }
}

#[test]
fn the_papers_training_set_is_equation_1_with_24_groups_of_1000_points() {
    let set = paper_training(&SetConfig::default());
    assert_eq!(set.len(), 24);
    let mut index = 0;
    for frequency in [0.2, 0.4, 0.6, 0.8] {
        for tau in [0.01, 0.02, 0.05, 0.1, 0.15, 0.2] {
            let samples = set[index].excitation.sample_within(&Limits::default()).expect("within the limits");
            assert_eq!((samples.time_s.len(), samples.time_s[999]), (1000, 19.98));
            let noise: Vec<f64> = (0..1000)
                .map(|k| {
                    let t = k as f64 * 20.0 / 1000.0;
                    samples.pressure_bar[k] - (-tau * t).exp() * ((2.0 * PI * frequency * t - PI / 2.0).sin() + 1.0)
                })
                .collect();
            assert!(noise.iter().all(|noise| (-1e-12..0.1).contains(noise)), "group {index}");
            let mean = noise.iter().sum::<f64>() / 1000.0;
            let variance = noise.iter().map(|noise| (noise - mean).powi(2)).sum::<f64>() / 1000.0;
            // Uniform on 0 to 0.1: mean 0.05 +- 0.0009 and variance 1/1200 +- 2.4e-5 (one sigma of 1000 samples); five sigma.
            assert!((mean - 0.05).abs() < 0.0046 && (variance - 1.0 / 1200.0).abs() < 1.2e-4, "group {index}: {mean} {variance}");
            index += 1;
        }
    }
    let first: Vec<f64> = set[0].excitation.sample().expect("samples").pressure_bar;
    let same_seed = paper_training(&SetConfig::default())[0].excitation.sample().expect("samples").pressure_bar;
    let other_seed = paper_training(&SetConfig { seed: 2, ..SetConfig::default() })[0].excitation.sample().expect("samples").pressure_bar;
    assert!(first == same_seed && first != other_seed);
}

#[test]
fn test_families_use_frequencies_and_decays_unseen_in_training() {
    for seed in 0..20 {
        let config = SetConfig { seed, tests_per_family: 5, ..SetConfig::default() };
        for named in families(&config) {
            let (frequencies, decay) = match &named.excitation.segments[0].signal {
                Signal::DescendingSine { frequency_hz, decay_per_s, .. } if named.name.starts_with("a_") => {
                    (vec![*frequency_hz], *decay_per_s)
                }
                Signal::DescendingTriangle { frequency_hz, decay_per_s, .. } if named.name.starts_with("b_") => {
                    (vec![*frequency_hz], *decay_per_s)
                }
                Signal::AscendingSine { frequency_hz, frequency_end_hz: None, growth_per_s, anchor: Anchor::End, .. }
                    if named.name.starts_with("c_") =>
                {
                    (vec![*frequency_hz], *growth_per_s)
                }
                Signal::AscendingSine { frequency_hz, frequency_end_hz: Some(end), growth_per_s, anchor: Anchor::End, .. }
                    if named.name.starts_with("d_") =>
                {
                    assert!((frequency_hz - end).abs() >= 0.1, "seed {seed}: the frequency does not alter");
                    (vec![*frequency_hz, *end], *growth_per_s)
                }
                other => panic!("seed {seed}: {} plays {other:?}", named.name),
            };
            let near = |value: f64, grid: &[f64]| grid.iter().map(|seen| (value - seen).abs()).fold(f64::INFINITY, f64::min);
            assert!(frequencies.iter().all(|&f| near(f, &sets::PAPER_FREQUENCIES_HZ) > 0.045), "seed {seed}: {}", named.name);
            assert!(near(decay, &sets::PAPER_DECAYS_PER_S) > 0.009, "seed {seed}: {}", named.name);
            let samples = named.excitation.sample_within(&Limits::default()).expect("within the limits");
            let peak = samples.pressure_bar.iter().copied().fold(0.0, f64::max);
            assert!((1.0..2.1).contains(&peak), "seed {seed}: {} peaks at {peak}", named.name);
        }
    }
}

#[test]
fn the_ascending_sine_is_the_descending_one_backwards() {
    let ascending = one(Signal::AscendingSine {
        amplitude_bar: 1.0,
        frequency_hz: 0.3,
        frequency_end_hz: None,
        growth_per_s: 0.12,
        anchor: Anchor::End,
    });
    let samples = ascending.sample().expect("samples");
    for (t, pressure) in samples.time_s.iter().zip(&samples.pressure_bar) {
        let wanted = (-0.12 * (20.0 - t)).exp() * ((2.0 * PI * 0.3 * t - PI / 2.0).sin() + 1.0);
        assert!((pressure - wanted).abs() < 1e-12);
    }
}

#[test]
fn the_literal_ascending_case_is_refused_with_the_number_it_would_have_reached() {
    let literal =
        Signal::AscendingSine { amplitude_bar: 1.0, frequency_hz: 0.3, frequency_end_hz: None, growth_per_s: 0.12, anchor: Anchor::Start };
    let negative_decay = Signal::DescendingSine { amplitude_bar: 1.0, frequency_hz: 0.3, decay_per_s: -0.12, offset_bar: 0.0 };
    for signal in [literal, negative_decay] {
        let excitation = one(signal);
        let peak = excitation.sample().expect("samples").pressure_bar.into_iter().fold(0.0, f64::max);
        assert!(peak > 15.0, "e^2.4 times 2 less the phase, got {peak}");
        let message = excitation.sample_within(&Limits::default()).expect_err("refused").to_string();
        assert!(message.starts_with(&format!("asks for {peak:.3} bar at ")), "{message}");
        assert!(message.contains("nothing was played") && message.contains("anchor = \"end\""), "{message}");
    }
}

#[test]
fn limits_hold_for_pressure_and_slew_and_for_negative_pressure() {
    let limits = Limits::default();
    let sine = |amplitude_bar: f64| one(Signal::DescendingSine { amplitude_bar, frequency_hz: 0.3, decay_per_s: 0.0, offset_bar: 0.0 });
    assert!(sine(1.5).sample_within(&limits).is_ok(), "A = 1.5 bar peaks at exactly 3 bar");
    assert!(matches!(sine(1.51).sample_within(&limits), Err(ExcitationError::Pressure { asked_bar, .. }) if asked_bar > 3.0));
    let noisy = ExcitationConfig { noise_bar: 0.1, ..sine(1.5) };
    let message = noisy.sample_within(&limits).expect_err("3.1 bar").to_string();
    assert!(message.contains("noise_bar"), "{message}");
    assert!(matches!(one(Signal::Hold { pressure_bar: -0.1 }).sample_within(&limits), Err(ExcitationError::Pressure { .. })));
    let step = one(Signal::Points { times_s: vec![0.0, 1.0, 1.02], pressures_bar: vec![0.0, 0.0, 0.5] });
    match step.sample_within(&limits) {
        Err(ExcitationError::Slew { asked_bar_per_s, time_s, .. }) => {
            assert!((asked_bar_per_s - 25.0).abs() < 1e-6 && (time_s - 1.0).abs() < 1e-9);
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_set_stays_within_the_limits_and_survives_its_file() {
    for seed in [3, 4, 5] {
        let config = SetConfig { seed, ..SetConfig::default() };
        let paper_experiment = SetConfig { seed, amplitude_bar: 1.5, noise_bar: 0.0, ..SetConfig::default() };
        for config in [config, paper_experiment] {
            for named in [paper_training(&config), families(&config), rich_training(&config), lab(&config)].concat() {
                let samples =
                    named.excitation.sample_within(&Limits::default()).unwrap_or_else(|error| panic!("{seed} {}: {error}", named.name));
                let text = to_toml(&named.excitation);
                let back: ExcitationConfig = toml::from_str(&text).unwrap_or_else(|error| panic!("{text}: {error}"));
                assert_eq!(back.sample().expect("samples"), samples, "{}", named.name);
            }
        }
    }
}

#[test]
fn the_rich_set_covers_what_it_promises() {
    let set = rich_training(&SetConfig { seed: 6, ..SetConfig::default() });
    let played: Vec<Samples> = set.iter().map(|named| named.excitation.sample().expect("samples")).collect();
    let seconds: f64 = played.iter().map(|samples| samples.pressure_bar.len() as f64 * 0.02).sum();
    assert!((180..=200).contains(&set.len()) && (4000.0..4800.0).contains(&seconds), "{} recordings, {seconds} s", set.len());
    let noise_free = set.iter().filter(|named| named.excitation.noise_bar == 0.0).count();
    assert!((60..=70).contains(&noise_free), "{noise_free} without noise");
    let longest_hold = |samples: &Samples| {
        let mut longest = 0;
        let mut run = 0;
        for pair in samples.pressure_bar.windows(2) {
            run = if pair[0] == pair[1] { run + 1 } else { 0 };
            longest = longest.max(run);
        }
        f64::from(longest) * 0.02
    };
    let holds = played.iter().filter(|samples| longest_hold(samples) >= 10.0).count();
    assert!(holds >= 3, "{holds} noise-free holds of ten seconds");
    let starts_high = played.iter().filter(|samples| samples.pressure_bar[0] > 0.5).count();
    let starts_at_rest = played.iter().filter(|samples| samples.pressure_bar[0] < 0.1).count();
    assert!(starts_high > 10 && starts_at_rest > 20, "{starts_high} {starts_at_rest}");
    // Time spent in each fifth of the range, 0 to 2 bar.
    let mut share = [0_usize; 5];
    for pressure in played.iter().flat_map(|samples| &samples.pressure_bar) {
        share[((pressure / 0.4) as usize).min(4)] += 1;
    }
    let total: usize = share.iter().sum();
    assert!(share.iter().all(|&count| count * 20 > total), "{share:?}");
}

#[test]
fn signals_go_where_they_should() {
    let samples = |signal: Signal| one(signal).sample().expect("samples").pressure_bar;
    let stairs = samples(Signal::Staircase { levels_bar: vec![0.0, 1.0, 2.0, 1.0], ramp_s: 1.0 });
    assert_eq!((stairs[249], stairs[300], stairs[499], stairs[999]), (0.0, 1.0, 1.0, 1.0));
    assert!((stairs[275] - 0.5).abs() < 1e-9 && (stairs[600] - 2.0).abs() < 1e-12);
    let triangle = samples(Signal::Triangle { minimum_bar: 0.5, maximum_bar: 1.5, frequency_hz: 0.1 });
    assert!((triangle[0] - 0.5).abs() < 1e-12 && (triangle[250] - 1.5).abs() < 1e-9 && (triangle[125] - 1.0).abs() < 1e-9);
    let curves = samples(Signal::FirstOrderReversalCurves { minimum_bar: 0.0, maximum_bar: 2.0, reversals: 4 });
    let minima: Vec<f64> = (1..999).filter(|&k| curves[k] < curves[k - 1] && curves[k] <= curves[k + 1]).map(|k| curves[k]).collect();
    assert_eq!(minima.len(), 4);
    for (minimum, wanted) in minima.iter().zip([1.5, 1.0, 0.5, 0.0]) {
        // A turn may lie between two samples: the rate is 12 bar in 20 s, 0.012 bar a sample.
        assert!((minimum - wanted).abs() <= 0.012, "{minima:?}");
    }
    let sum = samples(Signal::Multisine { minimum_bar: 0.2, maximum_bar: 1.8, frequencies_hz: vec![0.1, 0.3, 0.7] });
    let (low, high) = sum.iter().fold((9.0_f64, 0.0_f64), |(low, high), &p| (low.min(p), high.max(p)));
    assert!((low - 0.2).abs() < 1e-12 && (high - 1.8).abs() < 1e-12);
    let chirp = samples(Signal::Chirp { minimum_bar: 0.0, maximum_bar: 2.0, frequency_start_hz: 0.1, frequency_end_hz: 0.9 });
    let peaks = (1..999).filter(|&k| chirp[k] > chirp[k - 1] && chirp[k] >= chirp[k + 1]).count();
    assert_eq!(peaks, 10, "the mean frequency is 0.5 Hz over 20 s");
    let random_points = samples(Signal::RandomPoints {
        minimum_bar: 0.3,
        maximum_bar: 1.7,
        slowest_bar_per_s: 0.2,
        fastest_bar_per_s: 2.0,
        hold_share: 0.3,
        longest_hold_s: 2.0,
        start_bar: Some(0.3),
        end_bar: Some(1.0),
    });
    assert!(random_points.iter().all(|p| (0.3 - 1e-12..=1.7 + 1e-12).contains(p)));
    assert!(random_points[0] == 0.3 && (random_points[999] - 1.0).abs() < 0.01);
}

#[test]
fn files_with_mistakes_are_refused_with_the_place() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("e.toml");
    let sine = "[[segments]]\nduration_s = 20.0\nsignal = { kind = \"descending-sine\", amplitude_bar = 1.0, frequency_hz = 0.3, decay_per_s = 0.1";
    for (text, wanted) in [
        (format!("sample_perid_s = 0.02\n{sine} }}\n"), "line 1"),
        (format!("{sine}, tau = 3 }}\n"), "tau"),
        ("[[segments]]\nduration_s = 1.0\nsignal = { kind = \"sawtooth\" }\n".to_owned(), "sawtooth"),
        ("noise_bar = 0.1\n".to_owned(), "segments"),
        (format!("noise_bar = \"much\"\n{sine} }}\n"), "line 1"),
    ] {
        std::fs::write(&path, &text).expect("write");
        let message = read(&path).expect_err(&text).to_string();
        assert!(message.contains("e.toml") && message.contains(wanted), "{text}\n{message}");
    }
    for (text, wanted) in [
        (format!("sample_period_s = 0.0\n{sine} }}\n"), "sample_period_s"),
        (sine.replace("20.0", "-1.0") + " }\n", "segment 1 (descending-sine): duration_s is -1"),
        (sine.replace("20.0", "1e12") + " }\n", "samples; shorten it"),
        (sine.replace("0.3", "nan") + " }\n", "frequency_hz is NaN"),
        ("segments = []\n".to_owned(), "segments: are empty"),
    ] {
        std::fs::write(&path, &text).expect("write");
        let message = read(&path).expect(&text).sample().expect_err(&text).to_string();
        assert!(message.contains(wanted), "{text}\n{message}");
    }
}

#[test]
fn a_signal_of_more_moves_than_samples_is_refused_before_it_fills_the_memory() {
    let refused = |signal: &str, duration_s: f64, period_s: f64| {
        let text = format!("sample_period_s = {period_s:?}\n[[segments]]\nduration_s = {duration_s:?}\nsignal = {{ {signal} }}\n");
        let excitation: ExcitationConfig = toml::from_str(&text).expect("an excitation");
        excitation.sample().expect_err("too many moves").to_string()
    };
    let span = "minimum_bar = 0.0, maximum_bar = 1.0";
    let steps = format!("kind = \"random-steps\", {span}, rise_s = 1e-300, shortest_hold_s = 0.0, longest_hold_s = 1e-9");
    assert!(refused(&steps, 20.0, 0.02).contains("steps"));
    let curves = format!("kind = \"first-order-reversal-curves\", {span}, reversals = 9223372036854775807");
    assert!(refused(&curves, 20.0, 0.02).contains("reversals"));
    let points = format!(
        "kind = \"random-points\", {span}, slowest_bar_per_s = 1.0, fastest_bar_per_s = 2.0, hold_share = 0.1, longest_hold_s = 1.0"
    );
    assert!(refused(&points, 1e12, 1e6).contains("moves"));
}

#[test]
fn a_pressure_that_is_no_number_is_beyond_the_limits_whatever_its_sign() {
    let excitation = one(Signal::Hold { pressure_bar: 1.0 });
    let mut samples = excitation.sample().expect("samples");
    assert!(Limits::default().check(&samples, &excitation).is_ok());
    for no_number in [f64::NAN, -f64::NAN] {
        samples.pressure_bar[7] = no_number;
        assert!(Limits::default().check(&samples, &excitation).is_err(), "{no_number}");
    }
}
