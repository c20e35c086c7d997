//! A hidden case: what to hide, what was hidden, what was recorded.

use recording::{Recording, RecordingError};
use serde::Serialize;

use crate::command::Excitation;

/// Which of the virtual rigs makes the recordings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Generator {
    /// Physics at 10 kHz.
    #[default]
    Physics,
    /// Discrete laws at 1 kHz, other forms and strengths.
    Rival,
    /// Laws drawn for every effect, of the set that choices may look at.
    ComposedTuning,
    /// Laws drawn for every effect, of the set that only judges.
    ComposedReporting,
}

/// What to hide and how.
#[derive(Clone, Debug)]
pub struct CaseConfig {
    /// Names of the effects or aliens; none for a rig without a secret.
    pub effects: Vec<String>,
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// Standard deviation of the noise relative to the output's range.
    pub noise: f64,
    /// Whether half of the noise is correlated in time.
    pub coloured_noise: bool,
    /// Kind of session.
    pub excitation: Excitation,
    /// The rig.
    pub generator: Generator,
    /// Whether the pressure in the muscle is recorded too (the physics rig only), with noise of 0.2 % of its range.
    pub measured_pressure: bool,
}

impl Default for CaseConfig {
    /// Nothing hidden in the paper's session with half a percent of white noise.
    fn default() -> Self {
        Self {
            effects: Vec::new(),
            seed: 1,
            noise: 0.005,
            coloured_noise: false,
            excitation: Excitation::Paper,
            generator: Generator::Physics,
            measured_pressure: false,
        }
    }
}

/// What was hidden.
#[derive(Clone, Debug, Serialize)]
pub struct Truth {
    /// Names.
    pub effects: Vec<String>,
    /// Whether any of them is outside the catalogue.
    pub alien: bool,
    /// Values drawn, `effect.parameter_unit`.
    pub parameters: std::collections::BTreeMap<String, f64>,
    /// Stages behind the muscle (the others lie before it).
    pub sensor_side: Vec<String>,
    /// Seed.
    pub seed: u64,
    /// Standard deviation of the noise, mm.
    pub noise_mm: f64,
    /// Whether the noise is coloured.
    pub coloured_noise: bool,
    /// Half dead travel of the sliders, bar.
    pub slack_bar: Vec<f64>,
    /// Their displacement, mm/bar.
    pub pull_mm_per_bar: Vec<f64>,
    /// Whether the muscle remembers one recording in the next.
    pub continuous: bool,
}

/// A hidden case: recordings to work with, recordings of other kinds to judge by, and the truth.
#[derive(Clone, Debug)]
pub struct Case {
    /// The session.
    pub recordings: Vec<Recording>,
    /// Kept-out recordings, the same rig later in the session.
    pub kept_out: Vec<Recording>,
    /// What was hidden.
    pub truth: Truth,
}

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// No such effect.
    #[error("the rig cannot hide {name:?}; it knows {known}")]
    UnknownEffect {
        /// Name asked for.
        name: String,
        /// Names there are.
        known: String,
    },
    /// A recording could not be made.
    #[error(transparent)]
    Recording(#[from] RecordingError),
}
