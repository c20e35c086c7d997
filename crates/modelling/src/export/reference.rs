//! The estimator in `f64`, read straight from the equations: what fixed point and `f32` are measured against.
//!
//! It shares no code with the firmware or with training, so that an error in either shows as a difference.

use model_export::schema::{Curve, FeatureSource, Filter, Growth, Stages};

use crate::network::{Activation, Cell, Layer, Mode, Network, TrainedModel};

/// Gates and states of one layer after a step, in `f64`.
#[derive(Clone, Debug, Default)]
pub struct LayerSignals {
    /// Pre-activations, rows in the order of [`Cell::gates`].
    pub pre_activations: Vec<f64>,
    /// Gates i, f, o of an LSTM, r, u of a GRU; none of a dense layer.
    pub gates: Vec<Vec<f64>>,
    /// Candidate; none in a dense layer.
    pub candidate: Vec<f64>,
    /// Cell state of an LSTM.
    pub cell: Vec<f64>,
    /// Hidden state, or a dense layer's output.
    pub hidden: Vec<f64>,
    /// What the layer saw: its input, then its hidden state before the step, then 1.
    pub seen: Vec<f64>,
}

/// Signals of the further stages after a step; those of filters newest first, outputs beside inputs.
#[derive(Default)]
struct StageSignals {
    flowed: f64,
    line: Vec<[f64; 2]>,
    step_size: f64,
    tip: Vec<[f64; 2]>,
}

/// A model that runs in `f64`.
pub struct Reference<'a> {
    model: &'a TrainedModel,
    /// `[sample][input]`, normalised.
    inputs: Vec<Vec<f64>>,
    last_paths: Vec<f64>,
    /// Where the stick band rests, in normalised output.
    stuck: Option<f64>,
    plays: Vec<f64>,
    creeps: Vec<f64>,
    stages: StageSignals,
    window: Vec<Vec<f64>>,
    layers: Vec<LayerSignals>,
}

