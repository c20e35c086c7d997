//! The trained model in `f32`, free running: what fixed point shall reproduce.

use firmware::estimator::{FrontEnd, FrontEndState};
use model_export::validate::Invalid;

use crate::network::{Mode, NetworkState, TrainedModel};

/// A model that runs in `f32`.
pub struct Single<'a> {
    model: &'a TrainedModel,
    front_end: FrontEnd,
    physics: FrontEndState,
    network: Option<NetworkState>,
    features: Vec<f32>,
    window: Vec<Vec<f32>>,
}

impl<'a> Single<'a> {
    /// A model before its first sample.
    ///
    /// # Errors
    /// When a field of the front end is out of its domain.
    pub fn new(model: &'a TrainedModel) -> Result<Self, Invalid> {
        let front_end = model.built_front_end()?;
        let features = vec![0.0; front_end.features()];
        let network = model.network.as_ref().map(NetworkState::new);
        Ok(Self { model, front_end, physics: FrontEndState::default(), network, features, window: Vec::new() })
    }

    /// One sample, a value of each input in its unit, gives the output in its unit.
    pub fn step(&mut self, raw: &[f32]) -> f32 {
        let readout = self.front_end.step(&mut self.physics, raw, &mut self.features).readout;
        let mut correction = 0.0;
        if let (Some(network), Some(state)) = (&self.model.network, &mut self.network) {
            match self.model.mode {
                Mode::Streaming => correction = network.step(state, &self.features),
                Mode::Window { length } => {
                    if self.window.is_empty() {
                        self.window = vec![self.features.clone(); length];
                    }
                    self.window.remove(0);
                    self.window.push(self.features.clone());
                    state.reset();
                    for features in &self.window {
                        correction = network.step(state, features);
                    }
                }
            }
        }
        self.model.output.offset + self.model.output.scale * (readout + correction)
    }
}
