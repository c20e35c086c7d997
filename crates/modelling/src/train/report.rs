//! What a training tells: while it goes, at its end, and why it did not happen.

use serde::{Deserialize, Serialize};

/// Why training did not happen.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A setting is out of its domain.
    #[error("setting {0}")]
    Config(String),
    /// The recordings cannot be trained on.
    #[error("{0}")]
    Data(String),
    /// The front end cannot be built.
    #[error("front end: {0}")]
    FrontEnd(#[from] model_export::validate::Invalid),
    /// A checkpoint cannot be written, read or used.
    #[error("{0}")]
    Checkpoint(String),
}

/// What a run reports while it goes.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Optimiser steps made.
    pub steps: u64,
    /// Optimiser steps planned.
    pub total_steps: u64,
    /// Root mean square training error of the last steps, in output units.
    pub training_rmse: f64,
    /// Last root mean square validation error in output units, if there was a validation.
    pub validation_rmse: Option<f64>,
}

/// What a run cost and reached; the keys other programs rely on, and a few more.
#[derive(Clone, Debug, Serialize)]
pub struct TrainReport {
    /// Weights and biases of the network.
    pub parameters: usize,
    /// Multiply-accumulates of one forward step.
    pub macs_per_step: usize,
    /// Passes over the training samples.
    pub epochs: f64,
    /// Wall time in s.
    pub seconds: f64,
    /// CPU time of the process in s.
    pub cpu_seconds: f64,
    /// Multiply-accumulates a second, three per weight and trained sample, over the wall time of the optimiser steps.
    pub train_macs_per_second: f64,
    /// Free-running error on the validation part in output units.
    pub val_rmse: f64,
    /// The front end's readout alone, on the same samples.
    pub val_rmse_front_end: f64,
    /// Optimiser steps made.
    pub optimiser_steps: u64,
    /// Optimiser steps planned.
    pub planned_steps: u64,
    /// Why the run ended.
    pub ended: Ended,
    /// Training recordings, and recordings in all.
    pub training_recordings: usize,
    /// Synthetic recordings among what was trained on.
    pub synthetic_recordings: usize,
    /// Errors along the way.
    pub history: Vec<Milestone>,
    /// Error on each recording with a validation part.
    pub validation: Vec<Validated>,
}

/// Errors at one validation, in output units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Milestone {
    /// Optimiser steps made.
    pub steps: u64,
    /// Running root mean square over the last batches.
    pub training_rmse: f64,
    /// Free running over the validation part.
    pub validation_rmse: f64,
}

/// How well one recording is predicted, free running.
#[derive(Clone, Debug, Serialize)]
pub struct Validated {
    /// The file.
    pub path: String,
    /// Root mean square error on its validation samples, in output units.
    pub rmse: f64,
}

/// Why a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ended {
    /// All planned steps were made.
    Complete,
    /// The front end's readout is exact, or the network of a hybrid made it no better: the model has no network.
    PhysicsSuffices,
    /// Validation stopped improving.
    EarlyStop,
    /// The clock ran far past the budget: this machine is much slower than the nominal one.
    OverBudget,
    /// Stopped on request; the checkpoint can be resumed.
    Interrupted,
}
