//! The firmware's figures: instructions per model step and per tick, counted in the emulator, and what quantisation costs in accuracy.

use firmware::estimator::{Estimator, EstimatorState};
use host_tool::export::reference::Reference;
use host_tool::network::{Activation, Cell, Mode, TrainedModel};
use model_export::blob;
use model_export::schema::{Curve, FeatureSource, Filter, Flow, FrontEnd, Growth, MAX_BENDS, Stages};

use crate::emulator::{Task, Work};
use crate::models::{compensation, exported, exported_with, layered, model, network, physics_front_end, plain_front_end, smooth_input};

/// Steps that each count runs over; the front end's branches depend on the data, the network's cost does not.
const STEPS: u32 = 400;
/// Ticks that the tick is counted over: some 250 model steps, in all states.
const TICKS: u32 = 6000;
/// Seed of weights and samples: costs do not depend on it.
const SEED: u32 = 7;

/// A configuration whose step is counted.
pub struct Configuration {
    /// Its name in tables and JSON.
    pub name: &'static str,
    /// The model.
    pub model: TrainedModel,
}

/// The configurations: the sizes that peers publish, the presets, and the largest that a blob may hold.
#[must_use]
pub fn configurations() -> Vec<Configuration> {
    let plain = |name, sources: &[FeatureSource], units: &[usize], activation, mode| {
        let network = network(SEED, sources.len(), units, activation, 1.0);
        Configuration { name, model: model(plain_front_end(sources), Some(network), mode) }
    };
    let hybrid = |name, plays, creeps, units: &[usize], activation| {
        let front_end = physics_front_end(SEED, plays, creeps);
        let network = network(SEED, front_end.features.len(), units, activation, 1.0);
        Configuration { name, model: model(front_end, Some(network), Mode::Streaming) }
    };
    let (input, both) = (&[FeatureSource::Input][..], &[FeatureSource::Input, FeatureSource::InputDifference][..]);
    vec![
        plain("2x64-tanh", input, &[64, 64], Activation::Tanh, Mode::Streaming),
        plain("2x64-relu", input, &[64, 64], Activation::Relu, Mode::Streaming),
        plain("2x64-hard", both, &[64, 64], Activation::Hard, Mode::Streaming),
        plain("1x32-relu", both, &[32], Activation::Relu, Mode::Streaming),
        // The default preset with as many operators and filters as its identification ever chooses.
        hybrid("hybrid", 16, 3, &[32], Activation::Relu),
        hybrid("largest", 23, 4, &[64, 64], Activation::Tanh),
        plain("1x32-window-50", both, &[32], Activation::Relu, Mode::Window { length: 50 }),
        Configuration { name: "physics", model: model(physics_front_end(SEED, 16, 3), None, Mode::Streaming) },
        Configuration {
            name: "physics-without-curve",
            model: model(FrontEnd { curve: None, ..physics_front_end(SEED, 16, 3) }, None, Mode::Streaming),
        },
        Configuration {
            name: "physics-with-every-stage",
            model: model(
                FrontEnd { lag_coefficient: 1.0, stages: Some(every_stage()), ..physics_front_end(SEED, 16, 3) },
                None,
                Mode::Streaming,
            ),
        },
    ]
}

/// Every further stage, with as many bends as fit.
fn every_stage() -> Stages {
    let places = || (0..MAX_BENDS).map(|bend| 0.1 * bend as f32 - 0.3);
    let curve = Curve { offset: 0.01, slope: 0.9, bend_points: places().collect(), bends: places().map(|place| 0.1 * place).collect() };
    Stages {
        supply: Some(curve.clone()),
        flow: Some(Flow { fill: curve.clone(), vent: curve.clone() }),
        line: Some(Filter { momentum: 0.5, gains: [0.2, 0.2, 0.1] }),
        muscle: Some(curve.clone()),
        growth: Some(Growth {
            per_path: [0.3, 0.2],
            apart: [0.05, 0.02, 0.01],
            law: curve.clone(),
            share: 0.5,
            extra: 0.1,
            fading: 0.4,
            follow: Some(curve),
        }),
        tip: Some(Filter { momentum: 0.8, gains: [0.05, 0.05, 0.0] }),
    }
}

