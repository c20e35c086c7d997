//! The fast passes against the plain step, finite differences in f64, and files against damage.

use model_export::schema;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::*;

/// A network with weights of order one, so that gates, clamps and both saturations are all exercised.
fn random_network(seed: u64, features: usize, units: &[usize], activation: Activation, state_limit: f32) -> Network {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let shape = Network::zeros(features, units, activation, state_limit).architecture();
    let flat: Vec<f32> = (0..Layout::new(&shape).len()).map(|_| random.random_range(-0.6..0.6)).collect();
    Network::from_flat(&shape, &flat)
}

fn random_values(seed: u64, count: usize) -> Vec<f32> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| random.random_range(-1.5..1.5)).collect()
}

const SHAPES: [(Activation, f32); 4] = [(Activation::Tanh, 8.0), (Activation::Relu, 0.5), (Activation::Hard, 0.3), (Activation::Relu, 8.0)];

#[test]
fn flat_parameters_survive_the_round_trip() {
    let network = random_network(1, 3, &[5, 7], Activation::Tanh, 4.0);
    assert_eq!(Network::from_flat(&network.architecture(), &network.to_flat()), network);
    assert_eq!(network.to_flat().len(), network.parameters());
}

#[test]
fn the_paper_network_has_49_472_macs_a_step() {
    let network = Network::zeros(1, &[64, 64], Activation::Relu, 8.0);
    assert_eq!(network.macs_per_step(), 49_472);
    assert_eq!(network.parameters(), 49_472 + 2 * 256 + 1);
}

#[test]
fn batched_forward_over_two_chunks_equals_single_steps() {
    for (activation, limit) in SHAPES {
        let network = random_network(7, 3, &[20, 33], activation, limit);
        let flat = network.to_flat();
        let (lanes, steps, features) = (5, 9, 3);
        let mut sequence = Sequence::new(&network.architecture(), lanes, steps);
        let mut states: Vec<NetworkState> = (0..lanes).map(|_| NetworkState::new(&network)).collect();
        for chunk in 0..2 {
            let inputs = random_values(11 + chunk, lanes * steps * features);
            sequence.features_mut(steps).copy_from_slice(&inputs);
            let outputs = sequence.forward(&flat).to_vec();
            for step in 0..steps {
                for (lane, state) in states.iter_mut().enumerate() {
                    let row = step * lanes + lane;
                    let expected = network.step(state, &inputs[row * features..(row + 1) * features]);
                    // Sums in another order and activations within 3e-7, over 18 recurrent steps.
                    assert!((outputs[row] - expected).abs() < 2e-5, "{activation:?} row {row}: {} {expected}", outputs[row]);
                }
            }
            sequence.carry();
            if chunk == 0 {
                sequence.reset_lane(2);
                states[2].reset();
            }
        }
    }
}

/// The equations of the module documentation in f64, from zero state: sum over rows of `factor * output`.
fn weighted_output_f64(architecture: &Architecture, flat: &[f64], inputs: &[f32], factors: &[f32], lanes: usize, steps: usize) -> f64 {
    let layout = Layout::new(architecture);
    let limit = f64::from(architecture.state_limit);
    let act = |x: f64| match architecture.activation {
        Activation::Tanh => x.tanh(),
        Activation::Relu => x.clamp(0.0, limit),
        Activation::Hard => x.clamp(-1.0, 1.0),
    };
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    let mut total = 0.0;
    for lane in 0..lanes {
        let mut hidden: Vec<Vec<f64>> = architecture.units.iter().map(|&units| vec![0.0; units]).collect();
        let mut cell = hidden.clone();
        for step in 0..steps {
            let row = step * lanes + lane;
            let mut input: Vec<f64> =
                inputs[row * architecture.features..][..architecture.features].iter().map(|&x| f64::from(x)).collect();
            for (index, place) in layout.layers.iter().enumerate() {
                let units = place.units;
                let mut z: Vec<f64> = flat[place.bias.clone()].to_vec();
                for (gate, z) in z.iter_mut().enumerate() {
                    for (k, x) in input.iter().enumerate() {
                        *z += flat[place.input_weights.start + k * 4 * units + gate] * x;
                    }
                    for (k, h) in hidden[index].iter().enumerate() {
                        *z += flat[place.recurrent_weights.start + k * 4 * units + gate] * h;
                    }
                }
                for unit in 0..units {
                    let c = sigmoid(z[units + unit]) * cell[index][unit] + sigmoid(z[unit]) * act(z[2 * units + unit]);
                    cell[index][unit] = c.clamp(-limit, limit);
                    hidden[index][unit] = sigmoid(z[3 * units + unit]) * act(cell[index][unit]);
                }
                input.clone_from(&hidden[index]);
            }
            let dense = &flat[layout.dense_weights.clone()];
            let output = flat[layout.dense_bias] + input.iter().zip(dense).map(|(h, w)| h * w).sum::<f64>();
            total += f64::from(factors[row]) * output;
        }
    }
    total
}

