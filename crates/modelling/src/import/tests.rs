//! Networks as PyTorch, Keras and the ONNX runtime ran them (`tests/vectors/import`), and what is refused, by name.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use safetensors::tensor::{Dtype, TensorView, serialize};

use super::options::{FeatureKind, InputOptions, NetworkInput};
use super::*;
use crate::export;
use crate::network::{Activation, Mode};
use recording::{Channel, Recording, Signal};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors/import")
}

/// A plant of one input.
fn one(input: InputOptions) -> [InputOptions; 4] {
    [input, InputOptions::default(), InputOptions::default(), InputOptions::default()]
}

/// What is said of the pressure, changed.
fn pressure(change: impl FnOnce(&mut InputOptions)) -> [InputOptions; 4] {
    let mut inputs = said().inputs;
    change(&mut inputs[0]);
    inputs
}

fn seen(kind: FeatureKind) -> NetworkInput {
    NetworkInput { channel: 0, kind }
}

/// What was said of a network that brings no metadata.
fn said() -> Options {
    Options {
        inputs: one(InputOptions { signal: Some(Signal::pressure_bar()), range: Some([0.0, 3.0]), ..InputOptions::default() }),
        output: Some(Signal::displacement_mm()),
        sample_period_s: Some(0.02),
        output_range: Some([0.0, 12.0]),
        ..Options::default()
    }
}

/// Every network in the folder, with what must be said of it.
fn networks() -> Vec<(&'static str, Options)> {
    let both = Some(vec![seen(FeatureKind::Input), seen(FeatureKind::Difference)]);
    let stepping = pressure(|input| input.largest_step = Some(0.1));
    let difference = Options { features: both, mode: Some(Mode::Streaming), inputs: stepping, ..said() };
    let window = Options {
        mode: Some(Mode::Window { length: 25 }),
        inputs: pressure(|input| (input.offset, input.scale) = (Some(1.5), Some(1.5))),
        output_offset: Some(5.0),
        output_scale: Some(4.0),
        ..said()
    };
    vec![
        ("torch_single.safetensors", Options::default()),
        ("torch_double.safetensors", difference.clone()),
        ("torch_pair.safetensors", Options::default()),
        ("torch_window.safetensors", Options::default()),
        ("keras_single.safetensors", Options::default()),
        ("keras_double.safetensors", Options::default()),
        ("keras_relu.safetensors", Options::default()),
        ("onnx_by_hand.onnx", Options::default()),
        ("onnx_torch_double.onnx", Options { mode: None, ..difference }),
        ("onnx_torch_window.onnx", window.clone()),
        ("torch_gru.safetensors", Options::default()),
        ("torch_gru_dense.safetensors", Options::default()),
        ("torch_dense.safetensors", Options::default()),
        ("keras_gru_dense.safetensors", Options::default()),
        ("onnx_torch_gru.onnx", Options { mode: None, ..window.clone() }),
        (
            "onnx_torch_dense.onnx",
            Options { mode: None, features: Some((0..10).rev().map(FeatureKind::Lag).map(seen).collect()), ..window },
        ),
        ("torch_two_inputs.safetensors", Options::default()),
    ]
}

fn imported(name: &str, options: Options) -> (TrainedModel, CheckVectors) {
    let mut found = read(&folder().join(name), options).unwrap_or_else(|error| panic!("{name}: {error}"));
    let path = folder().join(name).with_extension("csv");
    let inputs = vec![None; found.options.named_inputs().expect("inputs")];
    let vectors = CheckVectors::parse(&std::fs::read(&path).expect("the vectors"), &path, &inputs, None).expect("vectors");
    let model = found.model(Some(&vectors)).unwrap_or_else(|error| panic!("{name}: {error}"));
    (model, vectors)
}

#[test]
fn every_framework_s_network_computes_what_the_framework_did_to_a_millionth_of_the_range() {
    for (name, options) in networks() {
        let (model, vectors) = imported(name, options);
        let parity = vectors.compare(&model).expect("a model that runs");
        println!("{name}: {:.2e} of the range over {} samples", parity.largest_of_range, parity.samples);
        assert!(parity.passed, "{name}: {parity:?}");
        assert!(parity.samples >= 136, "{name}: only {} samples compared", parity.samples);
    }
}