/// Networks of the layers that are imported and never trained here.
#[must_use]
pub fn imported() -> Vec<Configuration> {
    use Activation::{Hard, Relu, Tanh};
    use Cell::{Dense, Gru, Lstm};

    let of = |name, sources: &[FeatureSource], layers: &[(Cell, usize)], activation, mode| {
        let network = layered(SEED, sources.len(), layers, activation);
        Configuration { name, model: model(plain_front_end(sources), Some(network), mode) }
    };
    let (input, streaming) = (&[FeatureSource::Input][..], Mode::Streaming);
    let lags: Vec<FeatureSource> = (0..20).rev().map(FeatureSource::Past).collect();
    vec![
        of("2x64-gru-tanh", input, &[(Gru, 64), (Gru, 64)], Tanh, streaming),
        of("1x32-gru-relu", input, &[(Gru, 32)], Relu, streaming),
        of("gru-dense", input, &[(Gru, 32), (Dense(Tanh), 30), (Dense(Hard), 10)], Hard, streaming),
        of("dense", &lags, &[(Dense(Tanh), 64), (Dense(Relu), 64), (Dense(Relu), 32)], Tanh, streaming),
        of("dense-relu", input, &[(Dense(Relu), 64), (Dense(Relu), 63)], Tanh, streaming),
        of("lstm-gru-dense", input, &[(Lstm, 32), (Gru, 17), (Dense(Relu), 31)], Tanh, streaming),
        of("gru-window-20", input, &[(Gru, 12), (Dense(Hard), 7)], Tanh, Mode::Window { length: 20 }),
    ]
}

/// What a configuration costs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cost {
    /// Name of the configuration.
    pub name: &'static str,
    /// Instructions of a step with the packed kernel, least and most.
    pub packed: [u32; 2],
    /// The same with the portable kernel, most.
    pub portable: u32,
}

/// Counts each configuration's steps in the emulator.
///
/// # Panics
/// As [`Work::run`].
#[must_use]
pub fn costs(configurations: &[Configuration]) -> Vec<Cost> {
    let blobs: Vec<Vec<u8>> = configurations.iter().map(|configuration| exported(&configuration.model, SEED)).collect();
    let lines = Work { task: Task::Cost, steps: STEPS, seed: SEED, blobs: &blobs }.run();
    assert_eq!(lines.len(), configurations.len(), "{lines:?}");
    let cost = |(configuration, line): (&Configuration, &String)| {
        let numbers: Vec<u32> = line.split(' ').map(|word| word.parse().expect("a count")).collect();
        let &[least, most, _, portable] = &numbers[..] else { panic!("four counts, not {line}") };
        Cost { name: configuration.name, packed: [least, most], portable }
    };
    configurations.iter().zip(&lines).map(cost).collect()
}

/// What the whole tick costs under one control law.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TickCost {
    /// Number of the law in the settings.
    pub law: u32,
    /// Most instructions of a tick with a model step in it.
    pub with_model: u32,
    /// Most instructions of any other tick.
    pub without_model: u32,
    /// Deepest stack of a tick.
    pub stack_bytes: u32,
    /// Whether the law came to run.
    pub ran: bool,
}

/// Counts ticks with the named configuration as the model, under each control law, over a run through all states with every command.
///
/// # Panics
/// As [`Work::run`], and when there is no such configuration.
#[must_use]
pub fn tick_costs(name: &str) -> Vec<TickCost> {
    let configuration = configurations().into_iter().find(|configuration| configuration.name == name).expect("a configuration's name");
    let blob = exported_with(&configuration.model, SEED, Some(compensation()));
    let lines = Work { task: Task::Tick, steps: TICKS, seed: SEED, blobs: &[blob] }.run();
    let cost = |line: &String| {
        let numbers: Vec<u32> = line.split(' ').map(|word| word.parse().expect("a count")).collect();
        let &[law, with_model, without_model, stack_bytes, ran] = &numbers[..] else { panic!("five numbers, not {line}") };
        TickCost { law, with_model, without_model, stack_bytes, ran: ran == 1 }
    };
    let costs: Vec<TickCost> = lines.iter().map(cost).collect();
    assert!(costs.len() == 3 && costs.iter().all(|cost| cost.ran), "playback, pressure set-point and tracking run: {costs:?}");
    costs
}