#[test]
fn gradients_equal_central_differences_in_f64() {
    for (activation, limit) in SHAPES {
        let (lanes, steps, features) = (3, 6, 2);
        let network = random_network(3, features, &[4, 17], activation, limit);
        let architecture = network.architecture();
        let flat = network.to_flat();
        let inputs = random_values(5, lanes * steps * features);
        let factors = random_values(6, lanes * steps);
        let mut sequence = Sequence::new(&architecture, lanes, steps);
        sequence.features_mut(steps).copy_from_slice(&inputs);
        sequence.forward(&flat);
        sequence.output_gradient_mut().copy_from_slice(&factors);
        let mut gradient = vec![0.0; flat.len()];
        sequence.backward(&flat, &mut gradient);

        let exact: Vec<f64> = flat.iter().map(|&value| f64::from(value)).collect();
        let largest = gradient.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
        assert!(largest > 0.5, "the test needs gradients to speak of, got {largest}");
        for index in 0..flat.len() {
            let shifted = |by: f64| {
                let mut parameters = exact.clone();
                parameters[index] += by;
                weighted_output_f64(&architecture, &parameters, &inputs, &factors, lanes, steps)
            };
            let difference = (shifted(1e-6) - shifted(-1e-6)) / 2e-6;
            let error = (f64::from(gradient[index]) - difference).abs();
            // f32 rounding and the 3e-7 of the activations, over 6 steps and 3 lanes; the largest gradient sets the scale.
            assert!(error < 1e-5 * f64::from(largest).max(1.0), "{activation:?} parameter {index}: {} {difference}", gradient[index]);
        }
    }
}

#[test]
fn carried_state_restores_the_next_chunk_bit_for_bit() {
    let network = random_network(9, 2, &[16, 16], Activation::Tanh, 8.0);
    let flat = network.to_flat();
    let run = |sequence: &mut Sequence, seed| {
        sequence.features_mut(5).copy_from_slice(&random_values(seed, 5 * 4 * 2));
        let outputs = sequence.forward(&flat).to_vec();
        sequence.carry();
        outputs
    };
    let mut first = Sequence::new(&network.architecture(), 4, 5);
    run(&mut first, 1);
    let mut second = Sequence::new(&network.architecture(), 4, 5);
    second.restore_state(&first.carried_state());
    assert_eq!(run(&mut first, 2), run(&mut second, 2));
}

/// `tests/vectors/lstm.json`, made by the script beside it.
#[derive(serde::Deserialize)]
struct Vectors {
    cases: Vec<Case>,
}

#[derive(serde::Deserialize)]
struct Case {
    activation: Activation,
    state_limit: f32,
    features: usize,
    units: Vec<usize>,
    lanes: usize,
    steps: usize,
    input: Vec<f32>,
    target: Vec<f32>,
    parameters: Weights,
    output: Vec<f64>,
    loss: f64,
    gradient: Weights,
}

#[derive(serde::Deserialize)]
struct Weights {
    layers: Vec<LayerWeights>,
    dense_weights: Vec<f32>,
    dense_bias: f32,
}

