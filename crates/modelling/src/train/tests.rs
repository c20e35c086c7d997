//! Training as a whole: it learns, it repeats, it resumes, it covers the data.

use std::path::PathBuf;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::team::Team;
use super::tracks::{Track, Walk, Windows};
use super::*;
use crate::network::{Activation, Mode, Network, TrainedModel, to_bytes};
use recording::{Recording, Signal};

/// A play operator of threshold 0.3 on a random walk of sines: memory that only the past explains.
fn play_recording(seed: u64, samples: usize) -> Recording {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (frequency, phase): (f64, f64) = (random.random_range(0.01..0.03), random.random_range(0.0..6.0));
    let time_s: Vec<f64> = (0..samples).map(|sample| sample as f64 * 0.02).collect();
    let slow = frequency * 0.37;
    let input: Vec<f64> = (0..samples)
        .map(|sample| {
            (1.0 + (phase + frequency * sample as f64 * std::f64::consts::TAU).sin() * (slow * sample as f64 * std::f64::consts::TAU).cos())
                .max(0.0)
        })
        .collect();
    let mut memory: f64 = 0.0;
    let output = input
        .iter()
        .map(|&input| {
            memory = memory.clamp(input - 0.3, input + 0.3);
            2.0 * memory
        })
        .collect();
    let path = PathBuf::from(format!("play_{seed}.csv"));
    Recording::new(&path, Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output).unwrap()
}

fn recordings() -> Vec<Recording> {
    (0..6).map(|seed| play_recording(100 + seed, 400)).collect()
}

fn small_config() -> TrainConfig {
    TrainConfig {
        units: vec![16],
        lanes: 8,
        chunk: 40,
        learning_rate: 0.01,
        longest_visit: 300,
        epochs: Some(60.0),
        validations: 6,
        ..TrainConfig::preset("stream-1x32").unwrap()
    }
}

#[test]
fn a_split_of_ones_own_decides_what_is_learned_and_what_validates() {
    let (recordings, plan) = (recordings(), CheckpointPlan::default());
    let config = TrainConfig { epochs: Some(3.0), ..small_config() };
    let trained = |parts: &[Vec<bool>]| train_split(&recordings, parts, &config, 3, 1, &plan, &mut |_| {});
    let last = recordings.len() - 1;
    let parts: Vec<Vec<bool>> = recordings.iter().enumerate().map(|(index, one)| vec![index != last; one.len()]).collect();
    let (_, report) = trained(&parts).unwrap();
    let validated: Vec<_> = report.validation.iter().map(|one| one.path.clone()).collect();
    assert_eq!(validated, [recordings[last].path.display().to_string()]);
    let missing = &parts[..last];
    let none: Vec<Vec<bool>> = recordings.iter().map(|one| vec![true; one.len()]).collect();
    for wrong in [missing, &none] {
        assert!(matches!(trained(wrong), Err(TrainError::Config(text)) if text.contains("split")));
    }
}

fn run(config: &TrainConfig, seed: u64, threads: usize, plan: &CheckpointPlan) -> (TrainedModel, TrainReport) {
    train(&recordings(), config, seed, threads, plan, &mut |_| {}).unwrap()
}

#[test]
fn a_small_network_learns_a_play_operator() {
    let (model, report) = run(&TrainConfig { epochs: Some(160.0), ..small_config() }, 1, 2, &CheckpointPlan::default());
    // The loop is 1.2 mm wide: without memory no function of the input gets below about 0.3 mm.
    assert!(report.val_rmse < 0.12, "{}", report.val_rmse);
    let unseen = play_recording(999, 400);
    let predicted = model.predict(&unseen.inputs(), &unseen.gaps).unwrap();
    let square: f64 = predicted.iter().zip(&unseen.output).map(|(a, b)| (a - b).powi(2)).sum();
    assert!((square / 400.0).sqrt() < 0.15, "{}", (square / 400.0).sqrt());
    assert_eq!(report.parameters, model.network.unwrap().parameters());
}

