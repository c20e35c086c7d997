//! Networks that are certified to forget where they started: weights kept where the certificate holds.
//!
//! The certificate ([`model_export::certificate`]) bounds every gate over all inputs and asks for a spectral radius below one. Training does
//! not care about it, so the weights are brought back now and then, layer by layer: rows of forget gates that could open too far are
//! scaled down, then all recurrent weights of the layer by the largest common factor with which the radius stays below its bound,
//! whichever way the weights will be rounded to 8 bits. A certified network remembers in its cells and hardly through its recurrent
//! weights, which costs accuracy; where play operators stand in front of it they do the remembering.

use model_export::certificate::{LARGEST_FEATURE, RealLayer};

use crate::network::{Activation, Layer, Network};

/// Of the distance between the bound and one, how much further from one a forget gate must stay: room for the recurrent weights.
const FORGET_FACTOR: f64 = 2.0;
/// Halvings in the search for the factor of the recurrent weights.
const HALVINGS: usize = 12;

/// Brings a network's weights to where its comparison system has a spectral radius of at most `radius`; those that are there stay.
pub fn project(network: &mut Network, radius: f64) {
    let mut inputs = vec![LARGEST_FEATURE; network.features()];
    let (activation, limit) = (network.activation, network.state_limit);
    for layer in &mut network.layers {
        close_forget_gates(layer, &inputs, real(layer, activation, limit), 1.0 - FORGET_FACTOR * (1.0 - radius));
        let whole = real(layer, activation, limit);
        let scaled = |factor: f64| {
            let recurrent_weights = whole.recurrent_weights.iter().map(|weight| factor * weight).collect();
            RealLayer { recurrent_weights, ..whole.clone() }.bounds(&inputs)
        };
        let mut bounds = scaled(1.0);
        if bounds.radius > radius {
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                if scaled(middle).radius <= radius {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            bounds = scaled(low);
            #[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
            layer.recurrent_weights.iter_mut().for_each(|weight| *weight *= low as f32);
        }
        inputs = bounds.hidden;
    }
}

/// Scales down the rows of forget gates that could open further than `most`.
fn close_forget_gates(layer: &mut Layer, inputs: &[f64], real: RealLayer, most: f64) {
    let logit = |gate: f64| (gate / (1.0 - gate)).ln();
    let bounds = real.bounds(inputs);
    for (unit, gate) in bounds.forget_gates.iter().enumerate().filter(|(_, gate)| **gate > most) {
        // Rounding takes a gate that is open for good to one exactly.
        #[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
        let factor = (logit(most) / logit(gate.min(1.0 - f64::EPSILON))) as f32;
        let row = layer.units + unit;
        let input_row = &mut layer.input_weights[row * layer.inputs..(row + 1) * layer.inputs];
        let recurrent_row = &mut layer.recurrent_weights[row * layer.units..(row + 1) * layer.units];
        input_row.iter_mut().chain(recurrent_row).chain(&mut layer.bias[row..=row]).for_each(|weight| *weight *= factor);
    }
}

/// Magnitudes of a matrix's weights once they are integers: half a step of their row larger at most, by rounding to the nearest. Rounding that
/// passes its errors on to the next weights knows no such bound, so the export falls back to the nearest where the other loses the certificate.
fn rounded_up(weights: &[f32], columns: usize) -> Vec<f64> {
    let row = |row: &[f32]| {
        let largest = row.iter().fold(0.0f32, |largest, weight| largest.max(weight.abs()));
        let half_step = 0.5 * f64::from(largest) / f64::from(i8::MAX);
        row.iter().map(move |weight| f64::from(weight.abs()) + half_step).collect::<Vec<f64>>()
    };
    weights.chunks(columns.max(1)).flat_map(row).collect()
}

/// The layer as the certificate will see it at worst; only magnitudes of weights count there.
fn real(layer: &Layer, activation: Activation, limit: f32) -> RealLayer {
    RealLayer {
        units: layer.units,
        input_weights: rounded_up(&layer.input_weights, layer.inputs),
        recurrent_weights: rounded_up(&layer.recurrent_weights, layer.units),
        biases: layer.bias.iter().map(|bias| f64::from(*bias)).collect(),
        cell_limit: f64::from(limit),
        activation,
    }
}