#[derive(serde::Deserialize)]
struct LayerWeights {
    input_weights: Vec<f32>,
    recurrent_weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Weights {
    fn network(&self, case: &Case) -> Network {
        let mut network = Network::zeros(case.features, &case.units, case.activation, case.state_limit);
        for (layer, weights) in network.layers.iter_mut().zip(&self.layers) {
            layer.input_weights.copy_from_slice(&weights.input_weights);
            layer.recurrent_weights.copy_from_slice(&weights.recurrent_weights);
            layer.bias.copy_from_slice(&weights.bias);
        }
        network.dense_weights.copy_from_slice(&self.dense_weights);
        network.dense_bias = self.dense_bias;
        network
    }
}

#[test]
fn forward_and_gradients_equal_those_of_pytorch() {
    let vectors: Vectors = serde_json::from_str(include_str!("../../../../tests/vectors/lstm.json")).unwrap();
    assert_eq!(vectors.cases.len(), 3);
    for case in &vectors.cases {
        let network = case.parameters.network(case);
        let flat = network.to_flat();
        let mut sequence = Sequence::new(&network.architecture(), case.lanes, case.steps);
        sequence.features_mut(case.steps).copy_from_slice(&case.input);
        sequence.forward(&flat);
        let (outputs, gradient) = sequence.outputs_and_gradient_mut();
        let count = outputs.len() as f32;
        let mut loss = 0.0;
        for (row, &output) in outputs.iter().enumerate() {
            // f32 sums and activations within 3e-7, over 9 steps and 2 layers.
            assert!((f64::from(output) - case.output[row]).abs() < 5e-6, "{:?} row {row}", case.activation);
            let error = output - case.target[row];
            loss += f64::from(error * error / count);
            gradient[row] = 2.0 * error / count;
        }
        assert!((loss - case.loss).abs() < 1e-5 * case.loss, "{:?}: {loss} {}", case.activation, case.loss);
        let mut found = vec![0.0; flat.len()];
        sequence.backward(&flat, &mut found);
        let expected = case.gradient.network(case).to_flat();
        let largest = expected.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
        assert!(largest > 0.01);
        for (index, (found, expected)) in found.iter().zip(&expected).enumerate() {
            assert!((found - expected).abs() < 1e-5 * largest, "{:?} parameter {index}: {found} {expected}", case.activation);
        }
    }
}

fn model() -> TrainedModel {
    let channel = |quantity: &str, unit: &str| Channel {
        quantity: quantity.to_owned(),
        unit: unit.to_owned(),
        offset: 0.1,
        scale: 2.0,
        minimum: -1.9,
        maximum: 2.1,
    };
    let feature = |source| schema::Feature { source, offset: 0.25, gain: 1.0 / 3.0 };
    let mut front_end = schema::FrontEnd { lag_coefficient: 0.7, bias: 0.1, ..schema::FrontEnd::default() };
    front_end.play_thresholds.push(0.3).unwrap();
    front_end.play_weights.push(1.1).unwrap();
    front_end.features.push(feature(schema::FeatureSource::Input)).unwrap();
    front_end.features.push(feature(schema::FeatureSource::Play(0))).unwrap();
    TrainedModel {
        more_inputs: Vec::new(),
        input: channel("pressure", "bar"),
        output: channel("displacement", "mm"),
        sample_period_s: 0.02,
        mode: Mode::Streaming,
        front_end,
        network: Some(random_network(21, 2, &[6, 4], Activation::Hard, 3.0)),
        provenance: Provenance { preset: "hybrid".to_owned(), seed: 7, validation_rmse: 0.125, ..Provenance::default() },
    }
}

#[test]
fn a_model_survives_the_file_bit_for_bit_with_and_without_network() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    for model in [model(), TrainedModel { network: None, mode: Mode::Window { length: 50 }, ..model() }] {
        save(&path, &model).unwrap();
        assert_eq!(load(&path).unwrap(), model);
    }
}

#[test]
fn every_truncation_of_a_model_file_is_refused() {
    let bytes = to_bytes(&model()).unwrap();
    for length in 0..bytes.len() {
        assert!(from_bytes(&bytes[..length], "model.safetensors").is_err(), "{length} of {} bytes", bytes.len());
    }
}

#[test]
fn a_model_with_further_stages_is_read_as_it_was_written() {
    let mut staged = model();
    staged.front_end.lag_coefficient = 1.0;
    let tip = model_export::schema::Filter { momentum: 0.5, gains: [0.25, 0.125, 0.0] };
    staged.front_end.stages = Some(model_export::schema::Stages { tip: Some(tip), ..Default::default() });
    let bytes = to_bytes(&staged).unwrap();
    assert!(bytes.windows(20).any(|window| window == b"\\\"format_version\\\":4"), "older programs must refuse it");
    assert_eq!(from_bytes(&bytes, "m.safetensors").unwrap(), staged);
}