#[test]
fn a_training_that_gets_no_better_ends_with_the_best_weights_it_had_and_the_same_ones_as_if_it_had_gone_on() {
    // The validation recordings obey the mirrored law, so what is learned makes them worse, whatever the weights begin as.
    let mut recordings = recordings();
    let parts: Vec<Vec<bool>> = recordings.iter().enumerate().map(|(index, one)| vec![index < 4; one.len()]).collect();
    recordings[4..].iter_mut().flat_map(|recording| &mut recording.output).for_each(|output| *output = 2.0 - (*output - 2.0));
    let config = TrainConfig { epochs: Some(120.0), validations: 40, patience: 0, learning_rate: 0.004, ..small_config() };
    let train =
        |config: &TrainConfig, seed| train_split(&recordings, &parts, config, seed, 1, &CheckpointPlan::default(), &mut |_| {}).unwrap();
    for seed in 1..=4 {
        let (_, to_the_end) = train(&config, seed);
        let (_, early) = train(&TrainConfig { patience: 6, ..config.clone() }, seed);
        assert_eq!((to_the_end.ended, early.ended), (Ended::Complete, Ended::EarlyStop));
        assert!(2 * early.optimiser_steps < early.planned_steps, "{} of {}", early.optimiser_steps, early.planned_steps);
        assert_eq!(early.history[..], to_the_end.history[..early.history.len()]);
        // The last weights are other than the best ones.
        let errors: Vec<f64> = early.history.iter().map(|at| at.validation_rmse).collect();
        let best = errors.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(*errors.last().unwrap() > 1.02 * best, "{errors:?}");
        assert!((early.val_rmse / best - 1.0).abs() < 1e-3, "{} and {best}", early.val_rmse);
        assert!(early.val_rmse <= to_the_end.val_rmse * (1.0 + 1e-9));
    }
}

#[test]
fn a_hybrid_whose_network_does_not_help_is_its_physics() {
    // What the operators leave is noise, and steps are far too long to learn anything.
    let mut random = ChaCha8Rng::seed_from_u64(6);
    let mut noisy = recordings();
    noisy.iter_mut().flat_map(|recording| &mut recording.output).for_each(|output| *output += random.random_range(-0.05..0.05));
    let config =
        TrainConfig { learning_rate: 1.0, epochs: Some(5.0), validations: 1, front_end: config::FrontEndKind::Hybrid, ..small_config() };
    let train = |config: &TrainConfig| train(&noisy, config, 1, 1, &CheckpointPlan::default(), &mut |_| {}).unwrap();
    let (model, report) = train(&config);
    assert_eq!((model.network.is_none(), report.ended), (true, Ended::PhysicsSuffices));
    assert!((report.val_rmse - report.val_rmse_front_end).abs() < 1e-12 && report.val_rmse < 0.1, "{}", report.val_rmse);
    // Who asks for a network gets one.
    let (model, report) = train(&TrainConfig { sufficient: 0.0, ..config });
    assert!(model.network.is_some() && report.val_rmse > report.val_rmse_front_end, "{}", report.val_rmse);
}

#[test]
fn a_network_trained_to_be_certified_is_and_still_learns_and_one_that_is_not_is_said_not_to_be() {
    let examine = |certified_radius| {
        let config = TrainConfig { certified_radius, epochs: Some(80.0), ..small_config() };
        let (model, report) = run(&config, 1, 2, &CheckpointPlan::default());
        let bytes = crate::export::export(&model, &recordings()).unwrap().bytes;
        let network = model_export::blob::decode(&bytes).unwrap().model.network.unwrap();
        (model_export::certificate::certificate(&network, 0.01).unwrap(), report.val_rmse)
    };
    let ((free, free_rmse), (kept, kept_rmse)) = (examine(0.0), examine(0.99));
    assert!(!free.holds(), "{free:?}");
    // On the weights that the microcontroller runs, rounded in whichever way the export chose.
    assert!(kept.holds() && kept.recovery_steps.is_some(), "{kept:?}");
    // No function of the input alone gets below about 0.3 mm.
    assert!(kept_rmse < 0.25, "certified {kept_rmse} mm, free {free_rmse} mm");
}

#[test]
fn equal_seeds_and_threads_give_equal_bytes_and_other_seeds_do_not() {
    let config = TrainConfig { epochs: Some(1.0), ..small_config() };
    for threads in [1, 2, 3] {
        let bytes = |seed| to_bytes(&run(&config, seed, threads, &CheckpointPlan::default()).0).unwrap();
        let first = bytes(5);
        assert_eq!(first, bytes(5), "{threads} threads");
        assert_ne!(first, bytes(6), "{threads} threads");
    }
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    // The windows with Adam, as the paper's preset has it; the others with SOAP.
    let adam = optimizer::OptimizerConfig::default();
    let window = TrainConfig { mode: Mode::Window { length: 20 }, chunk: 20, epochs: Some(0.5), optimizer: adam, ..small_config() };
    let streaming = TrainConfig { epochs: Some(0.5), ..small_config() };
    let quantised = TrainConfig { quantised: 0.3, ..streaming.clone() };
    // The last one is interrupted once more after its weights have begun to be rounded.
    for (name, config, second_stop) in [("streaming", streaming, 31), ("window", window, 31), ("quantised", quantised, 75)] {
        let (whole, uninterrupted) = run(&config, 3, 2, &CheckpointPlan::default());
        let rounded_from = f64::from(1.0 - config.quantised) * uninterrupted.planned_steps as f64;
        assert!(config.quantised == 0.0 || second_stop as f64 > rounded_from, "{name}: rounded from step {rounded_from}");
        let path = folder.path().join(name);
        let mut plan = CheckpointPlan { path: Some(path.clone()), resume: false, stop_after: Some(17) };
        assert_eq!(run(&config, 3, 2, &plan).1.ended, Ended::Interrupted, "{name}");
        // A second interruption, then the end.
        plan = CheckpointPlan { resume: true, stop_after: Some(second_stop), ..plan };
        assert_eq!(run(&config, 3, 2, &plan).1.ended, Ended::Interrupted, "{name}");
        plan.stop_after = None;
        let (resumed, report) = run(&config, 3, 2, &plan);
        assert_eq!(report.ended, Ended::Complete, "{name}");
        assert_eq!(to_bytes(&resumed).unwrap(), to_bytes(&whole).unwrap(), "{name}");
        assert!(!path.exists(), "a finished run leaves no checkpoint");
    }
}

