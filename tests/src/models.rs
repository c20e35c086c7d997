//! Models made for tests: the shapes of the presets with random weights, which cost and behave like trained ones.
//!
//! Weights are drawn as PyTorch draws those of a new `nn.LSTM` and `nn.Linear`: uniform within one over the square root of the units, biases
//! as the sum of two such draws (PyTorch keeps `b_ih` and `b_hh`). That is the usual stand-in where kernels are compared.

use std::path::Path;

use firmware::parity::Noise;
use host_tool::network::{Activation, Cell, Channel, Layer, Mode, Network, Provenance, TrainedModel};
use host_tool::recording::{Recording, Signal};
use hysteresis::PrandtlIshlinskii;
use model_export::compensation::Compensation;
use model_export::schema::{Curve, Feature, FeatureSource, FrontEnd};

/// Sample period of all models here, in s.
pub const PERIOD_S: f64 = 0.02;

/// A network of LSTM layers over `features` signals with weights drawn from `seed`.
#[must_use]
pub fn network(seed: u32, features: usize, units: &[usize], activation: Activation, state_limit: f32) -> Network {
    drawn(seed, Network::zeros(features, units, activation, state_limit))
}

/// The same of any layers.
#[must_use]
pub fn layered(seed: u32, features: usize, layers: &[(Cell, usize)], activation: Activation) -> Network {
    let mut inputs = features;
    let mut network = Network::zeros(features, &[], activation, 4.0);
    for &(cell, units) in layers {
        network.layers.push(Layer::zeros(cell, inputs, units));
        inputs = units;
    }
    network.dense_weights = vec![0.0; inputs];
    drawn(seed, network)
}

fn drawn(seed: u32, mut network: Network) -> Network {
    let mut noise = Noise::new(seed);
    for layer in &mut network.layers {
        let bound = 1.0 / (layer.units as f32).sqrt();
        let weights = layer.input_weights.iter_mut().chain(&mut layer.recurrent_weights);
        weights.for_each(|weight| *weight = bound * noise.symmetric());
        layer.bias.iter_mut().for_each(|bias| *bias = bound * (noise.symmetric() + noise.symmetric()));
    }
    let bound = 1.0 / (network.dense_weights.len() as f32).sqrt();
    network.dense_weights.iter_mut().for_each(|weight| *weight = bound * noise.symmetric());
    network.dense_bias = bound * noise.symmetric();
    network
}

/// The model around a network or, without one, the front end alone: 0 to 2 bar in, about 0 to 15 mm out.
#[must_use]
pub fn model(front_end: FrontEnd, network: Option<Network>, mode: Mode) -> TrainedModel {
    let channel = |quantity: &str, unit: &str, offset: f32, scale: f32| Channel {
        quantity: quantity.into(),
        unit: unit.into(),
        offset,
        scale,
        minimum: offset - scale,
        maximum: offset + scale,
    };
    TrainedModel {
        input: channel("pressure", "bar", 1.0, 1.0),
        output: channel("displacement", "mm", 7.5, 7.5),
        sample_period_s: PERIOD_S,
        mode,
        front_end,
        network,
        provenance: Provenance { preset: "test".into(), ..Provenance::default() },
    }
}

/// A front end without physics: the network sees these signals as they are.
#[must_use]
pub fn plain_front_end(sources: &[FeatureSource]) -> FrontEnd {
    let features = sources.iter().map(|source| Feature { source: *source, offset: 0.0, gain: 1.0 });
    FrontEnd { lag_coefficient: 1.0, features: features.collect(), ..FrontEnd::default() }
}

