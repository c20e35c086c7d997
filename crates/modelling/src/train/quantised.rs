//! Quantisation-aware training: the forward pass by the firmware's own fixed-point code, the backward pass straight through in f32.
//!
//! Each optimiser step rounds the weights to int8 (to nearest, a scale per row), runs the chunk through [`firmware::estimator::Network`]
//! and hands gates and states to the f32 backward pass as if they had come from it. The rounding itself counts as the identity there
//! (straight-through estimator; Bengio et al., 2013). What training leaves are the weights that the integers stand for, so that
//! exporting them rounds nothing more.

use firmware::estimator::{Network as FixedNetwork, NetworkState, Trace, UnitTrace, quantise_feature};
use model_export::quantise::{LayerCalibration, QuantiseError, QuantisedNetwork, quantise};
use model_export::schema::MAX_WIDTH;

use crate::export::float_network;
use crate::network::{Architecture, Network, Sequence};

/// Rounds the parameters (in flat order) to nearest; `largest_hidden` is the largest magnitude of each layer's hidden state in use.
///
/// # Errors
/// When a weight does not fit its format.
pub fn rounded(architecture: &Architecture, flat: &[f32], largest_hidden: &[f64]) -> Result<(QuantisedNetwork, Vec<f32>), QuantiseError> {
    let mut network = Network::from_flat(architecture, flat);
    let calibration: Vec<LayerCalibration> =
        largest_hidden.iter().map(|&hidden_max| LayerCalibration { hidden_max, moments: None }).collect();
    let fixed = quantise(&float_network(&network), &calibration)?;
    for (layer, fixed) in network.layers.iter_mut().zip(&fixed.layers) {
        layer.input_weights = fixed.real_input_weights();
        layer.recurrent_weights = fixed.real_recurrent_weights();
    }
    network.dense_weights = fixed.real_dense_weights();
    Ok((fixed, network.to_flat()))
}

/// Writes what it sees into the sequence's buffers.
struct Recorder<'a> {
    sequence: &'a mut Sequence,
    lane: usize,
    step: usize,
}

impl Trace for Recorder<'_> {
    fn unit(&mut self, layer: usize, unit: usize, values: &UnitTrace) {
        let [input_gate, forget_gate, output_gate] = values.gates;
        let gates = [input_gate, forget_gate, values.candidate, output_gate];
        self.sequence.inject(layer, self.lane, self.step, unit, gates, values.cell, values.hidden);
    }
}

/// Forward pass over the chunk in `sequence`, lane by lane from `states`, by the fixed-point code.
pub fn forward(fixed: &QuantisedNetwork, states: &mut [NetworkState], steps: usize, sequence: &mut Sequence) {
    let wire = fixed.as_wire();
    let features = fixed.layers.first().map_or(0, |layer| layer.inputs);
    // Note(unwrap): the quantiser gives only networks within the domain.
    let network = FixedNetwork::new(&wire, features).expect("a quantised network is valid");
    for (lane, state) in states.iter_mut().enumerate() {
        for step in 0..steps {
            let mut input = [0; MAX_WIDTH];
            for (integer, feature) in input.iter_mut().zip(sequence.lane_features(lane, step)) {
                *integer = quantise_feature(*feature);
            }
            let output = network.step_traced(state, &input, &mut Recorder { sequence: &mut *sequence, lane, step });
            sequence.inject_output(lane, step, output);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Activation;
    use crate::train::starting_network;

    fn network(activation: Activation) -> Network {
        let architecture = Network::zeros(3, &[16, 12], activation, 2.0).architecture();
        starting_network(&architecture, 1.0, 11)
    }

    fn filled(sequence: &mut Sequence, steps: usize) {
        for (index, value) in sequence.features_mut(steps).iter_mut().enumerate() {
            *value = ((index * 7919) % 2000) as f32 / 1000.0 - 1.0;
        }
    }

    #[test]
    fn the_rounded_weights_round_to_themselves() {
        let network = network(Activation::Relu);
        let (fixed, flat) = rounded(&network.architecture(), &network.to_flat(), &[1.0, 1.0]).unwrap();
        let (again, same) = rounded(&network.architecture(), &flat, &[1.0, 1.0]).unwrap();
        for (first, second) in fixed.layers.iter().zip(&again.layers) {
            assert_eq!((&first.input_weights, &first.recurrent_weights), (&second.input_weights, &second.recurrent_weights));
        }
        let worst = flat.iter().zip(&same).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 1e-6, "{worst}");
        assert_ne!(flat, network.to_flat(), "rounding must do something here");
    }

    #[test]
    fn the_fixed_forward_pass_and_its_gradient_lie_close_to_f32_with_the_same_weights() {
        for activation in [Activation::Tanh, Activation::Relu, Activation::Hard] {
            let network = network(activation);
            let architecture = network.architecture();
            let (fixed, flat) = rounded(&architecture, &network.to_flat(), &[1.0, 1.0]).unwrap();
            let (lanes, steps) = (3, 25);
            let gradient = |by_fixed: bool| {
                let mut sequence = Sequence::new(&architecture, lanes, steps);
                filled(&mut sequence, steps);
                if by_fixed {
                    forward(&fixed, &mut vec![NetworkState::default(); lanes], steps, &mut sequence);
                } else {
                    sequence.forward(&flat);
                }
                let (outputs, slopes) = sequence.outputs_and_gradient_mut();
                slopes.iter_mut().zip(outputs).for_each(|(slope, output)| *slope = *output - 0.3);
                let outputs = outputs.to_vec();
                let mut gradient = vec![0.0; flat.len()];
                sequence.backward(&flat, &mut gradient);
                (outputs, gradient)
            };
            let ((fixed_outputs, fixed_gradient), (outputs, gradient)) = (gradient(true), gradient(false));
            // Features of 15 bits and hidden states of 16: 6e-5 each, carried over 25 steps.
            for (a, b) in fixed_outputs.iter().zip(&outputs) {
                assert!((a - b).abs() < 2e-3, "{activation:?} output {a} {b}");
            }
            let largest = gradient.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
            let square: f32 = fixed_gradient.iter().zip(&gradient).map(|(a, b)| (a - b).powi(2)).sum();
            let norm: f32 = gradient.iter().map(|value| value * value).sum();
            assert!(largest > 0.1 && square < 1e-3 * norm, "{activation:?} {square} of {norm}");
        }
    }
}