#[test]
fn quantisation_aware_training_leaves_weights_that_export_does_not_change() {
    let plain = TrainConfig { epochs: Some(80.0), ..small_config() };
    let aware = TrainConfig { quantised: 0.25, ..plain.clone() };
    let compare = |config: &TrainConfig| {
        let (model, report) = run(config, 1, 2, &CheckpointPlan::default());
        let exported = crate::export::export(&model, &recordings()).unwrap();
        (exported.comparison.rmse, report.val_rmse)
    };
    let (difference, rmse) = compare(&plain);
    let (difference_aware, rmse_aware) = compare(&aware);
    assert!(difference_aware < 0.5 * difference, "fixed point differs from f32 by {difference_aware}, without by {difference}");
    // A fifth of the steps, and int8 weights, cost some accuracy, but not much.
    assert!(rmse_aware < 2.0 * rmse, "{rmse_aware} {rmse}");
}

#[test]
fn a_checkpoint_of_another_run_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let plan = CheckpointPlan { path: Some(folder.path().join("run.checkpoint")), resume: false, stop_after: Some(5) };
    run(&small_config(), 3, 1, &plan);
    let plan = CheckpointPlan { resume: true, ..plan };
    let error = train(&recordings(), &small_config(), 4, 1, &plan, &mut |_| {}).unwrap_err();
    assert!(error.to_string().contains("other data, settings, seed or threads"), "{error}");
    let missing = CheckpointPlan { path: Some(folder.path().join("none.checkpoint")), ..plan };
    let error = train(&recordings(), &small_config(), 3, 1, &missing, &mut |_| {}).unwrap_err();
    assert!(error.to_string().contains("without --resume"), "{error}");
}

#[test]
fn the_gradient_does_not_depend_on_the_number_of_threads_beyond_rounding() {
    let network = super::starting_network(&Network::zeros(2, &[16, 8], Activation::Tanh, 4.0).architecture(), 1.0, 2);
    let gradient = |threads| {
        let mut team = Team::new(&network.architecture(), &network.to_flat(), optimizer::OptimizerConfig::default(), 7, 11, threads);
        {
            let mut batch = team.batch();
            let mut random = ChaCha8Rng::seed_from_u64(4);
            batch.features.iter_mut().for_each(|value| *value = random.random_range(-1.0..1.0));
            batch.targets.iter_mut().for_each(|value| *value = random.random_range(-1.0..1.0));
            batch.weights.iter_mut().for_each(|value| *value = f32::from(u8::from(random.random_range(0.0..1.0f32) < 0.8)));
        }
        let loss = team.step(0.0);
        (team.last_gradient(), loss)
    };
    let (one, loss) = gradient(1);
    let largest = one.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
    assert!(largest > 1e-2);
    for threads in [2, 3, 7, 20] {
        let (many, loss_of_many) = gradient(threads);
        assert!((loss - loss_of_many).abs() < 1e-6 * loss);
        for (a, b) in one.iter().zip(&many) {
            assert!((a - b).abs() < 1e-5 * largest, "{threads} threads: {a} {b}");
        }
    }
}

fn track(length: usize, offset: f32) -> Track {
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let values: Vec<f32> = (0..length).map(|sample| offset + sample as f32).collect();
    Track { features: values.clone(), front_end: vec![0.0; length], output: values, training: vec![true; length], slack: vec![0.0; length] }
}