/// The file with a piece of its metadata replaced by one of the same length, so that the rest stays in place.
fn with_metadata(from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let mut bytes = to_bytes(&model()).unwrap();
    let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).expect("the metadata hold the text");
    bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
    bytes
}

#[test]
fn another_version_shape_or_origin_is_refused_by_name() {
    let refusal = |bytes: &[u8]| from_bytes(bytes, "m.safetensors").unwrap_err().to_string();
    let version = refusal(&with_metadata("\\\"format_version\\\":1", "\\\"format_version\\\":9"));
    assert!(version.contains("m.safetensors") && version.contains("version 9") && version.contains("reads versions 1 to 4"), "{version}");
    let shape = refusal(&with_metadata("\\\"units\\\":[6,4]", "\\\"units\\\":[6,5]"));
    assert!(shape.contains("layers.1.input_weights") && shape.contains("[20, 6]"), "{shape}");
    let features = refusal(&with_metadata("\\\"features\\\":2,", "\\\"features\\\":3,"));
    assert!(features.contains("layers.0.input_weights"), "{features}");
    let foreign = refusal(&with_metadata("catheter-model", "somebody-model"));
    assert!(foreign.contains("`catheter-model` is missing"), "{foreign}");
    let limit = refusal(&with_metadata("\\\"state_limit\\\":3.0", "\\\"state_limit\\\":-30"));
    assert!(limit.contains("state_limit"), "{limit}");
}

#[test]
fn a_weight_that_is_not_finite_is_refused() {
    let mut model = model();
    model.network.as_mut().unwrap().dense_weights[2] = f32::NAN;
    let error = from_bytes(&to_bytes(&model).unwrap(), "m.safetensors").unwrap_err().to_string();
    assert!(error.contains("dense.weights") && error.contains("element 2"), "{error}");
}

#[test]
fn a_window_model_sees_the_last_samples_only_and_rests_before_the_first() {
    let model = TrainedModel { mode: Mode::Window { length: 5 }, ..model() };
    let mut model = model;
    // Without play operators the front end has no memory of its own.
    model.front_end.play_weights[0] = 0.0;
    model.front_end.lag_coefficient = 1.0;
    model.front_end.features[1].source = schema::FeatureSource::InputDifference;
    let tail = [0.3, 1.4, 0.9, 0.2, 1.1];
    let run = |before: &[f64]| {
        let input: Vec<f64> = before.iter().chain(&tail).copied().collect();
        *model.predict(&[&input], &[]).unwrap().last().unwrap()
    };
    // Six samples before the window cannot be seen, but for the difference into the first one.
    assert_eq!(run(&[1.0, 0.0, 2.0, 0.3]), run(&[0.5, 0.3]));
    assert_ne!(run(&[0.5, 0.3]), run(&[0.5, 0.7]), "the difference into the window's first sample");
    // Side by side or one by one, the windows are the same, over more of them than run side by side and across a gap.
    let input: Vec<f64> = (0..150).map(|sample| 1.0 + (f64::from(sample) * 0.3).sin()).collect();
    let mut runner = model.runner().unwrap();
    let single: Vec<f64> = (0..input.len())
        .map(|index| {
            if index == 70 {
                runner.reset();
            }
            runner.step(&[input[index] as f32])
        })
        .collect();
    let batched = model.predict(&[&input], &[70]).unwrap();
    assert_eq!(batched.len(), single.len());
    // Rounding of sums in another order.
    assert!(batched.iter().zip(&single).all(|(batched, single)| (batched - single).abs() < 1e-5), "{batched:?} {single:?}");
    // At the start the window is filled with the first sample at rest.
    let rested = model.predict(&[&[0.6; 9]], &[]).unwrap();
    assert!(rested.iter().all(|&value| value == rested[0]), "{rested:?}");
}

#[test]
fn a_gap_starts_the_model_afresh() {
    let model = model();
    let input: Vec<f64> = (0..40).map(|sample| (f64::from(sample) * 0.3).sin() + 1.0).collect();
    let whole = model.predict(&[&input], &[25]).unwrap();
    assert_eq!(whole[25..], model.predict(&[&input[25..]], &[]).unwrap());
    assert_ne!(whole[25..], model.predict(&[&input], &[]).unwrap()[25..]);
}
