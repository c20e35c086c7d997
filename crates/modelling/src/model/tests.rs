use std::path::Path;

use model_export::{blob, schema};

use super::*;
use crate::network::{self, Channel, Mode, Provenance, TrainedModel};
use recording::{Recording, Signal};

/// One play operator of threshold 0.5 bar, as a trained model without a network, 20 ms a sample.
fn backlash() -> TrainedModel {
    let channel = |quantity: &str, unit: &str| Channel {
        quantity: quantity.into(),
        unit: unit.into(),
        offset: 0.0,
        scale: 1.0,
        minimum: 0.0,
        maximum: 2.0,
    };
    TrainedModel {
        more_inputs: Vec::new(),
        input: channel("pressure", "bar"),
        output: channel("displacement", "mm"),
        sample_period_s: 0.02,
        mode: Mode::Streaming,
        front_end: schema::FrontEnd {
            lag_coefficient: 1.0,
            play_thresholds: heapless::Vec::from_slice(&[0.5]).unwrap(),
            play_weights: heapless::Vec::from_slice(&[2.0]).unwrap(),
            ..schema::FrontEnd::default()
        },
        network: None,
        provenance: Provenance { preset: "backlash".into(), ..Provenance::default() },
    }
}

fn model() -> NetworkModel {
    NetworkModel::new(backlash(), Path::new("backlash.safetensors")).unwrap()
}

fn recording(period_s: f64, input: &[f64], missing_before: Option<usize>) -> Recording {
    let lost = |index: usize| if missing_before.is_some_and(|gap| index >= gap) { 100.0 } else { 0.0 };
    let time_s = (0..input.len()).map(|index| index as f64 * period_s + lost(index)).collect();
    let output = vec![0.0; input.len()];
    Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.to_vec(), output).unwrap()
}

#[test]
fn a_model_runs_freely_and_starts_afresh_behind_a_gap_or_carries_on() {
    let recording = recording(0.02, &[0.0, 2.0, 1.5, 1.5, 1.0], Some(3));
    // H: 0, 1.5, 1.5, then from rest at 1.5: 1.0, 1.0; carried on: 1.5, 1.5.
    let reset = predict(&model(), &recording, Fit::default()).unwrap();
    assert_eq!(reset, [0.0, 3.0, 3.0, 2.0, 2.0]);
    let carried = predict(&model(), &recording, Fit { gaps: Gaps::Carry, ..Fit::default() }).unwrap();
    assert_eq!(carried, [0.0, 3.0, 3.0, 3.0, 3.0]);
}

#[test]
fn another_sample_period_is_refused_and_can_be_interpolated() {
    let fast: Vec<f64> = (0..400).map(|index| f64::from(index) * 0.005).collect();
    let fast = recording(0.005, &fast, None);
    let message = predict(&model(), &fast, Fit::default()).unwrap_err().to_string();
    assert!(["run.csv", "5 ms", "20 ms", "backlash.safetensors", "--resample"].iter().all(|word| message.contains(word)), "{message}");
    let output = predict(&model(), &fast, Fit { resample: true, ..Fit::default() }).unwrap();
    // On a ramp the interpolation is exact but where the backlash takes up its slack, and behind the model's last whole sample.
    for (input, output) in fast.input.iter().zip(&output).filter(|(input, _)| (**input - 0.5).abs() > 0.02 && **input < 1.98) {
        assert!((output - 2.0 * (input - 0.5).max(0.0)).abs() < 1e-6, "{input} gives {output}");
    }
    // A clock that is a few per cent off is jitter, not another rate.
    assert!(predict(&model(), &recording(0.0205, &[0.0, 1.0, 2.0], None), Fit::default()).is_ok());
}

#[test]
fn another_unit_is_refused_even_when_resampling() {
    let mut foreign = recording(0.02, &[0.0, 1.0], None);
    foreign.input_signal.unit = "kPa".into();
    let message = predict(&model(), &foreign, Fit { resample: true, ..Fit::default() }).unwrap_err().to_string();
    assert!(["run.csv", "kPa", "bar", "input"].iter().all(|word| message.contains(word)), "{message}");
    let mut foreign = recording(0.02, &[0.0, 1.0], None);
    foreign.output_signal.quantity = "force".into();
    assert!(predict(&model(), &foreign, Fit::default()).unwrap_err().to_string().contains("force"));
}

#[test]
fn files_are_told_apart_by_their_ending_and_agree() {
    let folder = tempfile::tempdir().unwrap();
    let trained = backlash();
    let float = folder.path().join("model.safetensors");
    network::save(&float, &trained).unwrap();
    let wire = schema::Model {
        more_inputs: heapless::Vec::new(),
        sample_period_s: 0.02,
        mode: schema::Mode::Streaming,
        input: trained.input.as_wire(),
        output: trained.output.as_wire(),
        front_end: trained.front_end.clone(),
        network: None,
        provenance: schema::Provenance {
            preset: "backlash",
            tool_version: "",
            training_data_sha256: "",
            seed: 0,
            training_recordings: 0,
            optimiser_steps: 0,
        },
        metrics: schema::Metrics::default(),
        envelope: schema::Envelope { minimum: 0.0, maximum: 2.0, maximum_rate: 1.0 },
        golden: schema::Golden { input: &[], output: &[], tolerance: 0.0, digest: 0 },
        extension: &[],
    };
    let fixed = folder.path().join("model.BLOB");
    std::fs::write(&fixed, blob::encode(&wire).unwrap()).unwrap();
    let recording = recording(0.02, &[0.0, 2.0, 1.25, 0.25, 1.0], None);
    let outputs = [&float, &fixed].map(|path| predict(&*load(path).unwrap(), &recording, Fit::default()).unwrap());
    assert_eq!(outputs[0], [0.0, 3.0, 3.0, 1.5, 1.5]);
    assert_eq!(outputs[0], outputs[1]);
    assert_eq!(load(&float).unwrap().description().arithmetic, Arithmetic::Float);
    assert_eq!(load(&fixed).unwrap().description().arithmetic, Arithmetic::FixedPoint);
}

#[test]
fn what_cannot_be_read_is_named_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |name: &str, words: &[&str]| {
        let message = load(&folder.path().join(name)).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(message.contains(name), "{name}: {message}");
        assert!(words.iter().all(|word| message.contains(word)), "{name}: {message}");
    };
    std::fs::create_dir(folder.path().join("folder.blob")).unwrap();
    for ending in ["toml", "safetensors", "blob"] {
        std::fs::write(folder.path().join(format!("noise.{ending}")), [0xa5; 300]).unwrap();
    }
    std::fs::write(folder.path().join("model.txt"), "of another program").unwrap();
    refused("model.txt", &["catheter fit", "identify", "train", "export"]);
    refused("model", &["check the path"]);
    refused("missing.safetensors", &["check the path"]);
    refused("folder.blob", &["folder"]);
    refused("noise.safetensors", &["train"]);
    refused("noise.blob", &["catheter export"]);
    refused("noise.toml", &[]);
}