#[test]
fn a_walk_visits_every_sample_in_order_and_equally_often() {
    let tracks = [track(100, 0.0), track(250, 1000.0), track(37, 2000.0)];
    let config = TrainConfig { lanes: 4, chunk: 10, longest_visit: 90, settling_samples: 20, middle_starts: 0.0, ..small_config() };
    let mut walk = Walk::new(&tracks, &config, 1);
    let mut batch = batch::Batch::new(4, 10, 1);
    let mut counts = std::collections::BTreeMap::<u32, u32>::new();
    for _ in 0..400 {
        walk.fill(&tracks, 1.0, &mut batch);
        for lane in 0..4 {
            for step in 0..10 {
                let row = lane * 10 + step;
                if batch.weights[row] > 0.0 {
                    assert_eq!(batch.features[row], batch.targets[row], "input and target of one sample");
                    *counts.entry(batch.targets[row] as u32).or_default() += 1;
                }
                if step > 0 && batch.weights[row] > 0.0 && batch.weights[row - 1] > 0.0 {
                    assert_eq!(batch.targets[row], batch.targets[row - 1] + 1.0, "time runs forward");
                }
            }
        }
    }
    assert_eq!(counts.len(), 387, "every sample of every track");
    let (least, most) = (counts.values().min().unwrap(), counts.values().max().unwrap());
    assert!(*least + 6 >= *most, "visits are even: {least} to {most}");
}

#[test]
fn starts_in_the_middle_settle_without_weight() {
    let tracks = [track(400, 0.0)];
    let config = TrainConfig { lanes: 3, chunk: 10, longest_visit: 400, settling_samples: 25, middle_starts: 1.0, ..small_config() };
    let mut walk = Walk::new(&tracks, &config, 1);
    let mut batch = batch::Batch::new(3, 10, 1);
    let mut since_reset = [0usize; 3];
    for _ in 0..200 {
        walk.fill(&tracks, 1.0, &mut batch);
        for (lane, since_reset) in since_reset.iter_mut().enumerate() {
            if batch.reset[lane] {
                *since_reset = 0;
            }
            for step in 0..10 {
                if *since_reset < 25 {
                    assert_eq!(batch.weights[lane * 10 + step], 0.0);
                }
                *since_reset += 1;
            }
        }
    }
}

#[test]
fn windows_cover_every_sample_once_an_epoch_with_one_target_at_the_end() {
    let tracks = [track(30, 0.0), track(50, 1000.0), track(4, 2000.0)];
    let mut windows = Windows::new(&tracks, 20, 6, 1);
    assert_eq!(windows.count(), 84);
    let mut batch = batch::Batch::new(6, 20, 1);
    let mut seen = std::collections::BTreeSet::new();
    for _ in 0..14 {
        windows.fill(&tracks, 1.0, &mut batch);
        for lane in 0..6 {
            let features = &batch.features[lane * 20..][..20];
            assert_eq!(batch.weights[lane * 20..][..19], [0.0; 19]);
            let end = batch.targets[lane * 20 + 19];
            assert_eq!((batch.weights[lane * 20 + 19], features[19]), (1.0, end));
            // Full windows count up; before the first sample (0, 1000, 2000) the input rests there.
            let rest = (end / 1000.0).floor() * 1000.0;
            for (step, &feature) in features.iter().enumerate() {
                assert_eq!(feature, (end - 19.0 + step as f32).max(rest));
            }
            assert!(seen.insert(end as u32), "each window once");
        }
    }
    assert_eq!(seen.len(), 84);
}

#[test]
fn the_split_is_seventy_thirty_by_recording_and_by_blocks_when_there_is_only_one() {
    let many: Vec<Recording> = (0..24).map(|seed| play_recording(seed, 50)).collect();
    let parts = split::split(&many, 0.3, 1);
    assert!(parts.iter().all(|part| part.iter().all(|&training| training == part[0])), "whole recordings");
    assert_eq!(parts.iter().filter(|part| part[0]).count(), 17);
    assert_ne!(parts, split::split(&many, 0.3, 2), "the seed decides");
    let one = [play_recording(1, 1000)];
    let parts = split::split(&one, 0.3, 1);
    assert_eq!(parts[0].iter().filter(|&&training| training).count(), 700);
    assert_eq!(parts[0].windows(50).step_by(50).filter(|block| block.iter().any(|&training| training != block[0])).count(), 0);
}

#[test]
fn whole_recordings_validate_from_three_on_and_two_give_their_ends() {
    let six: Vec<Recording> = (0..6).map(|seed| play_recording(seed, 100)).collect();
    let parts = split::split(&six, 0.2, 1);
    assert!(parts.iter().all(|part| part.iter().all(|&training| training == part[0])), "the end of a recording is more of the same");
    assert_eq!(parts.iter().filter(|part| !part[0]).count(), 1);
    let two = &six[..2];
    let parts = split::split(two, 0.2, 1);
    assert_eq!(parts, split::split(two, 0.2, 2), "no seed decides which motions are learned");
    for part in &parts {
        assert!(part[..80].iter().all(|&training| training) && !part[80..].contains(&true));
    }
}
