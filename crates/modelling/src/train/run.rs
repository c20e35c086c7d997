//! The training loop: batches, optimiser steps, validations, checkpoints.

use std::time::Instant;

use cpu_time::ThreadTime;

use super::budget::Plan;
use super::checkpoint::{Checkpoint, CheckpointPlan};
use super::config::TrainConfig;
use super::quantised;
use super::report::{Ended, Milestone, Progress, TrainError};
use super::stability;
use super::team::Team;
use super::tracks::{Track, Walk, Windows};
use super::validation::Validation;
use crate::network::{Mode, Network};

/// The run is cut off when it used this many times its budget.
const OVER_BUDGET: f64 = 2.0;
/// Validations of the quantised phase.
const QUANTISED_VALIDATIONS: u64 = 5;
/// Changes the seed for the quantised phase, whose visits are others.
const QUANTISED_SEED: u64 = 0x5155_414e;
/// Optimiser steps from one projection onto certified weights to the next.
const PROJECTION_INTERVAL: u64 = 32;

/// Fills batches one way or the other.
pub(super) enum Feed {
    Walk(Walk),
    Windows(Windows),
}

/// A run that is set up: data prepared, network started.
pub(super) struct Run<'a> {
    pub(super) config: &'a TrainConfig,
    pub(super) tracks: Vec<Track>,
    pub(super) output_scale: f64,
    pub(super) target_scale: f32,
    pub(super) team: Team,
    pub(super) feed: Feed,
    pub(super) seed: u64,
    pub(super) validation: Validation,
}

impl Feed {
    pub(super) fn new(tracks: &[Track], config: &TrainConfig, seed: u64) -> Self {
        match config.mode {
            Mode::Streaming => Self::Walk(Walk::new(tracks, config, seed)),
            Mode::Window { length } => Self::Windows(Windows::new(tracks, length, config.lanes, seed)),
        }
    }

    fn skip(&mut self, batches: u64) {
        match self {
            Self::Walk(walk) => walk.skip(batches),
            Self::Windows(windows) => windows.skip(batches),
        }
    }
}

/// What a finished loop leaves.
pub(super) struct Finished {
    pub(super) best: Vec<f32>,
    pub(super) steps: u64,
    pub(super) planned_steps: u64,
    pub(super) history: Vec<Milestone>,
    pub(super) ended: Ended,
    pub(super) steps_here: u64,
    pub(super) step_seconds: f64,
}

impl Finished {
    pub(super) fn without_network() -> Self {
        Self {
            best: Vec::new(),
            steps: 0,
            planned_steps: 0,
            history: Vec::new(),
            ended: Ended::PhysicsSuffices,
            steps_here: 0,
            step_seconds: 0.0,
        }
    }
}

/// What a run has found so far.
#[derive(Default)]
struct Found {
    best: Vec<f32>,
    best_square: f64,
    since_best: u64,
    history: Vec<Milestone>,
    training_square: f64,
    /// Largest magnitude of each layer's hidden state, once known.
    largest_hidden: Vec<f64>,
}

