//! Checkpoints: everything a run needs to go on as if it had never stopped.

use std::collections::HashMap;
use std::path::PathBuf;

use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize};

use super::report::{Milestone, TrainError};
use super::team::TeamState;

/// Where checkpoints go and whether one is picked up.
#[derive(Clone, Debug, Default)]
pub struct CheckpointPlan {
    /// File of the checkpoint; none are written when absent.
    pub path: Option<PathBuf>,
    /// Go on from the file.
    pub resume: bool,
    /// Stop after this many optimiser steps, leaving a checkpoint.
    pub stop_after: Option<u64>,
}

/// The state of a run between two optimiser steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Weights, optimiser, network states.
    pub team: TeamState,
    /// Parameters of the best validation so far; empty before the first.
    pub best: Vec<f32>,
    /// Mean square of the best validation, normalised.
    pub best_square: f64,
    /// Validations since.
    pub since_best: u64,
    /// Errors so far.
    pub history: Vec<Milestone>,
    /// Running mean square of the training error.
    pub training_square: f64,
}

#[derive(Serialize, Deserialize)]
struct Numbers {
    fingerprint: String,
    steps_made: u64,
    threads: usize,
    /// Bits of f64 values: JSON numbers would lose infinities and may lose the last bit.
    best_square: u64,
    since_best: u64,
    history: Vec<(u64, u64, u64)>,
    training_square: u64,
}

const METADATA_KEY: &str = "catheter-checkpoint";

impl CheckpointPlan {
    /// The error about this checkpoint.
    pub(super) fn refused(&self, problem: String) -> TrainError {
        let path = self.path.as_deref().unwrap_or(std::path::Path::new("the checkpoint"));
        TrainError::Checkpoint(format!("{}: {problem}", path.display()))
    }

    /// Writes the checkpoint, if there is a place for it.
    pub(super) fn save(&self, fingerprint: &str, checkpoint: &Checkpoint) -> Result<(), TrainError> {
        let Some(path) = &self.path else { return Ok(()) };
        let failed = |message: String| TrainError::Checkpoint(format!("{}: {message}", path.display()));
        let bytes = checkpoint.to_bytes(fingerprint).map_err(failed)?;
        output::write_atomic(path, &bytes).map_err(|error| failed(format!("{error:#}")))
    }

    /// Reads the checkpoint when resuming.
    pub(super) fn load(&self, fingerprint: &str) -> Result<Option<Checkpoint>, TrainError> {
        let Some(path) = self.path.as_ref().filter(|_| self.resume) else { return Ok(None) };
        let failed = |message: String| TrainError::Checkpoint(format!("{}: {message}", path.display()));
        let bytes =
            output::read(path).map_err(|error| failed(format!("no checkpoint to resume from ({error}); start without --resume")))?;
        Checkpoint::from_bytes(&bytes, fingerprint).map(Some).map_err(failed)
    }

    /// Removes the checkpoint of a finished run.
    pub(super) fn remove(&self) {
        if let Some(path) = &self.path {
            // It may never have been written.
            let _ = std::fs::remove_file(path);
        }
    }
}

impl Checkpoint {
    /// What does not go with a run whose team is in the state `fresh` before its first step and makes `total_steps`, if anything.
    pub(super) fn problem(&self, fresh: &TeamState, total_steps: u64) -> Option<String> {
        let lengths = |state: &TeamState| {
            let lists = [&state.values, &state.average, &state.mean, &state.square];
            let lists = lists.into_iter().chain(&state.bases).chain(&state.carried);
            (state.bases.len(), state.carried.len(), lists.map(Vec::len).collect::<Vec<_>>())
        };
        if lengths(&self.team) != lengths(fresh) || ![0, fresh.values.len()].contains(&self.best.len()) {
            return Some("the checkpoint is damaged: its arrays are not as long as those of this run; start without --resume".to_owned());
        }
        let steps = self.team.steps_made;
        (steps > total_steps)
            .then(|| format!("the checkpoint is damaged: it has made {steps} steps of a run of {total_steps}; start without --resume"))
    }
}

