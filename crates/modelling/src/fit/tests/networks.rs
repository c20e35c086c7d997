//! When the network rungs are trained and when not, and what is told of it.

use std::sync::Mutex;

use super::*;

fn with_networks(budget_cpu_s: f64) -> Settings {
    Settings { network_budget_cpu_s: Some(budget_cpu_s), ..physics_only(1) }
}

/// Whether networks stand on the ladder, and why not.
fn trained_and_notes(recordings: &[Recording]) -> (bool, String) {
    let fitted = fit(recordings, &with_networks(1.0), &|_| {}).expect("a ladder");
    (fitted.ladder.iter().any(|rung| matches!(rung.model, RungModel::Network(_))), fitted.notes.join("; "))
}

/// Each excitation twice, with noise that does not repeat.
fn twice(noise_mm: f64) -> Vec<Recording> {
    let (train, _) = paper(79, 0.0);
    let noisy = |number: usize| {
        let mut recording = train[number / 2].clone();
        recording.path = format!("run_{number}.csv").into();
        for (index, value) in recording.output.iter_mut().enumerate() {
            // Sums of three even numbers are nearly normal, of variance a quarter.
            let sum: f64 = (0..3).map(|part| (1e4 * ((index * 7 + number * 1013 + part * 5003) as f64).sin()).fract() * 0.5).sum();
            *value += 2.0 * noise_mm * sum;
        }
        recording
    };
    (0..6).map(noisy).collect()
}

#[test]
fn no_network_is_trained_where_physics_is_exact_or_at_what_the_rig_repeats() {
    let (exact, _) = paper(79, 0.0);
    for (recordings, reason) in [(exact, "physics is exact here"), (twice(0.03), "physics is at what the rig itself repeats")] {
        let (trained, notes) = trained_and_notes(&recordings);
        assert!(!trained && notes.contains("no network was trained") && notes.contains(reason), "{reason}: {notes}");
    }
}

#[test]
fn networks_of_two_inputs_are_trained_within_their_budget_and_told_all_along() {
    let (mut train, _) = paper(80, 0.0);
    for (number, recording) in train.iter_mut().enumerate() {
        let values: Vec<f64> = (0..recording.len()).map(|k| (0.013 * k as f64 + number as f64).sin()).collect();
        for (output, second) in recording.output.iter_mut().zip(&values) {
            *output *= 1.0 + 0.2 * second.abs();
        }
        recording.more_inputs = vec![Channel { signal: Signal { quantity: "other".into(), unit: "bar".into() }, values }];
    }
    let begun: Mutex<Vec<(usize, usize)>> = Mutex::default();
    let shares: Mutex<Vec<f64>> = Mutex::default();
    let fitted = fit(&train, &with_networks(1.0), &|progress| match progress {
        Progress::Network { number, of, .. } => begun.lock().expect("nobody panicked").push((number, of)),
        Progress::Trained(share) => shares.lock().expect("nobody panicked").push(share),
        _ => {}
    })
    .expect("a ladder");
    let (begun, shares) = (begun.into_inner().expect("nobody panicked"), shares.into_inner().expect("nobody panicked"));
    assert_eq!(begun, (1..=8).map(|number| (number, 8)).collect::<Vec<_>>());
    assert!(shares.is_sorted() && shares.len() > 30 && shares.iter().all(|share| (0.0..=1.0).contains(share)), "{shares:?}");
    // The last training is a fifth of all; a busy machine may end it early.
    assert!(*shares.last().expect("some") > 0.8, "{shares:?}");
    for name in ["hybrid", "LSTM"] {
        let rung = fitted.ladder.iter().find(|rung| rung.name == name).expect("the rung");
        let RungModel::Network(model) = &rung.model else { panic!("{name} is no network") };
        assert_eq!((model.more_inputs.len(), rung.errors.len(), rung.eligible), (1, 6, true), "{name}");
    }
    // What is shipped is never worse than its own rungs, but for what the rule of the simplest allows.
    let best = fitted.ladder.iter().filter(|rung| rung.eligible).map(|rung| rung.shape_rmse).fold(f64::INFINITY, f64::min);
    assert!(fitted.ladder[fitted.chosen].shape_rmse < 1.1 * best, "{} {best}", fitted.ladder[fitted.chosen].name);
}
