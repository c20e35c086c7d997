//! Models that nobody would fit: every part at random, every number as large, small or negative as a blob allows.

use firmware::estimator::{Estimator, EstimatorState};
use firmware::parity::{Noise, RandomNetwork};
use model_export::blob::crc32;
use model_export::schema::{
    Activation, Cell, Channel, Curve, Feature, FeatureSource, Filter, Flow, FrontEnd, Golden, Growth, MAX_BENDS, MAX_CREEP, MAX_FEATURES,
    MAX_INPUTS, MAX_PLAY, Mode, Model, Stages,
};

/// Most units of a layer, so that thousands of samples are run soon.
const MOST_UNITS: u32 = 12;
/// Samples of the golden vectors.
const GOLDEN_SAMPLES: usize = 40;

/// Makes models.
pub struct RandomModel {
    network: Box<RandomNetwork>,
}

impl Default for RandomModel {
    fn default() -> Self {
        let mut network = Box::new(RandomNetwork::new());
        network.fill_pool(77);
        Self { network }
    }
}

impl RandomModel {
    /// Calls `look` with the model of a seed.
    pub fn with(&mut self, seed: u32, look: impl FnOnce(&Model<'_>)) {
        let mut noise = Noise::new(seed ^ 0x5eed);
        let front_end = front_end(&mut noise);
        let channel = |noise: &mut Noise, quantity, unit| {
            let (offset, scale) = (of_any_size(noise, 3), of_any_size(noise, 3).abs().max(1e-3));
            // Far from the centre as well: the stand-in before the first sample is bounded.
            let minimum = offset - scale * 10f32.powi(small(noise, 5) - 1);
            Channel { quantity, unit, offset, scale, minimum, maximum: offset + scale }
        };
        let input = channel(&mut noise, "a \"quantity\" */ of ??/", "µm/s²\\");
        let more_inputs = (0..front_end.more_input_weights.len()).map(|_| channel(&mut noise, "other", "bar")).collect();
        let output = channel(&mut noise, "", "");
        let has_network = !seed.is_multiple_of(6);
        if has_network {
            let layers: Vec<(Cell, usize)> = (0..=noise.below(4)).map(|_| (cell(&mut noise), count(&mut noise, MOST_UNITS))).collect();
            self.network.draw(seed, front_end.features.len(), &layers);
        }
        let model = Model {
            sample_period_s: 0.02,
            mode: if seed % 4 == 3 {
                Mode::Window { length: u16::try_from(count(&mut noise, 6)).expect("a few") }
            } else {
                Mode::Streaming
            },
            input,
            more_inputs,
            output,
            front_end,
            network: has_network.then(|| self.network.wire()),
            ..Model::default()
        };
        let (input, output, digest) = golden(&model, &mut noise);
        let golden = Golden { input: &input, output: &output, tolerance: 0.0, digest };
        look(&Model { golden, ..model });
    }
}

fn cell(noise: &mut Noise) -> Cell {
    match noise.below(6) {
        0 | 1 => Cell::Lstm,
        2 | 3 => Cell::Gru,
        4 => Cell::Dense(Activation::Tanh),
        _ => Cell::Dense([Activation::Relu, Activation::Hard][usize::from(noise.below(2) == 0)]),
    }
}

/// The estimator's own outputs: what these models mean is not the question here.
fn golden(model: &Model<'_>, noise: &mut Noise) -> (Vec<u8>, Vec<u8>, u32) {
    let estimator = Estimator::new(model).expect("a valid model");
    let mut state = EstimatorState::default();
    let channels = || std::iter::once(&model.input).chain(&model.more_inputs);
    let input: Vec<f32> =
        (0..GOLDEN_SAMPLES).flat_map(|_| channels()).map(|channel| channel.offset + channel.scale * noise.symmetric()).collect();
    let samples = input.chunks(channels().count());
    let output: Vec<u8> = samples.flat_map(|sample| estimator.step_all(&mut state, sample).value.to_le_bytes()).collect();
    (input.iter().flat_map(|input| input.to_le_bytes()).collect(), output.clone(), crc32(0, &output))
}

fn front_end(noise: &mut Noise) -> FrontEnd {
    let plays = any_count(noise, MAX_PLAY);
    let creeps = any_count(noise, MAX_CREEP);
    let mut thresholds: Vec<f32> = (0..plays).map(|_| of_any_size(noise, 2).abs()).collect();
    if noise.below(2) == 0 {
        thresholds.iter_mut().take(1).for_each(|threshold| *threshold = 0.0);
    }
    thresholds.sort_by(f32::total_cmp);
    let mut coefficients = |count: usize| -> Vec<f32> { (0..count).map(|_| coefficient(noise)).collect() };
    let (creep_coefficients, lag) = (coefficients(creeps), coefficients(1)[0]);
    let mut weights = |count: usize| -> Vec<f32> { (0..count).map(|_| of_any_size(noise, 3)).collect() };
    let (play_weights, creep_weights) = (weights(plays), weights(creeps));
    let curve = (noise.below(2) == 0).then(|| curve(noise));
    let features = 0..count(noise, u32::try_from(MAX_FEATURES).expect("a few"));
    let features = features.map(|_| Feature {
        source: source(noise, &thresholds, creeps),
        offset: of_any_size(noise, 2),
        gain: of_any_size(noise, 3),
    });
    let features: heapless::Vec<Feature, MAX_FEATURES> = features.collect();
    let stages = (noise.below(3) == 0).then(|| stages(noise));
    // Half of them of one input.
    let inputs = if stages.is_some() || noise.below(2) == 0 { 1 } else { 1 + count(noise, u32::try_from(MAX_INPUTS - 1).expect("a few")) };
    let mut of_inputs = |count: usize| (0..count).filter(|_| inputs > 1).map(|_| index(noise, inputs)).collect::<Vec<u8>>();
    let (play_inputs, feature_inputs) = (of_inputs(plays), of_inputs(features.len()));
    FrontEnd {
        more_input_weights: (1..inputs).map(|_| of_any_size(noise, 2)).collect(),
        play_inputs: play_inputs.into_iter().collect(),
        feature_inputs: feature_inputs.into_iter().collect(),
        dead_time_samples: [0.0, 1.0, 32.0, 0.75, 31.5, 7.0 + 0.999_999_5, 4.1, 0.0][usize::try_from(noise.below(8)).expect("small")],
        lag_coefficient: if stages.is_some() { 1.0 } else { lag },
        stages,
        play_thresholds: thresholds.into_iter().collect(),
        play_weights: play_weights.into_iter().collect(),
        creep_coefficients: creep_coefficients.into_iter().collect(),
        creep_weights: creep_weights.into_iter().collect(),
        input_weight: of_any_size(noise, 2),
        bias: of_any_size(noise, 2),
        curve,
        stick_band: if noise.below(2) == 0 { 0.0 } else { of_any_size(noise, 3).abs() },
        features,
    }
}

fn curve(noise: &mut Noise) -> Curve {
    let bends = any_count(noise, MAX_BENDS);
    let mut points: Vec<f32> = (0..bends).map(|_| of_any_size(noise, 3)).collect();
    points.sort_by(f32::total_cmp);
    points.dedup();
    let bends = points.iter().map(|_| of_any_size(noise, 2)).collect();
    Curve { offset: of_any_size(noise, 2), slope: of_any_size(noise, 2), bend_points: points.into_iter().collect(), bends }
}

/// Every stage or none of each; filters settle, slowly or soon.
fn stages(noise: &mut Noise) -> Stages {
    let mut has = || noise.below(2) == 0;
    let [supply, flow, line, muscle, growth, follow, tip] = [has(), has(), has(), has(), has(), has(), has()];
    let filter = |noise: &mut Noise| {
        let momentum = 0.9 * noise.symmetric();
        let sum = (1.0 + momentum) * (0.05 + noise.symmetric().abs());
        let [before, long_before] = [of_any_size(noise, 1), of_any_size(noise, 1)];
        Filter { momentum, gains: [sum - before - long_before, before, long_before] }
    };
    Stages {
        supply: supply.then(|| curve(noise)),
        flow: flow.then(|| Flow { fill: curve(noise), vent: curve(noise) }),
        line: line.then(|| filter(noise)),
        muscle: muscle.then(|| curve(noise)),
        growth: growth.then(|| Growth {
            per_path: [of_any_size(noise, 2), of_any_size(noise, 2)],
            apart: [of_any_size(noise, 2), of_any_size(noise, 2), of_any_size(noise, 2)],
            law: curve(noise),
            share: of_any_size(noise, 2),
            extra: of_any_size(noise, 2),
            fading: coefficient(noise),
            follow: follow.then(|| curve(noise)),
        }),
        tip: tip.then(|| filter(noise)),
    }
}

fn index(noise: &mut Noise, count: usize) -> u8 {
    noise.below(u32::try_from(count).expect("a few")).to_le_bytes()[0]
}

fn source(noise: &mut Noise, thresholds: &[f32], creeps: usize) -> FeatureSource {
    match noise.below(8) {
        0 => FeatureSource::InputDifference,
        1 => FeatureSource::Path,
        2 => FeatureSource::PathDifference,
        3 => FeatureSource::Readout,
        4 | 5 if !thresholds.is_empty() => {
            let index = index(noise, thresholds.len());
            // A stop divides by its threshold.
            if thresholds[usize::from(index)] > 1e-5 { FeatureSource::Stop(index) } else { FeatureSource::Play(index) }
        }
        7 => FeatureSource::Past(u8::try_from(noise.below(33)).expect("at most 32")),
        6 if creeps > 0 => FeatureSource::Creep(index(noise, creeps)),
        _ => FeatureSource::Input,
    }
}

/// From zero, of either sign, to ten to the power of `decades`, and now and then the largest that a blob holds or the smallest that is.
fn of_any_size(noise: &mut Noise, decades: u32) -> f32 {
    match noise.below(24) {
        0 => 0.0,
        1 => -0.0,
        2 => 1e-42,
        3 if decades > 2 => -1e6,
        _ => noise.symmetric() * 10f32.powi(small(noise, decades + 3) - 2),
    }
}

fn coefficient(noise: &mut Noise) -> f32 {
    if noise.below(4) == 0 { 1.0 } else { noise.symmetric().abs().max(1e-6) }
}

fn small(noise: &mut Noise, below: u32) -> i32 {
    i32::try_from(noise.below(below)).expect("a small number")
}

/// 1 to `most`.
fn count(noise: &mut Noise, most: u32) -> usize {
    usize::try_from(1 + noise.below(most)).expect("a small number")
}

/// None, all or any number.
fn any_count(noise: &mut Noise, most: usize) -> usize {
    match noise.below(4) {
        0 => 0,
        1 => most,
        _ => count(noise, u32::try_from(most).expect("a few")),
    }
}