fn bytes_of(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

impl Checkpoint {
    fn to_bytes(&self, fingerprint: &str) -> Result<Vec<u8>, String> {
        let numbers = Numbers {
            fingerprint: fingerprint.to_owned(),
            steps_made: self.team.steps_made,
            threads: self.team.carried.len(),
            best_square: self.best_square.to_bits(),
            since_best: self.since_best,
            history: self.history.iter().map(|at| (at.steps, at.training_rmse.to_bits(), at.validation_rmse.to_bits())).collect(),
            training_square: self.training_square.to_bits(),
        };
        let team = &self.team;
        let mut parts = vec![
            ("values".to_owned(), &team.values),
            ("mean".to_owned(), &team.mean),
            ("square".to_owned(), &team.square),
            ("average".to_owned(), &team.average),
            ("best".to_owned(), &self.best),
        ];
        parts.extend(team.carried.iter().enumerate().map(|(thread, state)| (format!("carried.{thread}"), state)));
        parts.extend(team.bases.iter().enumerate().map(|(thread, state)| (format!("bases.{thread}"), state)));
        let parts: Vec<_> = parts.into_iter().map(|(name, values)| (name, values.len(), bytes_of(values))).collect();
        let mut views = Vec::with_capacity(parts.len());
        for (name, length, bytes) in &parts {
            views.push((name.clone(), TensorView::new(Dtype::F32, vec![*length], bytes).map_err(|error| error.to_string())?));
        }
        let json = serde_json::to_string(&numbers).map_err(|error| error.to_string())?;
        serialize(views, Some(HashMap::from([(METADATA_KEY.to_owned(), json)]))).map_err(|error| error.to_string())
    }

    fn from_bytes(bytes: &[u8], fingerprint: &str) -> Result<Self, String> {
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|error| format!("not a readable checkpoint ({error})"))?;
        let json = header.metadata().as_ref().and_then(|entries| entries.get(METADATA_KEY)).ok_or("not a checkpoint of this tool")?;
        let numbers: Numbers = serde_json::from_str(json).map_err(|error| format!("not a readable checkpoint ({error})"))?;
        if numbers.fingerprint != fingerprint {
            return Err("the checkpoint is of a run with other data, settings, seed or threads; repeat that run's options, or start \
                        without --resume"
                .to_owned());
        }
        let tensors = SafeTensors::deserialize(bytes).map_err(|error| format!("not a readable checkpoint ({error})"))?;
        let read = |name: &str| -> Result<Vec<f32>, String> {
            let tensor = tensors.tensor(name).map_err(|error| error.to_string())?;
            if tensor.dtype() != Dtype::F32 {
                return Err(format!("the checkpoint is damaged: `{name}` holds {:?} where F32 is expected", tensor.dtype()));
            }
            let (words, _) = tensor.data().as_chunks::<4>();
            let values: Vec<f32> = words.iter().map(|&word| f32::from_le_bytes(word)).collect();
            match values.iter().position(|value| !value.is_finite()) {
                Some(index) => Err(format!("the checkpoint is damaged: element {index} of `{name}` is not finite; start without --resume")),
                None => Ok(values),
            }
        };
        let training_square = f64::from_bits(numbers.training_square);
        let best_square = f64::from_bits(numbers.best_square);
        // The best is infinite before the first validation.
        if !training_square.is_finite() || best_square.is_nan() {
            return Err("the checkpoint is damaged: an error so far is not a number; start without --resume".to_owned());
        }
        Ok(Self {
            team: TeamState {
                steps_made: numbers.steps_made,
                values: read("values")?,
                average: read("average")?,
                mean: read("mean")?,
                square: read("square")?,
                bases: (0..numbers.threads).map(|thread| read(&format!("bases.{thread}"))).collect::<Result<_, _>>()?,
                carried: (0..numbers.threads).map(|thread| read(&format!("carried.{thread}"))).collect::<Result<_, _>>()?,
            },
            best: read("best")?,
            best_square,
            since_best: numbers.since_best,
            history: numbers
                .history
                .into_iter()
                .map(|(steps, training, validation)| Milestone {
                    steps,
                    training_rmse: f64::from_bits(training),
                    validation_rmse: f64::from_bits(validation),
                })
                .collect(),
            training_square,
        })
    }
}
