//! A plant at work: a whole row of pressures at once, or stepped from outside.

use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::config::{self, PlantConfig, PlantError};
use super::effects;

/// Longest internal step of the continuous effects in s.
pub const INTERNAL_STEP_S: f64 = 0.001;

/// Stream of the random generator for measurement noise.
const NOISE_STREAM: u64 = 7;

/// A plant, validated and ready to run.
#[derive(Clone, Debug)]
pub struct Plant {
    config: PlantConfig,
}

impl Plant {
    /// Builds the plant.
    ///
    /// # Errors
    /// When a parameter makes no sense, naming it.
    pub fn new(config: PlantConfig) -> Result<Self, PlantError> {
        config.validate()?;
        Ok(Self { config })
    }

    /// The plant of a name or file: `pi` (the default parameters without effects), `all-effects`, or the path of a TOML file.
    ///
    /// # Errors
    /// When there is no such file, or it is no valid plant.
    pub fn named(name: &str) -> Result<Self, PlantError> {
        match name {
            "pi" => Self::new(PlantConfig::default()),
            "all-effects" => Self::new(PlantConfig::all_effects()),
            path => Self::new(config::read(Path::new(path))?),
        }
    }

    /// Its parameters.
    #[must_use]
    pub fn config(&self) -> &PlantConfig {
        &self.config
    }

    /// The displacement in mm for pressures in bar, one value a sample; `seed` is that of the measurement noise.
    #[must_use]
    pub fn simulate(&self, pressure_bar: &[f64], sample_period_s: f64, seed: u64) -> Vec<f64> {
        let Some(&first_bar) = pressure_bar.first() else { return Vec::new() };
        let mut state = effects::State::new(&self.config, first_bar);
        let steps = if self.config.is_continuous() { (sample_period_s / INTERNAL_STEP_S - 1e-9).ceil().max(1.0) } else { 1.0 };
        let step_s = sample_period_s / steps;
        let mut previous_bar = first_bar;
        let mut displacement_mm = Vec::with_capacity(pressure_bar.len());
        for (index, &target_bar) in pressure_bar.iter().enumerate() {
            if index > 0 {
                for step in 1..steps as usize {
                    state.advance(&self.config, previous_bar + (target_bar - previous_bar) * step as f64 / steps, step_s);
                }
                // The last step takes the sample itself, so that nothing is lost to rounding.
                state.advance(&self.config, target_bar, step_s);
            }
            previous_bar = target_bar;
            displacement_mm.push(state.displacement_mm(&self.config));
        }
        if let Some(noise) = &self.config.measurement_noise {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(NOISE_STREAM);
            displacement_mm.iter_mut().for_each(|value| *value += noise.standard_deviation_mm * normal(&mut random));
        }
        displacement_mm
    }
}

/// A plant that is stepped from outside, for a rig in simulated time; without measurement noise, which its sensors bring.
pub struct RunningPlant {
    config: PlantConfig,
    state: effects::State,
}

impl Plant {
    /// The plant at its equilibrium for a pressure in bar.
    #[must_use]
    pub fn start(&self, pressure_bar: f64) -> RunningPlant {
        RunningPlant { config: self.config.clone(), state: effects::State::new(&self.config, pressure_bar) }
    }
}

impl RunningPlant {
    /// The displacement in mm after a step of `step_s` at `pressure_bar`; steps of at most [`INTERNAL_STEP_S`].
    pub fn step(&mut self, pressure_bar: f64, step_s: f64) -> f64 {
        self.state.advance(&self.config, pressure_bar, step_s);
        self.state.displacement_mm(&self.config)
    }
}

/// A standard normal number by the Box-Muller transform.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    // 1 - u lies in (0, 1]: the logarithm is finite.
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.random::<f64>()).cos()
}
