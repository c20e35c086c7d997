//! Measures training throughput of the 2x64 LSTM: forward, backward and optimiser step, in multiply-accumulates a second.
//!
//! One weight counts three multiply-accumulates a step and lane: forward, gradient to the layer below or the step before, gradient of
//! the weight. Run with `cargo run --release -p host-tool --example training_throughput`; one line of JSON a shape and thread count.

use std::time::Instant;

use host_tool::network::{Activation, Network};
use host_tool::train::optimizer::OptimizerConfig;
use host_tool::train::team::Team;

fn main() {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    for (lanes, steps) in [(16, 50), (32, 100)] {
        for threads in [1, 2].into_iter().filter(|&threads| threads <= cores) {
            for (name, activation) in [("tanh", Activation::Tanh), ("relu", Activation::Relu)] {
                let rate = measure(lanes, steps, threads, activation);
                println!(
                    "{{\"batch\":{lanes},\"steps\":{steps},\"threads\":{threads},\"activation\":\"{name}\",\"macs_per_second\":{rate:.4e}}}"
                );
            }
        }
    }
}

/// Best of several bursts, as the Python side does it.
fn measure(lanes: usize, steps: usize, threads: usize, activation: Activation) -> f64 {
    let mut network = Network::zeros(1, &[64, 64], activation, 8.0);
    let macs = 3 * network.macs_per_step() * lanes * steps;
    for (index, weight) in network.layers.iter_mut().flat_map(|layer| &mut layer.recurrent_weights).enumerate() {
        *weight = ((index * 37) % 101) as f32 / 1010.0 - 0.05;
    }
    let mut team = Team::new(&network.architecture(), &network.to_flat(), OptimizerConfig::default(), lanes, steps, threads);
    {
        let mut batch = team.batch();
        batch.weights.fill(1.0);
        for (index, feature) in batch.features.iter_mut().enumerate() {
            *feature = (index as f32 * 0.05).sin();
        }
    }
    let mut best = f64::INFINITY;
    for _ in 0..12 {
        let repetitions = 20;
        let start = Instant::now();
        for _ in 0..repetitions {
            team.step(1e-4);
        }
        best = best.min(start.elapsed().as_secs_f64() / f64::from(repetitions));
    }
    macs as f64 / best
}
