//! What discovery claims and what `evaluate` meets are the same figures, and a corpus that was interrupted goes on.

use std::path::Path;

use super::{DiscoverConfig, Finding, Verdict, catalogue, corpus, discover, discover_from, file, folder, start_from};
use crate::evaluate::{self, Judging};
use recording::Recording;
use virtual_rig::{self, CaseConfig, Generator};

/// Seeds of these tests; tuning used 100 to 199, figures are reported on 1000 and above.
const SEED: u64 = 500;

/// Least share of the gap that a simulation by the model with a single hidden effect closes.
const LEAST_CLOSED: f64 = 0.85;

/// What `evaluate` makes of the model in a folder on test recordings: pooled root mean square.
fn evaluated(finding: &Finding, recordings: &[Recording], kept: &[Recording]) -> f64 {
    let folder = tempfile::tempdir().expect("a folder");
    folder::write(finding, recordings, "", folder.path()).expect("a folder with a model");
    let model = crate::model::load(&folder.path().join("model.toml")).expect("a model");
    let name = |recording: &Recording| recording.path.file_name().expect("a name").to_string_lossy().into_owned();
    let counted: Vec<Recording> =
        kept.iter().filter(|recording| !finding.discovery.side_unknown.contains(&name(recording))).cloned().collect();
    let judging = Judging { calibrate_s: finding.discovery.calibrate_s.unwrap_or(0.0), ..Judging::default() };
    let judged = evaluate::judge(&*model, &counted, judging, 1).expect("figures");
    let errors = || judged.iter().map(|judged| &judged.errors.errors);
    let samples: f64 = errors().map(|errors| errors.n as f64).sum();
    (errors().map(|errors| errors.rmse.powi(2) * errors.n as f64).sum::<f64>() / samples).sqrt()
}

fn reproduces(generator: Generator, names: &[&str], seed: u64) {
    for name in names {
        let config = CaseConfig { effects: vec![(*name).to_owned()], seed, generator, ..CaseConfig::default() };
        let mut case = virtual_rig::hide(&config).expect("a case");
        // Every other recording: all of the session's time at half the cost.
        case.recordings = case.recordings.into_iter().step_by(2).collect();
        // Names of its own tell a kept-out recording from the others.
        for (index, recording) in case.kept_out.iter_mut().enumerate() {
            recording.path = Path::new(&format!("kept{index}.csv")).into();
        }
        let config = DiscoverConfig { most_effects: 1, threads: 2, ..DiscoverConfig::default() };
        let finding = discover(&case.recordings, &case.kept_out, &config).expect("a finding");
        let (claimed, met) = (finding.discovery.rmse_after, evaluated(&finding, &case.recordings, &case.kept_out));
        assert!((claimed / met - 1.0).abs() < 1e-9, "{generator:?} {name}: {claimed} claimed, {met} met");
        // Where a tip or a valve stands when a recording begins no simulation knows, and none foretells a bad reading.
        if !["stick-slip", "valve-dead-band", "outliers"].contains(name) {
            let closed = finding.discovery.gap_closed;
            assert!(closed > LEAST_CLOSED, "{generator:?} {name}: {closed} of the gap closed");
        }
    }
}

#[test]
fn evaluate_reproduces_the_figures_of_the_first_half_of_the_catalogue() {
    reproduces(Generator::Physics, &catalogue::NAMES[..11], 530);
}

#[test]
fn evaluate_reproduces_the_figures_of_the_second_half_of_the_catalogue() {
    reproduces(Generator::Physics, &catalogue::NAMES[11..], 530);
}

#[test]
fn evaluate_reproduces_the_figures_of_a_rig_without_a_session_clock() {
    reproduces(Generator::Rival, &["offset-drift", "gain-drift", "setup-change", "periodic-disturbance", "pneumatic-lag"], 531);
}

#[test]
fn beside_a_model_that_leaves_no_more_than_the_noise_nothing_is_missing() {
    let config = CaseConfig { effects: vec!["dead-time".to_owned()], seed: 532, ..CaseConfig::default() };
    let case = virtual_rig::hide(&config).expect("a case");
    let found = discover(&case.recordings, &case.kept_out, &DiscoverConfig::default()).expect("a finding");
    assert_eq!(found.discovery.verdict, Verdict::Named, "{:?}", found.discovery);
    let folder = tempfile::tempdir().expect("a folder");
    folder::write(&found, &case.recordings, "", folder.path()).expect("a folder with a model");
    let path = folder.path().join("model.toml");
    let model = crate::model::load(&path).expect("a model");
    let again = |discovered: Option<file::DiscoveredModel>| {
        let start = start_from(&*model, discovered, &case.recordings, &case.kept_out).expect("predictions");
        let finding = discover_from(&case.recordings, &case.kept_out, Some(&start), &DiscoverConfig::default(), &|_| {});
        let discovery = finding.expect("a finding").discovery;
        assert!(discovery.verdict == Verdict::None && discovery.effects.is_empty(), "{discovery:?}");
        assert!((discovery.rmse_before / found.discovery.rmse_after - 1.0).abs() < 1e-9, "{discovery:?}");
        discovery
    };
    // With its effects it is the model that is there already; a stranger's only predicts, and play operators are no substitute for it.
    let own = again(file::DiscoveredModel::read(&path).ok());
    assert!(!own.is_worse() && own.rmse_after < 1.02 * own.rmse_before, "{own:?}");
    assert!(again(None).is_worse());
}

#[test]
fn a_slice_of_the_corpus_is_answered_right() {
    // One case each of what differs most: in the input path, the material, the tip, the session's time, the sensor; nothing; none of ours.
    let slices: [(Generator, &[&str]); 2] = [
        (Generator::Physics, &["supply-saturation", "leakage", "offset-drift", "alien-breathing-gain"]),
        (Generator::Rival, &["resonance", "outliers", "none", "alien-wall"]),
    ];
    for (generator, names) in slices {
        let config = corpus::CorpusConfig {
            names: names.iter().map(|name| (*name).to_owned()).collect(),
            seeds: SEED + 30..SEED + 31,
            noise: 0.005,
            coloured_noise: false,
            excitation: virtual_rig::Excitation::Paper,
            generator,
            threads: 2,
        };
        let results = corpus::run(&config, Vec::new(), |_| Ok::<(), virtual_rig::RigError>(())).expect("cases");
        assert_eq!(results.len(), names.len());
        for result in &results {
            assert!(corpus::right(result), "{generator:?}: {result:?}");
            // No simulation foretells a bad reading.
            let closes_nothing = result.hidden.first().is_none_or(|name| name.starts_with("alien-") || name == "outliers");
            assert!(closes_nothing || result.gap_closed > 0.9, "{generator:?}: {result:?}");
        }
        // A run that was interrupted goes on where it was.
        let again = corpus::run(&config, results, |_| panic!("nothing is left to run")).map_err(|error: virtual_rig::RigError| error);
        assert_eq!(again.expect("cases").len(), names.len());
    }
}