/// The most instructions that a tick took.
#[must_use]
pub fn worst_tick(costs: &[TickCost]) -> u32 {
    costs.iter().map(|cost| cost.with_model.max(cost.without_model)).max().unwrap_or(0)
}

/// Factor on the weights of a new network that makes its states move as a trained one's do. From a factor of 4 on, a 2x64 network is
/// chaotic: any two computations of it part, however exact.
pub const LIVELY: f32 = 3.0;

/// How far a quantised network strays from its `f64` reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QuantisationError {
    /// Mean squared error of the last layer's hidden states.
    pub hidden: f64,
    /// Mean squared error of the dense output, normalised.
    pub output: f64,
    /// Variance of the reference's hidden states over time, mean of the units: what the error is to be seen against.
    pub hidden_variance: f64,
}

/// The error of the 2x64 tanh network drawn from `seed`, over 200 steps of a smooth random input from -1 to 1 that calibration has not seen.
///
/// One input column, a dense output on top; weights and biases as PyTorch initialises them, times `gain`. Reference: the same weights in `f64`.
///
/// # Panics
/// When the model cannot be exported or run, which is a mistake in the program.
#[must_use]
pub fn quantisation_error(seed: u32, gain: f32) -> QuantisationError {
    const SAMPLES: usize = 200;
    let units = 64;
    let mut network = network(seed, 1, &[units, units], Activation::Tanh, 4.0);
    for layer in &mut network.layers {
        layer.input_weights.iter_mut().chain(&mut layer.recurrent_weights).chain(&mut layer.bias).for_each(|weight| *weight *= gain);
    }
    let mut trained = model(plain_front_end(&[FeatureSource::Input]), Some(network), Mode::Streaming);
    (trained.input.offset, trained.input.minimum, trained.input.maximum) = (0.0, -1.0, 1.0);
    (trained.output.offset, trained.output.scale) = (0.0, 1.0);
    let bytes = exported(&trained, seed.wrapping_add(1_000_000));
    let blob = blob::decode(&bytes).expect("what was just exported");
    let estimator = Estimator::new(&blob.model).expect("a valid model");
    let step = estimator.network().and_then(|network| network.layers().last()).map_or(0.0, |layer| f64::from(layer.hidden_step()));
    let (mut state, mut reference) = (EstimatorState::default(), Reference::new(&trained));
    let mut error = QuantisationError::default();
    let (mut sums, mut squares) = (vec![0.0; units], vec![0.0; units]);
    for sample in smooth_input(seed.wrapping_add(2_000_000), SAMPLES, -1.0, 1.0) {
        let value = f64::from(estimator.step(&mut state, sample as f32).value);
        // Both see the same f32 sample.
        error.output += (value - reference.step(&[f64::from(sample as f32)], &mut |_| {})).powi(2);
        let expected = &reference.layers()[1].hidden;
        for (unit, (found, expected)) in state.network().layers()[1].hidden.iter().zip(expected).enumerate() {
            error.hidden += (f64::from(*found) * step - expected).powi(2);
            sums[unit] += expected;
            squares[unit] += expected * expected;
        }
    }
    let (samples, values) = (SAMPLES as f64, (SAMPLES * units) as f64);
    let variance = |(sum, square): (&f64, &f64)| square / samples - (sum / samples).powi(2);
    let hidden_variance = sums.iter().zip(&squares).map(variance).sum::<f64>() / units as f64;
    QuantisationError { hidden: error.hidden / values, output: error.output / samples, hidden_variance }
}

/// The mean over the ten networks that the figure is reported for, seeds 9001 to 9010.
#[must_use]
pub fn mean_quantisation_error(gain: f32) -> QuantisationError {
    let mut mean = QuantisationError::default();
    for error in (9001..=9010).map(|seed| quantisation_error(seed, gain)) {
        mean.hidden += error.hidden / 10.0;
        mean.output += error.output / 10.0;
        mean.hidden_variance += error.hidden_variance / 10.0;
    }
    mean
}