#[test]
fn every_imported_network_s_blob_stays_within_a_thousandth_of_the_range() {
    let mut far = Vec::new();
    for (name, options) in networks() {
        let (model, vectors) = imported(name, options);
        let time_s = (0..vectors.expected.len()).map(|index| index as f64 * 0.02).collect();
        let output = vectors.expected.iter().map(|value| value.unwrap_or(0.0)).collect();
        let signal = |channel: &crate::network::Channel| Signal { quantity: channel.quantity.clone(), unit: channel.unit.clone() };
        let (first, path) = (vectors.inputs[0].clone(), Path::new("check.csv"));
        let mut recording = Recording::new(path, signal(&model.input), signal(&model.output), time_s, first, output).expect("a recording");
        let more = model.more_inputs.iter().zip(&vectors.inputs[1..]);
        recording.more_inputs = more.map(|(channel, values)| Channel { signal: signal(channel), values: values.clone() }).collect();
        let export = export::export(&model, &[recording]).unwrap_or_else(|error| panic!("{name}: {error}"));
        let [low, high] = vectors.output_range().expect("outputs");
        let worst = export.comparison.max_abs / (high - low);
        println!("{name}: largest {worst:.2e}, RMSE {:.2e} of the range", export.comparison.rmse / (high - low));
        if worst > 1e-3 {
            far.push(format!("{name}: {worst:.2e}"));
        }
    }
    assert!(far.is_empty(), "of the range: {far:?}");
}

#[test]
fn a_model_survives_its_file() {
    let (model, _) = imported("torch_single.safetensors", Options::default());
    let bytes = crate::network::to_bytes(&model).expect("a model that can be written");
    assert_eq!(crate::network::from_bytes(&bytes, "model").expect("a model that can be read"), model);
}

#[test]
fn features_of_any_range_lie_within_one_and_the_network_stays_the_same() {
    for high in [0.003, 0.9, 1.0, 3.0, 4000.0] {
        let options = Options { inputs: pressure(|input| input.range = Some([0.0, high])), ..said() };
        let mut found = read(&folder().join("torch_single.safetensors"), options).expect("a network");
        let model = found.model(None).expect("a model");
        let span = (high - 1.5).abs().max(1.5) / 1.5;
        let reached = span * f64::from(model.front_end.features[0].gain);
        assert!(reached > 0.5 && reached <= 1.0, "range to {high}: features reach {reached}");
    }
}

type Made<'a> = (&'a str, &'a [usize]);

