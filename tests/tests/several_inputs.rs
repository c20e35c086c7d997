//! Networks with several inputs, end to end: trained on recordings, written, read, exported, run as blob and as C, refused by the device.

#[allow(dead_code, reason = "another test needs the rest")]
#[path = "c_source/program.rs"]
mod program;
#[path = "c_source/script.rs"]
mod script;

use std::path::Path;

use firmware::estimator::Portable;
use firmware::model::examine;
use host_tool::export::{self, c};
use host_tool::fit::{self, Settings};
use host_tool::model::{self, BlobModel, NetworkModel, Predictor};
use host_tool::network::{self, TrainedModel};
use host_tool::recording::{Channel, Recording, Signal};
use host_tool::train::{CheckpointPlan, TrainConfig, train};
use hysteresis::{Operator, PrandtlIshlinskii};
use model_export::blob;
use model_export::link::fault::Fault;
use rig_tests::models::{PERIOD_S, smooth_input};

/// Samples of a recording: 60 s.
const SAMPLES: usize = 3_000;

/// A tip between two muscles: each hysteretic, the second pulls back, and what they do together stiffens the tip, which no sum of plays
/// of one input each can say.
fn recording(seed: u32) -> Recording {
    let inputs = [smooth_input(seed, SAMPLES, 0.0, 2.0), smooth_input(seed + 500, SAMPLES, 0.2, 1.4)];
    let muscle = |weights: [f64; 3]| PrandtlIshlinskii::<f64, 3>::new(&[0.0, 0.1, 0.35], &weights).expect("three operators");
    let hysteresis = |muscle: PrandtlIshlinskii<f64, 3>, input: &[f64]| -> Vec<f64> {
        let mut state = muscle.start();
        input.iter().map(|&value| muscle.step(&mut state, value)).collect()
    };
    let rise = hysteresis(muscle([2.0, 1.2, 0.8]), &inputs[0]);
    let back = hysteresis(muscle([0.5, 0.9, 0.9]), &inputs[1]);
    let output = rise.iter().zip(&back).map(|(rise, back)| (rise - back) / (1.0 + 0.08 * rise + 0.08 * back)).collect();
    let time_s = (0..SAMPLES).map(|sample| sample as f64 * PERIOD_S).collect();
    let [first, second] = inputs;
    let second = Channel { signal: Signal { quantity: "pressure2".into(), unit: "bar".into() }, values: second };
    let path = format!("run_{seed}.csv");
    Recording::new(path.as_ref(), Signal::pressure_bar(), Signal::displacement_mm(), time_s, first, output)
        .expect("a recording")
        .with_more_inputs(vec![second])
}

fn recordings(seeds: std::ops::Range<u32>) -> Vec<Recording> {
    seeds.map(recording).collect()
}

fn trained(preset: &str, recordings: &[Recording]) -> TrainedModel {
    let config = TrainConfig { budget_cpu_s: 6.0, ..TrainConfig::preset(preset).expect("a preset") };
    let plan = CheckpointPlan { path: None, resume: false, stop_after: None };
    train(recordings, &config, 3, 2, &plan, &mut |_| {}).expect("a training").0
}

/// Root mean square error and largest output range, free running.
fn error(model: &dyn Predictor, recordings: &[Recording]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for recording in recordings {
        let predicted = model::predict(model, recording, model::Fit::default()).expect("a prediction");
        sum += predicted.iter().zip(&recording.output).map(|(predicted, measured)| (predicted - measured).powi(2)).sum::<f64>();
        count += recording.len() as f64;
    }
    (sum / count).sqrt()
}

fn range(recordings: &[Recording]) -> f64 {
    let values = || recordings.iter().flat_map(|recording| &recording.output).copied();
    values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min)
}

