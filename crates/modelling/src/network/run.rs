//! A trained model on raw samples, free running from the start, in f32.

use std::collections::VecDeque;

use firmware::estimator::{FrontEnd, FrontEndState};
use model_export::validate::Invalid;

use super::{Mode, Network, NetworkState, Sequence, TrainedModel, narrowed};

/// Windows that [`TrainedModel::predict`] runs side by side.
const WINDOW_LANES: usize = 32;

/// Largest value of a feature: the network's inputs are Q1.14 on the microcontroller, and training sees the same limits.
const FEATURE_MAXIMUM: f32 = 2.0 - 1.0 / 16384.0;

/// A feature within the range that the fixed-point network can take.
#[must_use]
pub fn limit_feature(value: f32) -> f32 {
    value.clamp(-2.0, FEATURE_MAXIMUM)
}

/// The sample that is step number `step` of the window that ends at sample `end`: before the first sample the input is taken to have
/// rested where it begins.
#[must_use]
pub fn window_sample(end: usize, length: usize, step: usize) -> usize {
    (end + 1 + step).saturating_sub(length)
}

/// A model with its state.
pub struct Runner<'a> {
    model: &'a TrainedModel,
    front_end: FrontEnd,
    front_end_state: FrontEndState,
    network_state: Option<NetworkState>,
    features: Vec<f32>,
    /// Features of the last samples, in window mode.
    window: VecDeque<Vec<f32>>,
    /// Where the stick band rests, in normalised output.
    stuck: Option<f32>,
}

impl TrainedModel {
    /// The model, ready to run from rest.
    ///
    /// # Errors
    /// When the front end is out of its domain.
    pub fn runner(&self) -> Result<Runner<'_>, Invalid> {
        let front_end = self.built_front_end()?;
        Ok(Runner {
            model: self,
            features: vec![0.0; front_end.features()],
            front_end,
            front_end_state: FrontEndState::default(),
            network_state: self.network.as_ref().map(NetworkState::new),
            window: VecDeque::new(),
            stuck: None,
        })
    }

    /// Output in output units for every sample of `inputs`, one list each, free running from the start; each index in `gaps` starts
    /// afresh. Inputs beyond the model's are not looked at, and one that is missing is taken to rest.
    ///
    /// # Errors
    /// When the front end is out of its domain.
    pub fn predict(&self, inputs: &[&[f64]], gaps: &[usize]) -> Result<Vec<f64>, Invalid> {
        let samples = inputs.first().map_or(0, |values| values.len());
        if let (Mode::Window { length }, Some(network)) = (self.mode, &self.network)
            && network.is_lstm()
        {
            return self.predict_windows(network, length, inputs, gaps);
        }
        let mut runner = self.runner()?;
        let mut gaps = gaps.iter().peekable();
        Ok((0..samples)
            .map(|index| {
                if gaps.next_if(|&&gap| gap == index).is_some() {
                    runner.reset();
                }
                runner.step(&narrowed(inputs, index))
            })
            .collect())
    }

    /// The same in window mode, many windows at a time: one by one they would take ten times as long.
    fn predict_windows(&self, network: &Network, length: usize, inputs: &[&[f64]], gaps: &[usize]) -> Result<Vec<f64>, Invalid> {
        let samples = inputs.first().map_or(0, |values| values.len());
        let mut runner = self.runner()?;
        let parameters = network.to_flat();
        let mut sequence = Sequence::new(&network.architecture(), WINDOW_LANES, length);
        let width = runner.features.len();
        let mut predicted = Vec::with_capacity(samples);
        let starts = std::iter::once(0).chain(gaps.iter().copied());
        let ends = gaps.iter().copied().chain(std::iter::once(samples));
        for stretch in starts.zip(ends).map(|(start, end)| start..end) {
            runner.reset();
            let (mut linear, mut features) = (Vec::new(), Vec::new());
            for sample in stretch.clone() {
                linear.push(runner.prepare(&narrowed(inputs, sample)));
                features.extend_from_slice(&runner.features);
            }
            for first in (0..stretch.len()).step_by(WINDOW_LANES) {
                let filled = first..stretch.len().min(first + WINDOW_LANES);
                let rows = sequence.features_mut(length);
                for (lane, end) in filled.clone().enumerate() {
                    for step in 0..length {
                        let source = &features[window_sample(end, length, step) * width..][..width];
                        rows[(step * WINDOW_LANES + lane) * width..][..width].copy_from_slice(source);
                    }
                }
                (0..WINDOW_LANES).for_each(|lane| sequence.reset_lane(lane));
                let last = &sequence.forward(&parameters)[(length - 1) * WINDOW_LANES..];
                predicted.extend(filled.zip(last).map(|(end, &correction)| runner.finish(linear[end] + correction)));
            }
        }
        Ok(predicted)
    }
}

impl Runner<'_> {
    /// Forgets everything.
    pub fn reset(&mut self) {
        self.front_end_state.reset();
        self.window.clear();
        self.stuck = None;
        if let Some(state) = &mut self.network_state {
            state.reset();
        }
    }

    /// One sample, a value of each input in its units; gives the output in output units.
    pub fn step(&mut self, raw: &[f32]) -> f64 {
        let mut normalised = self.prepare(raw);
        if let (Some(network), Some(state)) = (&self.model.network, &mut self.network_state) {
            normalised += match self.model.mode {
                Mode::Streaming => network.step(state, &self.features),
                Mode::Window { length } => {
                    // Before the first sample the input is taken to have rested where it begins.
                    while self.window.len() < length {
                        self.window.push_back(self.features.clone());
                    }
                    self.window.pop_front();
                    self.window.push_back(self.features.clone());
                    state.reset();
                    let mut last = 0.0;
                    for features in &self.window {
                        last = network.step(state, features);
                    }
                    last
                }
            };
        }
        self.finish(normalised)
    }

    /// Runs the front end: the features are ready, its readout in normalised output is the result.
    fn prepare(&mut self, raw: &[f32]) -> f32 {
        let output = self.front_end.step(&mut self.front_end_state, raw, &mut self.features);
        self.features.iter_mut().for_each(|feature| *feature = limit_feature(*feature));
        output.readout
    }

    /// The stick band, and back to output units.
    fn finish(&mut self, normalised: f32) -> f64 {
        let band = self.model.front_end.stick_band;
        let stuck = self.stuck.map_or(normalised, |last| hysteresis::stick_band::step(band, normalised, last));
        self.stuck = Some(stuck);
        f64::from(self.model.output.offset) + f64::from(self.model.output.scale) * f64::from(stuck)
    }
}