/// A state of small numbers in these shapes.
fn state(tensors: &[Made<'_>], metadata: &[(&str, &str)]) -> Vec<u8> {
    let data: Vec<Vec<u8>> = tensors
        .iter()
        .map(|(_, shape)| (0..shape.iter().product::<usize>()).flat_map(|index| (0.01 * (index % 7) as f32).to_le_bytes()).collect())
        .collect();
    let views =
        tensors.iter().zip(&data).map(|((name, shape), bytes)| (*name, TensorView::new(Dtype::F32, shape.to_vec(), bytes).unwrap()));
    let metadata: HashMap<String, String> = metadata.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect();
    serialize(views, Some(metadata)).expect("a file")
}

/// A PyTorch state of one layer with this many rows a unit, and a linear output.
fn torch(inputs: usize, units: usize, rows: usize) -> Vec<(String, Vec<usize>)> {
    vec![
        ("lstm.weight_ih_l0".to_owned(), vec![rows * units, inputs]),
        ("lstm.weight_hh_l0".to_owned(), vec![rows * units, units]),
        ("lstm.bias_ih_l0".to_owned(), vec![rows * units]),
        ("lstm.bias_hh_l0".to_owned(), vec![rows * units]),
        ("head.weight".to_owned(), vec![1, units]),
        ("head.bias".to_owned(), vec![1]),
    ]
}

fn keras(units: usize, columns: usize) -> Vec<(String, Vec<usize>)> {
    vec![
        ("lstm/lstm_cell/kernel".to_owned(), vec![1, columns * units]),
        ("lstm/lstm_cell/recurrent_kernel".to_owned(), vec![units, columns * units]),
        ("lstm/lstm_cell/bias".to_owned(), vec![columns * units]),
        ("dense/kernel".to_owned(), vec![units, 1]),
        ("dense/bias".to_owned(), vec![1]),
    ]
}

/// `base` with tensors added, or replaced, or (without a shape) left out.
fn changed(base: &[(String, Vec<usize>)], changes: &[(&str, Option<&[usize]>)]) -> Vec<u8> {
    let mut tensors: Vec<Made<'_>> = base.iter().map(|(name, shape)| (name.as_str(), shape.as_slice())).collect();
    for (name, shape) in changes {
        tensors.retain(|(other, _)| other != name);
        tensors.extend(shape.map(|shape| (*name, shape)));
    }
    state(&tensors, &[])
}

fn complaint(bytes: &[u8], options: Options) -> String {
    let result = from_bytes(bytes, options).and_then(|mut found| found.model(None));
    result.expect_err("a refusal").to_string()
}

#[test]
fn what_a_pytorch_state_holds_that_the_model_does_not_is_refused_by_name() {
    let good = || torch(1, 8, 4);
    let streaming = || Options { mode: Some(Mode::Streaming), ..said() };
    assert!(from_bytes(&changed(&good(), &[]), streaming()).and_then(|mut found| found.model(None)).is_ok());
    let four: Vec<(String, &[usize])> =
        (1..5).flat_map(|layer| ["ih", "hh"].map(|kind| (format!("lstm.weight_{kind}_l{layer}"), &[32, 8][..]))).collect();
    let four: Vec<(&str, Option<&[usize]>)> = four.iter().map(|(name, shape)| (name.as_str(), Some(*shape))).collect();
    let cases: Vec<(Vec<u8>, &[&str])> = vec![
        (changed(&torch(1, 8, 1), &[]), &["lstm.weight_hh_l0", "plain recurrent", "LSTM, GRU"]),
        (changed(&torch(1, 65, 4), &[]), &["65 units", "64"]),
        (changed(&good(), &four), &["5 layers", "4"]),
        (changed(&good(), &[("lstm.weight_ih_l0_reverse", Some(&[32, 1]))]), &["lstm.weight_ih_l0_reverse", "bidirectional"]),
        (changed(&good(), &[("lstm.weight_hr_l0", Some(&[4, 8]))]), &["lstm.weight_hr_l0", "projection", "proj_size"]),
        (changed(&good(), &[("norm.weight", Some(&[8])), ("norm.bias", Some(&[8]))]), &["norm.weight", "normalisation"]),
        (changed(&good(), &[("batch.running_mean", Some(&[8]))]), &["batch.running_mean", "batch normalisation"]),
        (changed(&good(), &[("conv.weight", Some(&[4, 1, 3]))]), &["conv.weight", "convolution"]),
        (changed(&good(), &[("middle.weight", Some(&[8, 8])), ("middle.bias", Some(&[8]))]), &["dense layers", "--dense-activation"]),
        (changed(&good(), &[("middle.weight", Some(&[6, 8])), ("head.weight", Some(&[1, 6]))]), &["dense layers", "--dense-activation"]),
        (changed(&good(), &[("head.weight", Some(&[3, 8])), ("head.bias", Some(&[3]))]), &["head.weight", "3 outputs"]),
        (changed(&good(), &[("head.weight", None), ("head.bias", None)]), &["without a dense output", "8 units"]),
        (changed(&good(), &[("head.weight", Some(&[1, 16]))]), &["`head.weight` with 16 inputs", "8 units"]),
        (changed(&good(), &[("lstm.bias_hh_l0", None)]), &["lstm.bias_hh_l0", "missing"]),
        (changed(&good(), &[("lstm.bias_hh_l0", Some(&[31]))]), &["lstm.bias_hh_l0", "[31]", "[32]"]),
        (changed(&good(), &[("lstm.weight_ih_l0", Some(&[30, 1]))]), &["lstm.weight_ih_l0", "[30, 1]", "[32, 1]"]),
        (changed(&good(), &[("lstm.weight_hh_l0", Some(&[0, 0]))]), &["lstm.weight_hh_l0", "[0, 0]"]),
        (changed(&good(), &[("in_proj", Some(&[1, 1, 1]))]), &["in_proj", "belongs to no LSTM, GRU or dense"]),
        (changed(&torch(33, 8, 4), &[]), &["33 inputs", "32"]),
        (changed(&torch(2, 8, 4), &[]), &["the inputs", "--features"]),
        (changed(&[], &[("fc1.weight", Some(&[8, 1])), ("fc2.weight", Some(&[1, 8]))]), &["--dense-activation"]),
        (changed(&[], &[("fc.weight", Some(&[1, 1]))]), &["fc.weight", "linear map"]),
        (changed(&[], &[("anything", Some(&[8, 1]))]), &["without a layer", "anything"]),
    ];
    for (bytes, words) in cases {
        let complaint = complaint(&bytes, streaming());
        assert!(words.iter().all(|word| complaint.contains(word)), "{words:?} in: {complaint}");
    }
}

#[test]
fn what_a_keras_state_holds_that_the_model_does_not_is_refused_by_name() {
    let good = || keras(8, 4);
    let streaming = || Options { mode: Some(Mode::Streaming), activation: Some(Activation::Tanh), ..said() };
    assert!(from_bytes(&changed(&good(), &[]), streaming()).and_then(|mut found| found.model(None)).is_ok());
    let gru: [(&str, Option<&[usize]>); 1] = [("lstm/lstm_cell/bias", Some(&[2, 24]))];
    assert!(from_bytes(&changed(&keras(8, 3), &gru), streaming()).and_then(|mut found| found.model(None)).is_ok());
    let cases: Vec<(Vec<u8>, &[&str])> = vec![
        (changed(&keras(8, 3), &[]), &["lstm/lstm_cell/bias", "reset_after=False", "reset_after=True"]),
        (changed(&keras(8, 3), &[("lstm/lstm_cell/bias", None)]), &["GRU without biases", "use_bias"]),
        (changed(&keras(8, 1), &[]), &["recurrent_kernel", "plain recurrent"]),
        (changed(&keras(65, 4), &[]), &["65 units"]),
        (changed(&good(), &[("bidirectional/backward_lstm/kernel", Some(&[1, 32]))]), &["bidirectional/backward_lstm/kernel", "future"]),
        (changed(&good(), &[("norm/gamma", Some(&[8]))]), &["norm/gamma", "normalisation"]),
        (changed(&good(), &[("normalization/mean", Some(&[1]))]), &["normalization/mean", "--input-offset"]),
        (changed(&good(), &[("middle/kernel", Some(&[8, 8]))]), &["dense layers", "--dense-activation"]),
        (changed(&good(), &[("dense/kernel", Some(&[8, 2])), ("dense/bias", Some(&[2]))]), &["dense/kernel", "2 outputs"]),
        (changed(&good(), &[("dense/kernel", Some(&[8, 2]))]), &["dense/bias", "[1]", "[2]"]),
        (changed(&good(), &[("lstm/lstm_cell/kernel", None)]), &["lstm/kernel", "missing"]),
        (changed(&good(), &[("embedding/embeddings", Some(&[8, 2]))]), &["embedding/embeddings", "belongs to no LSTM, GRU or dense"]),
    ];
    for (bytes, words) in cases {
        let complaint = complaint(&bytes, streaming());
        assert!(words.iter().all(|word| complaint.contains(word)), "{words:?} in: {complaint}");
    }
    let silent = complaint(&changed(&good(), &[]), Options { activation: None, ..streaming() });
    assert!(silent.contains("activation") && silent.contains("--activation tanh"), "{silent}");
}

#[test]
fn nothing_that_weights_do_not_tell_is_guessed() {
    let bytes = changed(&torch(1, 8, 4), &[]);
    let full = || Options { mode: Some(Mode::Streaming), ..said() };
    let cases: Vec<(Options, &str)> = vec![
        (Options { inputs: Default::default(), ..full() }, "--input"),
        (Options { output: None, ..full() }, "--output"),
        (Options { sample_period_s: None, ..full() }, "--sample-period-s"),
        (Options { inputs: pressure(|input| input.range = None), ..full() }, "--input-range"),
        (Options { output_range: None, ..full() }, "--output-range"),
        (Options { mode: None, ..full() }, "--streaming"),
        (Options { features: Some(vec![seen(FeatureKind::Input), seen(FeatureKind::Difference)]), ..full() }, "--features"),
        (Options { activation: Some(Activation::Relu), ..full() }, "--activation"),
        (Options { mode: Some(Mode::Window { length: 2000 }), ..full() }, "window of 2000"),
    ];
    for (options, word) in cases {
        let complaint = complaint(&bytes, options);
        assert!(complaint.contains(word), "{word} in: {complaint}");
    }
    let difference = Options { features: Some(vec![seen(FeatureKind::Input), seen(FeatureKind::Difference)]), ..full() };
    assert!(complaint(&changed(&torch(2, 8, 4), &[]), difference).contains("--largest-step"));
    let tensors = torch(1, 8, 4);
    let made: Vec<Made<'_>> = tensors.iter().map(|(name, shape)| (name.as_str(), shape.as_slice())).collect();
    for (key, value) in [("catheter.inptu", "pressure:bar"), ("catheter.input_scale", "-1"), ("catheter.input_range", "3,0")] {
        let complaint = complaint(&state(&made, &[(key, value)]), full());
        assert!(complaint.contains(key), "{key} in: {complaint}");
    }
}

#[test]
fn inputs_and_features_belong_together() {
    let bytes = changed(&torch(2, 8, 4), &[]);
    let two = || {
        let mut inputs = said().inputs;
        inputs[1] = inputs[0].clone();
        Options { inputs, mode: Some(Mode::Streaming), ..said() }
    };
    let of = |channel| NetworkInput { channel, kind: FeatureKind::Input };
    let model = from_bytes(&bytes, two()).expect("a network").model(None).expect("the inputs in their order");
    assert_eq!(model.front_end.feature_inputs[..], [0, 1]);
    let unnamed = || {
        let mut inputs = said().inputs;
        inputs[2].scale = Some(2.0);
        inputs
    };
    let cases = [
        (Options { features: Some(vec![of(0), of(2)]), ..two() }, "input 3"),
        (Options { features: Some(vec![of(1), of(1)]), ..two() }, "nothing of input 1"),
        (Options { inputs: unnamed(), ..two() }, "said of input 3"),
    ];
    for (options, words) in cases {
        let complaint = complaint(&bytes, options);
        assert!(complaint.contains(words), "{words} in: {complaint}");
    }
    assert_eq!(
        options::features("input2, lag3:1..0, difference"),
        Ok(vec![
            of(1),
            NetworkInput { channel: 2, kind: FeatureKind::Lag(1) },
            NetworkInput { channel: 2, kind: FeatureKind::Lag(0) },
            seen(FeatureKind::Difference),
        ])
    );
    assert!(options::features("input5").is_err() && options::features("input1").is_err() && options::features("lag2").is_err());
}

#[test]
fn two_modules_of_equal_widths_need_their_order() {
    let tensors = [("a.weight_ih_l0", &[4, 1][..]), ("a.weight_hh_l0", &[4, 1]), ("b.weight_ih_l0", &[4, 1]), ("b.weight_hh_l0", &[4, 1])];
    let bytes = state(&tensors, &[]);
    let streaming = || Options { mode: Some(Mode::Streaming), ..said() };
    let complaint = complaint(&bytes, streaming());
    assert!(complaint.contains("--layers a,b"), "{complaint}");
    let found = from_bytes(&bytes, Options { layers: Some(vec!["b".into(), "a".into()]), ..streaming() }).expect("a network");
    assert!(found.network.layers[0].name.starts_with('b'), "{:?}", found.network.layers[0].name);
    let wrong = from_bytes(&bytes, Options { layers: Some(vec!["b".into(), "c".into()]), ..streaming() }).expect_err("no such layer");
    assert!(wrong.to_string().contains("`a,b`"), "{wrong}");
}

#[test]
fn other_types_of_numbers_are_read_or_refused_by_name() {
    let single = |dtype: Dtype, bytes: &[u8]| {
        serialize([("lstm.weight_ih_l0", TensorView::new(dtype, vec![1, 1], bytes).unwrap())], None).expect("a file")
    };
    assert!(complaint(&single(Dtype::I32, &[0; 4]), said()).contains("I32"));
    assert!(complaint(&single(Dtype::F32, &f32::NAN.to_le_bytes()), said()).contains("not finite"));
    assert!(complaint(&single(Dtype::F64, &[0; 8]), said()).contains("weight_hh_l0"), "F64 is read");
    assert!(complaint(&single(Dtype::F16, &[0; 2]), said()).contains("weight_hh_l0"), "F16 is read");
}

#[test]
fn files_of_other_kinds_are_named() {
    let model = crate::network::to_bytes(&imported("torch_single.safetensors", Options::default()).0).expect("a model");
    let cases: [(&[u8], &str); 6] = [
        (b"", "empty"),
        (b"PK\x03\x04 and more", "ZIP"),
        (b"\x89HDF\r\n\x1a\n", "HDF5"),
        (b"\x80\x02}q\x00", "pickle"),
        (b"time_s,pressure_bar\n", "neither a safetensors nor an ONNX"),
        (&model, "already a model"),
    ];
    for (bytes, word) in cases {
        let complaint = complaint(bytes, Options::default());
        assert!(complaint.contains(word), "{word} in: {complaint}");
    }
}

fn file(name: &str) -> Vec<u8> {
    std::fs::read(folder().join(name)).expect("a network")
}

#[test]
fn a_file_cut_off_anywhere_is_refused() {
    for name in ["torch_single.safetensors", "onnx_torch_window.onnx"] {
        let bytes = file(name);
        for length in (0..bytes.len()).step_by(97) {
            complaint(&bytes[..length], said());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Flipped bytes may leave a network, never a panic, a hang or a huge allocation.
    #[test]
    fn damaged_files_do_not_panic(which in 0usize..3, flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        let mut bytes = file(["torch_double.safetensors", "onnx_by_hand.onnx", "onnx_torch_double.onnx"][which]);
        for (place, value) in flips {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        let _ = from_bytes(&bytes, said()).and_then(|mut found| found.model(None));
    }

    #[test]
    fn garbage_does_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = from_bytes(&bytes, said()).and_then(|mut found| found.model(None));
    }
}