#[test]
fn networks_of_two_inputs_beat_physics_and_run_as_blob_and_as_c() {
    let (training, test) = (recordings(0..8), recordings(100..103));
    let range = range(&test);
    let settings = Settings { seed: 1, threads: 2, network_budget_cpu_s: None, calibrate_s: None };
    // Half of them: a ladder of so many columns takes longer than the networks.
    let physics = fit::fit(&training[..4], &settings, &|_| {}).expect("a ladder");
    let physics = model::FittedPredictor::new(physics.fitted(physics.chosen).expect("a sum of columns"), Path::new("physics"));
    let physics = error(&physics, &test) / range;
    for preset in ["hybrid", "stream-1x32"] {
        let trained = trained(preset, &training);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("model.safetensors");
        network::save(&path, &trained).expect("the model is written");
        let read = network::load(&path).expect("the model is read");
        assert_eq!(read, trained, "{preset}");
        let float = NetworkModel::new(read, &path).expect("a model");
        let found = error(&float, &test) / range;
        println!("{preset}: {found:.5} of range on recordings kept out, physics {physics:.5}");
        // The hybrid begins with physics and must gain; the network alone has to learn all of it in a few seconds.
        assert!(found <= if preset == "hybrid" { physics } else { 0.02 }, "{preset}: {found} and physics {physics}");

        let exported = export::export(&trained, &training).expect("a blob");
        let decoded = blob::decode(&exported.bytes).expect("a blob");
        assert_eq!((decoded.schema_version, decoded.model.more_inputs.len()), (4, 1));
        let fixed = BlobModel::new(exported.bytes.clone(), Path::new("model.blob")).expect("a blob");
        assert!(fixed.replay().expect("a replay").passed(), "{preset}");
        for recording in &test {
            let [of_float, of_blob] = [&float as &dyn Predictor, &fixed].map(|model| {
                model::predict(model, recording, model::Fit::default()).expect("a prediction") //
            });
            let squares = of_float.iter().zip(&of_blob).map(|(float, blob)| (float - blob).powi(2));
            let apart = (squares.sum::<f64>() / SAMPLES as f64).sqrt() / range;
            assert!(apart <= 1e-3, "{preset}: blob {apart} of range from float");
        }

        // Whatever it measures, the firmware measures one pressure.
        assert_eq!(examine(&exported.bytes, Portable), Err(Fault::ModelInputs), "{preset}");

        let Some(builds) = program::builds() else { continue };
        let source = c::generate(&decoded, &c::Name::from_stem("model").expect("a plain name")).expect("C");
        std::fs::write(folder.path().join("model.h"), &source.header).expect("the header");
        std::fs::write(folder.path().join("model.c"), &source.source).expect("the source");
        let script = script::Script::new(&decoded.model, 7, 4_000);
        let expected = script::expected(&decoded.model, &script);
        for build in builds.iter().filter(|build| !build.is_slow()) {
            assert_eq!(build.run(folder.path(), &script.bytes(script.len())), expected, "{preset}, {build}");
        }
    }
}

#[test]
fn a_missing_input_is_told_by_name() {
    let training = recordings(0..3);
    let config = TrainConfig { epochs: Some(0.2), ..TrainConfig::preset("stream-1x32").expect("a preset") };
    let plan = CheckpointPlan { path: None, resume: false, stop_after: None };
    let trained = train(&training, &config, 3, 1, &plan, &mut |_| {}).expect("a training").0;
    let exported = export::export(&trained, &training).expect("a blob");
    let lacking = Recording { more_inputs: Vec::new(), ..recording(100) };
    let models: [Box<dyn Predictor>; 2] = [
        Box::new(NetworkModel::new(trained.clone(), Path::new("model")).expect("a model")),
        Box::new(BlobModel::new(exported.bytes, Path::new("model.blob")).expect("a blob")),
    ];
    for model in models {
        let said = model::predict(&*model, &lacking, model::Fit::default()).expect_err("an input is missing").to_string();
        assert!(said.contains("pressure2_bar") && said.contains("input2="), "{said}");
    }
    let said = export::export(&trained, &[lacking]).expect_err("an input is missing").to_string();
    assert!(said.contains("has 1 input(s), the model has 2"), "{said}");
    let other =
        Recording { more_inputs: vec![Channel { signal: Signal::pressure_bar(), ..training[0].more_inputs[0].clone() }], ..recording(1) };
    assert!(train(&[recording(0), other], &config, 3, 1, &plan, &mut |_| {}).is_err(), "recordings of other channels");
}
