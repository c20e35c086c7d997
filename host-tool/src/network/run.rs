//! A trained model on raw samples, free running from the start, in f32.

use std::collections::VecDeque;

use firmware::estimator::{FrontEnd, FrontEndState};
use model_export::validate::Invalid;

use super::{Mode, NetworkState, TrainedModel};

/// Largest value of a feature: the network's inputs are Q1.14 on the microcontroller, and training sees the same limits.
const FEATURE_MAXIMUM: f32 = 2.0 - 1.0 / 16384.0;

/// A feature within the range that the fixed-point network can take.
#[must_use]
pub fn limit_feature(value: f32) -> f32 {
    value.clamp(-2.0, FEATURE_MAXIMUM)
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
        let front_end = FrontEnd::new(&self.front_end, &self.input.as_wire())?;
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

    /// Output in output units for every input sample, free running from the start; each index in `gaps` starts afresh.
    ///
    /// # Errors
    /// When the front end is out of its domain.
    pub fn predict(&self, input: &[f64], gaps: &[usize]) -> Result<Vec<f64>, Invalid> {
        let mut runner = self.runner()?;
        let mut gaps = gaps.iter().peekable();
        Ok(input
            .iter()
            .enumerate()
            .map(|(index, &raw)| {
                if gaps.next_if(|&&gap| gap == index).is_some() {
                    runner.reset();
                }
                runner.step(raw)
            })
            .collect())
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

    /// One sample in input units; gives the output in output units.
    pub fn step(&mut self, raw: f64) -> f64 {
        #[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
        let raw = raw as f32;
        let output = self.front_end.step(&mut self.front_end_state, raw, &mut self.features);
        let mut normalised = output.linear;
        self.features.iter_mut().for_each(|feature| *feature = limit_feature(*feature));
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
        let band = self.model.front_end.stick_band;
        let stuck = self.stuck.map_or(normalised, |last| hysteresis::stick_band::step(band, normalised, last));
        self.stuck = Some(stuck);
        f64::from(self.model.output.offset) + f64::from(self.model.output.scale) * f64::from(stuck)
    }
}
