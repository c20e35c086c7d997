//! Weights that a training starts from.

use rand::{Rng as _, RngExt as _};
use rand_chacha::ChaCha8Rng;

use super::tracks::{Purpose, stream};
use crate::network::{Architecture, Network};

/// Starting weights: input weights uniform (Glorot), recurrent weights orthogonal, forget gates open, dense small, so that training
/// starts close to the front end's readout.
#[must_use]
pub fn starting_network(architecture: &Architecture, forget_bias: f32, seed: u64) -> Network {
    let mut random = stream(seed, Purpose::Weights, 0);
    let mut network = Network::zeros(architecture.features, &architecture.units, architecture.activation, architecture.state_limit);
    for layer in &mut network.layers {
        #[expect(clippy::cast_precision_loss, reason = "layer widths are small")]
        let bound = (6.0 / (layer.inputs + layer.units) as f32).sqrt();
        layer.input_weights.iter_mut().for_each(|weight| *weight = random.random_range(-bound..bound));
        for gate in layer.recurrent_weights.chunks_exact_mut(layer.units * layer.units) {
            orthogonal(layer.units, &mut random, gate);
        }
        layer.bias[layer.units..2 * layer.units].fill(forget_bias);
    }
    let last = network.dense_weights.len();
    #[expect(clippy::cast_precision_loss, reason = "layer widths are small")]
    let bound = 0.1 / (last.max(1) as f32).sqrt();
    network.dense_weights.iter_mut().for_each(|weight| *weight = random.random_range(-bound..bound));
    network
}

/// A random orthogonal matrix: Gram-Schmidt on normal vectors.
fn orthogonal(size: usize, random: &mut ChaCha8Rng, target: &mut [f32]) {
    let mut rows: Vec<Vec<f64>> = Vec::with_capacity(size);
    while rows.len() < size {
        let mut row: Vec<f64> = (0..size).map(|_| normal(random)).collect();
        for other in &rows {
            let along: f64 = row.iter().zip(other).map(|(a, b)| a * b).sum();
            row.iter_mut().zip(other).for_each(|(a, b)| *a -= along * b);
        }
        let length = row.iter().map(|value| value * value).sum::<f64>().sqrt();
        // A vector that lies almost in the span of the others would be noise after scaling; draw another.
        if length > 1e-3 {
            row.iter_mut().for_each(|value| *value /= length);
            rows.push(row);
        }
    }
    #[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
    target.iter_mut().zip(rows.iter().flatten()).for_each(|(target, &value)| *target = value as f32);
}

/// A standard normal number (Box and Muller, 1958).
fn normal(random: &mut ChaCha8Rng) -> f64 {
    let unit = |bits: u64| ((bits >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
    let (first, second) = (unit(random.next_u64()), unit(random.next_u64()));
    (-2.0 * first.ln()).sqrt() * (std::f64::consts::TAU * second).cos()
}