/// A front end with `plays` operators and `creeps` filters, dead time, lag and stick band, whose signals the network all sees, as the
/// hybrid preset builds it. The numbers are drawn from `seed`.
#[must_use]
pub fn physics_front_end(seed: u32, plays: u8, creeps: u8) -> FrontEnd {
    let mut noise = Noise::new(seed);
    let mut share = || 0.5 + 0.5 * noise.symmetric();
    let count = f32::from(plays.max(1));
    let mut sources = vec![FeatureSource::InputDifference, FeatureSource::Input, FeatureSource::PathDifference, FeatureSource::Path];
    sources.extend((0..plays).map(FeatureSource::Stop));
    sources.push(FeatureSource::Readout);
    sources.extend((0..creeps).map(FeatureSource::Creep));
    let mut features = plain_front_end(&sources).features;
    for feature in &mut features {
        feature.offset = 0.1 * share();
        feature.gain = 0.5 + share();
    }
    FrontEnd {
        dead_time_samples: 3.0 * share(),
        lag_coefficient: 0.3 + 0.6 * share(),
        play_thresholds: (1..=plays).map(|index| 0.9 * (f32::from(index) / count).powf(1.5)).collect(),
        play_weights: (0..plays).map(|_| share() / count).collect(),
        creep_coefficients: (1..=creeps).map(|index| 0.1 / f32::from(index)).collect(),
        creep_weights: (0..creeps).map(|_| 0.2 * share()).collect(),
        input_weight: share(),
        bias: 0.1 * share(),
        stick_band: 0.01 * share(),
        curve: Some(Curve {
            offset: 0.1 * share(),
            slope: share(),
            bend_points: [-0.5, -0.1, 0.2, 0.6].into_iter().collect(),
            bends: (0..4).map(|_| share() - 0.5).collect(),
        }),
        features,
    }
}

/// A smooth random signal between `minimum` and `maximum`: three sines of random phase and frequency between 0.05 and 2 Hz.
#[must_use]
pub fn smooth_input(seed: u32, samples: usize, minimum: f64, maximum: f64) -> Vec<f64> {
    let mut noise = Noise::new(seed);
    let mut share = || 0.5 + 0.5 * f64::from(noise.symmetric());
    let sines: [(f64, f64); 3] = core::array::from_fn(|_| (std::f64::consts::TAU * PERIOD_S * 0.05 * 40f64.powf(share()), 6.3 * share()));
    let signal = (0..samples).map(|index| {
        let sum: f64 = sines.iter().map(|(rate, phase)| (rate * index as f64 + phase).sin()).sum();
        minimum + (maximum - minimum) * (0.5 + sum / 6.0)
    });
    signal.collect()
}

/// An actuator of 0 to 13 mm over 3 bar with as many play operators and creep filters as a blob holds.
///
/// # Panics
/// Never: its plain part has an inverse.
#[must_use]
pub fn compensation() -> Compensation {
    let thresholds: Vec<f32> = (0..24u8).map(|index| 0.6 * f32::from(index) / 23.0).collect();
    let weights: Vec<f32> = (0..24u8).map(|index| if index == 0 { 2.5 } else { 2.0 / 23.0 }).collect();
    let inverse = PrandtlIshlinskii::<f32, 24>::new(&thresholds, &weights).and_then(|plain| plain.inverse()).expect("an inverse");
    let pairs = |first: &[f32], second: &[f32]| first.iter().zip(second).map(|(first, second)| [*first, *second]).collect();
    Compensation {
        plain_inverse: pairs(inverse.thresholds(), inverse.weights()),
        plays: pairs(&thresholds, &weights),
        creep: [[0.5, 0.01], [2.0, 0.01], [8.0, 0.01], [30.0, 0.01]].into_iter().collect(),
        friction_per_bar: 0.1,
        square_per_mm: -0.002,
        touch_bar: 0.15,
        touch_width_bar: 0.02,
        dead_time_s: 0.02,
        fill_time_constant_s: 0.03,
        vent_time_constant_s: 0.05,
        second_time_constant_s: 0.01,
        highest_bar: 3.0,
        error_mm: 0.1,
        ..Compensation::default()
    }
}

/// The model's blob, calibrated on two smooth recordings of its input range.
///
/// # Panics
/// When the model cannot be exported, which is a mistake in the test.
#[must_use]
pub fn exported(model: &TrainedModel, seed: u32) -> Vec<u8> {
    exported_with(model, seed, None)
}

/// The same with what the controllers need of the actuator in it.
///
/// # Panics
/// As [`exported`].
#[must_use]
pub fn exported_with(model: &TrainedModel, seed: u32, compensation: Option<Compensation>) -> Vec<u8> {
    let (minimum, maximum) = (f64::from(model.input.minimum), f64::from(model.input.maximum));
    let recording = |seed| {
        let input = smooth_input(seed, 1000, minimum, maximum);
        let time_s = (0..input.len()).map(|index| index as f64 * PERIOD_S).collect();
        let output = vec![0.0; input.len()];
        Recording::new(Path::new("calibration.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output)
            .expect("a recording of equal lengths")
    };
    let data = [recording(seed), recording(seed + 1)];
    host_tool::export::export_with(model, &data, compensation).expect("a model that can be exported").bytes
}