fn wide(values: &[f32]) -> impl Iterator<Item = f64> {
    values.iter().map(|value| f64::from(*value))
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

impl<'a> Reference<'a> {
    /// A model before its first sample.
    #[must_use]
    pub fn new(model: &'a TrainedModel) -> Self {
        Self {
            model,
            inputs: Vec::new(),
            last_paths: Vec::new(),
            plays: vec![0.0; model.front_end.play_thresholds.len()],
            creeps: vec![0.0; model.front_end.creep_coefficients.len()],
            stages: StageSignals::default(),
            window: Vec::new(),
            layers: Vec::new(),
            stuck: None,
        }
    }

    /// Signals of the layers after the last step; empty without a network.
    #[must_use]
    pub fn layers(&self) -> &[LayerSignals] {
        &self.layers
    }

    /// The network's states back to zero; the front end goes on.
    pub fn reset_network(&mut self) {
        self.layers.clear();
        self.window.clear();
    }

    /// One sample, a value of each input in its unit, gives the output in its unit; `on_network_step` sees the layers after each network
    /// step, of which a window has many.
    pub fn step(&mut self, raw: &[f64], on_network_step: &mut dyn FnMut(&[LayerSignals])) -> f64 {
        let output = &self.model.output;
        let normalised = self.model.inputs().zip(raw).map(|(channel, raw)| (raw - f64::from(channel.offset)) / f64::from(channel.scale));
        let (readout, features) = self.front_end(normalised.collect());
        let correction = self.correction(features, on_network_step);
        let free = readout + correction;
        let band = f64::from(self.model.front_end.stick_band);
        let stuck = match self.stuck {
            Some(stuck) if (free - stuck).abs() <= band => stuck,
            _ => free,
        };
        self.stuck = Some(stuck);
        f64::from(output.offset) + f64::from(output.scale) * stuck
    }

    fn front_end(&mut self, u: Vec<f64>) -> (f64, Vec<f64>) {
        let config = &self.model.front_end;
        let first = self.inputs.is_empty();
        self.inputs.push(u);
        let dead_time = f64::from(config.dead_time_samples);
        let newest = self.inputs.len() - 1;
        let at = |input: usize, age: f64| self.inputs[newest.saturating_sub(age as usize)][input];
        let fraction = dead_time.fract();
        let delayed = |input| (1.0 - fraction) * at(input, dead_time.floor()) + fraction * at(input, dead_time.floor() + 1.0);
        let delayed: Vec<f64> = (0..config.inputs()).map(delayed).collect();
        let last_paths = if first { delayed.clone() } else { std::mem::take(&mut self.last_paths) };
        let lag = f64::from(config.lag_coefficient);
        let mut paths: Vec<f64> = last_paths.iter().zip(&delayed).map(|(last, delayed)| last + lag * (delayed - last)).collect();
        let mut last_paths = last_paths;
        if let Some(stages) = &config.stages {
            paths[0] = self.stages.path(stages, paths[0], first);
            if first {
                last_paths.clone_from(&paths);
            }
        }
        let growth = config.stages.as_ref().and_then(|stages| stages.growth.as_ref());
        if let Some(growth) = growth {
            self.stages.step_size = if first { 0.0 } else { self.stages.step_size(growth, (paths[0] - last_paths[0]).abs()) };
        }
        let mut sum = 0.0;
        for (operator, (play, r)) in self.plays.iter_mut().zip(wide(&config.play_thresholds)).enumerate() {
            let path = paths[config.play_input(operator)];
            let [up, down] = growth.map_or([r; 2], |growth| gaps(growth, r, path, self.stages.step_size));
            let bound = (path - up).max((path + down).min(*play));
            let follow = growth.filter(|_| !first).and_then(|growth| growth.follow.as_ref());
            *play = follow.map_or(bound, |follow| towards(follow, follow, *play, bound));
            sum += f64::from(config.play_weights[operator]) * *play;
        }
        let weights = std::iter::once(&config.input_weight).chain(&config.more_input_weights);
        let straight: f64 = weights.zip(&paths).map(|(weight, path)| f64::from(*weight) * path).sum();
        let mut linear = f64::from(config.bias) + straight + sum;
        for ((creep, a), w) in self.creeps.iter_mut().zip(wide(&config.creep_coefficients)).zip(wide(&config.creep_weights)) {
            *creep = if first { sum } else { *creep + a * (sum - *creep) };
            linear += w * *creep;
        }
        let mut readout = along(config.curve.as_ref(), linear);
        if let Some(tip) = config.stages.as_ref().and_then(|stages| stages.tip.as_ref()) {
            readout = filtered(tip, &mut self.stages.tip, readout);
        }
        let features = config.features.iter().enumerate().map(|(index, feature)| {
            let input = config.feature_input(index);
            let signal = match feature.source {
                FeatureSource::Input => at(input, 0.0),
                FeatureSource::InputDifference => at(input, 0.0) - at(input, 1.0),
                FeatureSource::Path => paths[input],
                FeatureSource::PathDifference => paths[input] - last_paths[input],
                FeatureSource::Play(i) => self.plays[usize::from(i)],
                FeatureSource::Stop(i) => {
                    let path = paths[config.play_input(usize::from(i))];
                    (path - self.plays[usize::from(i)]) / f64::from(config.play_thresholds[usize::from(i)])
                }
                FeatureSource::Readout => readout,
                FeatureSource::Creep(j) => self.creeps[usize::from(j)],
                FeatureSource::Past(age) => at(input, f64::from(age)),
            };
            (signal - f64::from(feature.offset)) * f64::from(feature.gain)
        });
        let features = features.collect();
        self.last_paths = paths;
        (readout, features)
    }

    fn correction(&mut self, features: Vec<f64>, on_network_step: &mut dyn FnMut(&[LayerSignals])) -> f64 {
        let model = self.model;
        let Some(network) = &model.network else { return 0.0 };
        let zero = |layer: &Layer| LayerSignals { cell: vec![0.0; layer.units], hidden: vec![0.0; layer.units], ..LayerSignals::default() };
        let steps = match model.mode {
            Mode::Streaming => vec![features],
            Mode::Window { length } => {
                if self.window.is_empty() {
                    self.window = vec![features.clone(); length];
                }
                self.window.remove(0);
                self.window.push(features);
                self.layers.clear();
                self.window.clone()
            }
        };
        if self.layers.is_empty() {
            self.layers = network.layers.iter().map(zero).collect();
        }
        for mut input in steps {
            for (layer, signals) in network.layers.iter().zip(&mut self.layers) {
                layer_step(network, layer, &input, signals);
                input.clone_from(&signals.hidden);
            }
            on_network_step(&self.layers);
        }
        let hidden = self.layers.last().map_or(&[][..], |signals| signals.hidden.as_slice());
        f64::from(network.dense_bias) + wide(&network.dense_weights).zip(hidden).map(|(w, h)| w * h).sum::<f64>()
    }
}

/// A curve at a value; the value itself without one.
fn along(curve: Option<&Curve>, value: f64) -> f64 {
    let Some(curve) = curve else { return value };
    let beyond = wide(&curve.bend_points).map(|point| (value - point).max(0.0));
    let bends: f64 = beyond.zip(wide(&curve.bends)).map(|(beyond, bend)| bend * beyond).sum();
    f64::from(curve.offset) + f64::from(curve.slope) * value + bends
}

/// A filter's next output, as a recurrence of its polynomials: `y0 = a1 y1 + a2 y2 + sum b x`.
fn filtered(filter: &Filter, signals: &mut Vec<[f64; 2]>, input: f64) -> f64 {
    let [b0, b1, b2] = filter.gains.map(f64::from);
    let a2 = -f64::from(filter.momentum);
    let a1 = 1.0 - a2 - (b0 + b1 + b2);
    let [[y1, x1], [y2, x2]] = match signals[..] {
        [newest, older, ..] => [newest, older],
        _ => [[input; 2]; 2],
    };
    let output = a1 * y1 + a2 * y2 + b0 * input + b1 * x1 + b2 * x2;
    *signals = vec![[output, input], [y1, x1]];
    output
}

/// A value on its way to a target, by a curve of the distance for each direction; never beyond.
fn towards(up: &Curve, down: &Curve, from: f64, target: f64) -> f64 {
    let distance = (target - from).abs();
    let moved = along(Some(if target > from { up } else { down }), distance).clamp(0.0, distance);
    from + moved * (target - from).signum()
}

/// The gaps of an operator to its rising and its falling branch.
fn gaps(growth: &Growth, threshold: f64, path: f64, step_size: f64) -> [f64; 2] {
    let law = along(Some(&growth.law), step_size);
    let apart: f64 = wide(&growth.apart).zip(1..).map(|(weight, power)| weight * path.powi(power)).sum();
    growth.per_path.map(|per_path| {
        let factor = (1.0 + f64::from(per_path) * path).max(0.0) + f64::from(growth.share) * law;
        (factor * threshold + f64::from(growth.extra) * law + apart).max(0.0)
    })
}

impl StageSignals {
    fn path(&mut self, stages: &Stages, delayed: f64, first: bool) -> f64 {
        let supplied = along(stages.supply.as_ref(), delayed);
        let flow = stages.flow.as_ref().filter(|_| !first);
        self.flowed = flow.map_or(supplied, |flow| towards(&flow.fill, &flow.vent, self.flowed, supplied));
        let swung = stages.line.as_ref().map_or(self.flowed, |line| filtered(line, &mut self.line, self.flowed));
        along(stages.muscle.as_ref(), swung).clamp(-1000.0, 1000.0)
    }

    fn step_size(&self, growth: &Growth, step: f64) -> f64 {
        self.step_size + f64::from(growth.fading) * (step - self.step_size)
    }
}

fn layer_step(network: &Network, layer: &Layer, input: &[f64], signals: &mut LayerSignals) {
    let limit = f64::from(network.state_limit);
    let act = |x: f64| match (layer.cell.activation(network.activation), layer.cell) {
        (Activation::Tanh, _) => x.tanh(),
        (Activation::Relu, Cell::Dense(_)) => x.max(0.0),
        (Activation::Relu, _) => x.clamp(0.0, limit),
        (Activation::Hard, _) => x.clamp(-1.0, 1.0),
    };
    signals.seen.clear();
    signals.seen.extend(input.iter().chain(&signals.hidden).chain([&1.0]));
    let n = layer.units;
    let product = |weights: &[f32], gate: usize, values: &[f64]| -> Vec<f64> {
        let rows = weights[gate * n * values.len()..(gate + 1) * n * values.len()].chunks(values.len());
        rows.map(|row| wide(row).zip(values).map(|(w, v)| w * v).sum()).collect()
    };
    let bias = |part: usize| wide(&layer.bias[part * n..(part + 1) * n]);
    // With both products where there are both: the equations name them, so that nothing is shared with what is checked.
    let seen = |gate: usize| -> Vec<f64> {
        let from_input = product(&layer.input_weights, gate, input);
        let from_hidden = product(&layer.recurrent_weights, gate, &signals.hidden);
        bias(gate).zip(from_input).zip(from_hidden).map(|((b, x), h)| b + x + h).collect()
    };
    let zip = |left: &[f64], right: &[f64], with: fn(f64, f64) -> f64| -> Vec<f64> {
        left.iter().zip(right).map(|(left, right)| with(*left, *right)).collect()
    };
    let sigmoids = |z: &[f64]| -> Vec<f64> { z.iter().copied().map(sigmoid).collect() };
    match layer.cell {
        Cell::Lstm => {
            let z = [0, 1, 2, 3].map(seen);
            let [i, f, o] = [&z[0], &z[1], &z[3]].map(|z| sigmoids(z));
            let g: Vec<f64> = z[2].iter().copied().map(act).collect();
            let sum = zip(&zip(&f, &signals.cell, |f, c| f * c), &zip(&i, &g, |i, g| i * g), |kept, new| kept + new);
            signals.cell = sum.iter().map(|c| c.clamp(-limit, limit)).collect();
            signals.hidden = o.iter().zip(&signals.cell).map(|(o, c)| o * act(*c)).collect();
            (signals.gates, signals.candidate, signals.pre_activations) = (vec![i, f, o], g, z.concat());
        }
        Cell::Gru => {
            let [r_z, u_z] = [0, 1].map(seen);
            let n_z: Vec<f64> = bias(2).zip(product(&layer.input_weights, 2, input)).map(|(b, x)| b + x).collect();
            let m_z: Vec<f64> = bias(3).zip(product(&layer.recurrent_weights, 2, &signals.hidden)).map(|(b, h)| b + h).collect();
            let (r, u) = (sigmoids(&r_z), sigmoids(&u_z));
            let candidate: Vec<f64> = zip(&n_z, &zip(&r, &m_z, |r, m| r * m), |n, rm| n + rm).into_iter().map(act).collect();
            let new = zip(&u, &candidate, |u, n| (1.0 - u) * n);
            signals.hidden = zip(&new, &zip(&u, &signals.hidden, |u, h| u * h), |new, kept| new + kept);
            (signals.gates, signals.candidate, signals.pre_activations) = (vec![r, u], candidate, [r_z, u_z, n_z, m_z].concat());
        }
        Cell::Dense(_) => {
            signals.pre_activations = bias(0).zip(product(&layer.input_weights, 0, input)).map(|(b, x)| b + x).collect();
            signals.hidden = signals.pre_activations.iter().copied().map(act).collect();
        }
    }
}
