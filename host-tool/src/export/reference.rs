//! The estimator in `f64`, read straight from the equations: what fixed point and `f32` are measured against.
//!
//! It shares no code with the firmware or with training, so that an error in either shows as a difference.

use model_export::schema::FeatureSource;

use crate::network::{Activation, Layer, Mode, TrainedModel};

/// Gates and states of one layer after a step, in `f64`.
#[derive(Clone, Debug, Default)]
pub struct LayerSignals {
    /// Pre-activations, rows in gate order i, f, g, o.
    pub pre_activations: Vec<f64>,
    /// Input gate.
    pub input_gate: Vec<f64>,
    /// Forget gate.
    pub forget_gate: Vec<f64>,
    /// Candidate.
    pub candidate: Vec<f64>,
    /// Output gate.
    pub output_gate: Vec<f64>,
    /// Cell state.
    pub cell: Vec<f64>,
    /// Hidden state.
    pub hidden: Vec<f64>,
    /// What the layer saw: its input, then its hidden state before the step, then 1.
    pub seen: Vec<f64>,
}

/// A model that runs in `f64`.
pub struct Reference<'a> {
    model: &'a TrainedModel,
    inputs: Vec<f64>,
    last_path: f64,
    /// Where the stick band rests, in normalised output.
    stuck: Option<f64>,
    plays: Vec<f64>,
    creeps: Vec<f64>,
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
            last_path: 0.0,
            plays: vec![0.0; model.front_end.play_thresholds.len()],
            creeps: vec![0.0; model.front_end.creep_coefficients.len()],
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

    /// One sample in the input's unit gives the output in its unit; `on_network_step` sees the layers after each network step, of which
    /// a window has many.
    pub fn step(&mut self, raw: f64, on_network_step: &mut dyn FnMut(&[LayerSignals])) -> f64 {
        let (input, output) = (&self.model.input, &self.model.output);
        let normalised = (raw - f64::from(input.offset)) / f64::from(input.scale);
        let (readout, features) = self.front_end(normalised);
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

    fn front_end(&mut self, u: f64) -> (f64, Vec<f64>) {
        let config = &self.model.front_end;
        let first = self.inputs.is_empty();
        let last_input = self.inputs.last().copied().unwrap_or(u);
        self.inputs.push(u);
        let dead_time = f64::from(config.dead_time_samples);
        let newest = self.inputs.len() - 1;
        let at = |age: f64| self.inputs[newest.saturating_sub(age as usize)];
        let fraction = dead_time.fract();
        let delayed = (1.0 - fraction) * at(dead_time.floor()) + fraction * at(dead_time.floor() + 1.0);
        let last_path = if first { delayed } else { self.last_path };
        let path = last_path + f64::from(config.lag_coefficient) * (delayed - last_path);
        let mut sum = 0.0;
        for ((play, r), w) in self.plays.iter_mut().zip(wide(&config.play_thresholds)).zip(wide(&config.play_weights)) {
            *play = (path - r).max((path + r).min(*play));
            sum += w * *play;
        }
        let mut linear = f64::from(config.bias) + f64::from(config.input_weight) * path + sum;
        for ((creep, a), w) in self.creeps.iter_mut().zip(wide(&config.creep_coefficients)).zip(wide(&config.creep_weights)) {
            *creep = if first { sum } else { *creep + a * (sum - *creep) };
            linear += w * *creep;
        }
        let readout = match &config.curve {
            None => linear,
            Some(curve) => {
                let beyond = wide(&curve.bend_points).map(|point| (linear - point).max(0.0));
                let bends: f64 = beyond.zip(wide(&curve.bends)).map(|(beyond, bend)| bend * beyond).sum();
                f64::from(curve.offset) + f64::from(curve.slope) * linear + bends
            }
        };
        self.last_path = path;
        let features = config.features.iter().map(|feature| {
            let signal = match feature.source {
                FeatureSource::Input => u,
                FeatureSource::InputDifference => u - last_input,
                FeatureSource::Path => path,
                FeatureSource::PathDifference => path - last_path,
                FeatureSource::Play(i) => self.plays[usize::from(i)],
                FeatureSource::Stop(i) => (path - self.plays[usize::from(i)]) / f64::from(config.play_thresholds[usize::from(i)]),
                FeatureSource::Readout => readout,
                FeatureSource::Creep(j) => self.creeps[usize::from(j)],
            };
            (signal - f64::from(feature.offset)) * f64::from(feature.gain)
        });
        (readout, features.collect())
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
                layer_step(layer, network.activation, f64::from(network.state_limit), &input, signals);
                input.clone_from(&signals.hidden);
            }
            on_network_step(&self.layers);
        }
        let hidden = self.layers.last().map_or(&[][..], |signals| signals.hidden.as_slice());
        f64::from(network.dense_bias) + wide(&network.dense_weights).zip(hidden).map(|(w, h)| w * h).sum::<f64>()
    }
}

fn layer_step(layer: &Layer, activation: Activation, limit: f64, input: &[f64], signals: &mut LayerSignals) {
    let act = |x: f64| match activation {
        Activation::Tanh => x.tanh(),
        Activation::Relu => x.clamp(0.0, limit),
        Activation::Hard => x.clamp(-1.0, 1.0),
    };
    signals.seen.clear();
    signals.seen.extend(input.iter().chain(&signals.hidden).chain([&1.0]));
    let dot = |weights: &[f32], values: &[f64]| wide(weights).zip(values).map(|(w, v)| w * v).sum::<f64>();
    signals.pre_activations.clear();
    let rows = layer.input_weights.chunks(layer.inputs).zip(layer.recurrent_weights.chunks(layer.units)).zip(&layer.bias);
    for ((from_input, from_hidden), bias) in rows {
        signals.pre_activations.push(f64::from(*bias) + dot(from_input, input) + dot(from_hidden, &signals.hidden));
    }
    let n = layer.units;
    let z = &signals.pre_activations;
    signals.input_gate = z[..n].iter().copied().map(sigmoid).collect();
    signals.forget_gate = z[n..2 * n].iter().copied().map(sigmoid).collect();
    signals.candidate = z[2 * n..3 * n].iter().copied().map(act).collect();
    signals.output_gate = z[3 * n..].iter().copied().map(sigmoid).collect();
    for unit in 0..n {
        let cell = signals.forget_gate[unit] * signals.cell[unit] + signals.input_gate[unit] * signals.candidate[unit];
        signals.cell[unit] = cell.clamp(-limit, limit);
        signals.hidden[unit] = signals.output_gate[unit] * act(signals.cell[unit]);
    }
}
