//! A small hybrid for tests: play operators and an LSTM with random weights, exported as a blob that every check lets pass.

use std::path::Path;

use host_tool::network::{Activation, Channel, Mode, Network, Provenance, TrainedModel};
use host_tool::recording::{Recording, Signal};
use model_export::schema::{self, Feature, FeatureSource};

/// A hybrid over 0 to 3 bar with layers of this many units and weights from a small generator.
fn trained(units: &[usize]) -> TrainedModel {
    let channel = |quantity: &str, unit: &str, scale: f32| Channel {
        quantity: quantity.into(),
        unit: unit.into(),
        offset: 0.0,
        scale,
        minimum: 0.0,
        maximum: scale,
    };
    let feature = |source| Feature { source, offset: 0.0, gain: 1.0 };
    let features = [feature(FeatureSource::Input), feature(FeatureSource::Stop(0)), feature(FeatureSource::Play(1))];
    let mut network = Network::zeros(3, units, Activation::Tanh, 4.0);
    let mut noise = 7u32;
    let mut weight = || {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (f64::from(noise) / f64::from(u32::MAX) - 0.5) as f32
    };
    for layer in &mut network.layers {
        layer.input_weights.iter_mut().chain(&mut layer.recurrent_weights).chain(&mut layer.bias).for_each(|entry| *entry = weight());
    }
    network.dense_weights.iter_mut().for_each(|entry| *entry = 0.1 * weight());
    TrainedModel {
        more_inputs: Vec::new(),
        input: channel("pressure", "bar", 3.0),
        output: channel("displacement", "mm", 15.0),
        sample_period_s: 0.02,
        mode: Mode::Streaming,
        front_end: schema::FrontEnd {
            lag_coefficient: 0.8,
            play_thresholds: heapless::Vec::from_slice(&[0.05, 0.1]).unwrap(),
            play_weights: heapless::Vec::from_slice(&[0.4, 0.5]).unwrap(),
            features: heapless::Vec::from_slice(&features).unwrap(),
            ..schema::FrontEnd::default()
        },
        network: Some(network),
        provenance: Provenance { preset: "test".into(), ..Provenance::default() },
    }
}

/// A blob that every check lets pass: play operators and an LSTM with layers of this many units.
///
/// # Panics
/// Never: the model is a sound one.
#[must_use]
pub fn exported(units: &[usize]) -> Vec<u8> {
    let input: Vec<f64> = (0..500).map(|index| 1.4 - 1.4 * (f64::from(index) * 0.1).cos()).collect();
    let time_s = (0..500).map(|index| f64::from(index) * 0.02).collect();
    let output = vec![0.0; 500];
    let recording = Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output).unwrap();
    host_tool::export::export(&trained(units), &[recording]).unwrap().bytes
}