impl Run<'_> {
    /// Error of the output, in its unit, for a mean square of the network's own target.
    fn training_rmse(&self, mean_square: f64) -> f64 {
        mean_square.sqrt() * f64::from(self.target_scale) * self.output_scale
    }

    pub(super) fn go(
        &mut self,
        steps: Plan,
        plan: &CheckpointPlan,
        fingerprint: &str,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Finished, TrainError> {
        let clock = ThreadTime::now();
        let mut found = Found { best_square: f64::INFINITY, ..Found::default() };
        if let Some(saved) = plan.load(fingerprint)? {
            if let Some(problem) = saved.problem(&self.team.state(), steps.float_steps + steps.quantised_steps) {
                return Err(plan.refused(problem));
            }
            self.team.restore(&saved.team);
            self.feed.skip(saved.team.steps_made);
            found = Found {
                best: saved.best,
                best_square: saved.best_square,
                since_best: saved.since_best,
                history: saved.history,
                training_square: saved.training_square,
                largest_hidden: Vec::new(),
            };
        }
        let first_step = self.team.steps_made();
        let total_steps = steps.float_steps + steps.quantised_steps;
        let mut step_seconds = 0.0;
        let mut ended = Ended::Complete;
        let mut report = |run: &Self, found: &Found| {
            progress(Progress {
                steps: run.team.steps_made(),
                total_steps,
                training_rmse: run.training_rmse(found.training_square),
                validation_rmse: found.history.last().map(|milestone| milestone.validation_rmse),
            });
        };

        let interval = (steps.float_steps / self.config.validations).max(1);
        while self.team.steps_made() < steps.float_steps {
            if self.config.patience > 0 && found.since_best >= self.config.patience {
                ended = Ended::EarlyStop;
                break;
            }
            let done = self.team.steps_made() + 1;
            step_seconds += self.step(self.config.learning_rate_at(done - 1, steps.float_steps), &mut found);
            let validate = done.is_multiple_of(interval) || done == steps.float_steps;
            if validate {
                let parameters = self.result();
                self.validate(parameters, &mut found);
            }
            if validate || done.is_multiple_of(16) {
                report(self, &found);
            }
            let interrupted = plan.stop_after.is_some_and(|stop| done >= stop) && done < total_steps;
            if validate || interrupted {
                plan.save(fingerprint, &self.checkpoint(&found))?;
            }
            ended = self.cut_off(interrupted, clock);
            if ended != Ended::Complete {
                break;
            }
        }
        if found.best.is_empty() {
            found.best = self.result();
        }

        if steps.quantised_steps > 0 && matches!(ended, Ended::Complete | Ended::EarlyStop) {
            let float_ended = ended;
            self.begin_quantised(&mut found)?;
            let interval = (steps.quantised_steps / QUANTISED_VALIDATIONS).max(1);
            for done in 1..=steps.quantised_steps {
                let rate = self.config.quantised_learning_rate * self.config.learning_rate_at(done - 1, steps.quantised_steps);
                step_seconds += self.step(rate, &mut found);
                let validate = done.is_multiple_of(interval) || done == steps.quantised_steps;
                if validate {
                    let parameters = self.rounded(&self.result(), &found)?;
                    self.validate(parameters, &mut found);
                }
                if validate || done.is_multiple_of(16) {
                    report(self, &found);
                }
                // No checkpoint here: resumed, the phase starts anew from the last one and comes out the same.
                let interrupted = plan.stop_after.is_some_and(|stop| self.team.steps_made() >= stop) && done < steps.quantised_steps;
                ended = self.cut_off(interrupted, clock);
                if ended != Ended::Complete {
                    break;
                }
            }
            if ended == Ended::Complete {
                ended = float_ended;
            }
        }
        if ended != Ended::Interrupted {
            plan.remove();
        }
        let made = self.team.steps_made();
        Ok(Finished {
            best: found.best,
            steps: made,
            planned_steps: total_steps,
            history: found.history,
            ended,
            steps_here: made - first_step,
            step_seconds,
        })
    }

    /// One batch, one optimiser step; gives the wall time it took in s.
    fn step(&mut self, learning_rate: f32, found: &mut Found) -> f64 {
        let clock = Instant::now();
        let first = self.team.steps_made() == 0;
        match &mut self.feed {
            Feed::Walk(walk) => walk.fill(&self.tracks, self.target_scale, &mut self.team.batch()),
            Feed::Windows(windows) => windows.fill(&self.tracks, self.target_scale, &mut self.team.batch()),
        }
        let loss = self.team.step(learning_rate);
        if self.config.certified_radius > 0.0 && self.team.steps_made().is_multiple_of(PROJECTION_INTERVAL) {
            let mut state = self.team.state();
            state.values = self.certified(state.values);
            self.team.restore(&state);
        }
        found.training_square = if first { loss } else { 0.98 * found.training_square + 0.02 * loss };
        clock.elapsed().as_secs_f64()
    }

    /// The parameters that would be kept now.
    fn result(&self) -> Vec<f32> {
        self.certified(match self.config.optimizer.average_decay > 0.0 {
            true => self.team.averaged_parameters(),
            false => self.team.parameters(),
        })
    }

    /// The parameters, brought to where the certificate holds if that is wanted.
    fn certified(&self, parameters: Vec<f32>) -> Vec<f32> {
        if self.config.certified_radius == 0.0 {
            return parameters;
        }
        let mut network = Network::from_flat(self.team.architecture(), &parameters);
        stability::project(&mut network, self.config.certified_radius);
        network.to_flat()
    }

    fn validate(&mut self, parameters: Vec<f32>, found: &mut Found) {
        let square = self.validation.mean_square(&parameters, &self.tracks, self.target_scale);
        found.history.push(Milestone {
            steps: self.team.steps_made(),
            training_rmse: self.training_rmse(found.training_square),
            validation_rmse: square.sqrt() * self.output_scale,
        });
        if square < found.best_square {
            (found.best, found.best_square, found.since_best) = (parameters, square, 0);
        } else {
            found.since_best += 1;
        }
    }

    /// The parameters that the integers stand for.
    fn rounded(&self, parameters: &[f32], found: &Found) -> Result<Vec<f32>, TrainError> {
        let rounded = quantised::rounded(self.team.architecture(), parameters, &found.largest_hidden);
        rounded.map(|(_, flat)| flat).map_err(|error| TrainError::Data(format!("the network does not fit fixed point: {error}")))
    }

    /// Goes over to the fixed-point forward pass, from the best parameters, on visits that start anew. The best so far becomes that of
    /// the rounded weights: what counts is what the microcontroller runs.
    fn begin_quantised(&mut self, found: &mut Found) -> Result<(), TrainError> {
        found.largest_hidden = self.validation.largest_hidden(&found.best, &self.tracks);
        self.team.quantise(found.largest_hidden.clone());
        let mut state = self.team.state();
        state.values.clone_from(&found.best);
        state.average.clone_from(&found.best);
        state.carried.iter_mut().for_each(|carried| carried.fill(0.0));
        self.team.restore(&state);
        self.feed = Feed::new(&self.tracks, self.config, self.seed ^ QUANTISED_SEED);
        let parameters = self.rounded(&found.best, found)?;
        (found.best_square, found.since_best) = (f64::INFINITY, 0);
        self.validate(parameters, found);
        Ok(())
    }

    fn checkpoint(&self, found: &Found) -> Checkpoint {
        Checkpoint {
            team: self.team.state(),
            best: found.best.clone(),
            best_square: found.best_square,
            since_best: found.since_best,
            history: found.history.clone(),
            training_square: found.training_square,
        }
    }

    /// `clock` is of the thread that leads: what else the process does is not this training's.
    fn cut_off(&self, interrupted: bool, clock: ThreadTime) -> Ended {
        let cpu_s = clock.elapsed().as_secs_f64() * self.team.threads() as f64;
        if interrupted {
            Ended::Interrupted
        } else if self.config.epochs.is_none() && cpu_s > OVER_BUDGET * self.config.budget_cpu_s {
            Ended::OverBudget
        } else {
            Ended::Complete
        }
    }
}
