//! The ladder: its rungs, and what a finished one promises.

use identification::choice::Evidence;
use identification::{LinearModel, SplitKind};
use serde::Serialize;

use super::judging::{Judging, mean};
use super::prepare::Prepared;
use crate::network::TrainedModel;
use crate::physics::fitted::{self, FittedModel, Member};
use crate::physics::nuisance::Nuisance;
use crate::physics::{Calibrated, Expected, PhysicsModel};
use recording::repeatability::Repeatability;

/// How to fit.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Seed of every random choice.
    pub seed: u64,
    /// Worker threads.
    pub threads: usize,
    /// CPU time of the training of one shipped network in s; cross-validation trains with half of it. `None`: no networks.
    pub network_budget_cpu_s: Option<f64>,
    /// Seconds at the start of each recording that the error with calibration takes to set the zero; `None`: about a tenth of the shortest
    /// recording, and the result states it.
    pub calibrate_s: Option<f64>,
}

/// What is reported while it goes.
#[derive(Clone, Debug)]
pub enum Progress {
    /// A model that can be used already.
    First(Box<FittedModel>),
    /// So many of so many outer folds of the physics rungs are done.
    Physics {
        /// Done.
        done: usize,
        /// In all.
        of: usize,
    },
    /// A training begins: number, trainings in all, and what is trained.
    Network {
        /// Number, from 1.
        number: usize,
        /// In all.
        of: usize,
        /// Which.
        name: &'static str,
    },
    /// Share of the processor time of all trainings that is behind.
    Trained(f64),
    /// Why no network is trained, or what else a person should know.
    Note(String),
}

/// A model of any rung.
#[derive(Clone, Debug)]
pub enum RungModel {
    /// A weighted sum of columns.
    Linear(LinearModel),
    /// The weighted mean of other rungs, by index and share.
    Average(Vec<(usize, f64)>),
    /// An identified physics model.
    Physics(Box<PhysicsModel>),
    /// A trained network.
    Network(Box<TrainedModel>),
}

/// One rung of the finished ladder.
#[derive(Clone, Debug, Serialize)]
pub struct LadderRung {
    /// Short name.
    pub name: String,
    /// What it is, in words.
    pub what: String,
    /// Mean error on recordings that took no part, in the output's unit.
    pub cv_rmse: f64,
    /// Central 95 % prediction interval for the error on the next recording.
    pub cv_interval: [f64; 2],
    /// The same with the zero set at the start of the recording; absent for blocks.
    pub calibrated: Option<Calibrated>,
    /// Mean error with each recording's own nuisances taken off: what rungs are compared by, and no promise.
    pub shape_rmse: f64,
    /// Numbers that were fitted.
    pub parameters: usize,
    /// Instructions of one step on the Cortex-M4F, about.
    pub step_instructions: usize,
    /// Whether the microcontroller's blob can hold it.
    pub on_chip: bool,
    /// Whether these data may choose it.
    pub eligible: bool,
    /// Wall time in s; that of all physics rungs is shared among them.
    pub seconds: f64,
    /// Error on each unit left out, as it is.
    pub errors: Vec<f64>,
    /// The same with the unit's own nuisances taken off.
    pub shape_errors: Vec<f64>,
    /// The model fitted to all data.
    #[serde(skip)]
    pub model: RungModel,
    /// Predictions by models that took no part, one list an even recording.
    #[serde(skip)]
    pub predictions: Vec<Vec<f64>>,
    /// The nuisances that the data name, as this model sees them.
    #[serde(skip)]
    pub nuisances: Vec<Nuisance>,
}

/// How recordings were left out.
#[derive(Clone, Debug, Serialize)]
pub struct Splits {
    /// What was left out at a time.
    pub kind: SplitKind,
    /// Outer folds.
    pub folds: usize,
    /// Recordings or blocks.
    pub units: usize,
    /// What the data can decide.
    pub evidence: Evidence,
    /// The same in words.
    pub what: String,
    /// Fold of each unit, by the recording's name.
    pub members: Vec<(String, usize)>,
}

/// A finished ladder.
pub struct Outcome {
    /// The data as they were fitted.
    pub prepared: Prepared,
    /// Simplest first.
    pub ladder: Vec<LadderRung>,
    /// Index of the rung to ship.
    pub chosen: usize,
    /// What the rig repeats.
    pub repeatability: Repeatability,
    /// Seconds at the start of each recording that the errors with calibration take.
    pub calibrate_s: f64,
    /// How recordings were left out.
    pub splits: Splits,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// Networks are not trained where physics is within this factor of what the rig repeats.
pub(super) const AT_REPEATABILITY: f64 = 1.1;
/// Instructions of one multiplication of a sum of columns, with its loads and its share of the comparisons: counted by hand from the
/// Cortex-M4F's instruction set, for models that have no blob to measure.
pub(super) const INSTRUCTIONS: usize = 7;

impl LadderRung {
    /// A rung with the errors of its left-out predictions, for the rest to be filled in.
    pub(super) fn new(name: &str, what: &str, judging: &Judging, predictions: Vec<Vec<f64>>, model: RungModel) -> Self {
        let verdict = judging.of(&predictions);
        Self {
            name: name.to_owned(),
            what: what.to_owned(),
            cv_rmse: verdict.cv_rmse,
            cv_interval: verdict.cv_interval,
            calibrated: verdict.calibrated,
            shape_rmse: mean(&verdict.shape_errors),
            parameters: 0,
            step_instructions: 0,
            on_chip: false,
            eligible: true,
            seconds: 0.0,
            errors: verdict.errors,
            shape_errors: verdict.shape_errors,
            model,
            predictions,
            nuisances: Vec::new(),
        }
    }
}

impl Outcome {
    /// The model file of a rung that is a sum of columns or a mean of such; `None` for the others, which have formats of their own.
    #[must_use]
    pub fn fitted(&self, index: usize) -> Option<FittedModel> {
        let rung = &self.ladder[index];
        let member = |rung: &LadderRung, share: f64| match &rung.model {
            RungModel::Linear(model) => Some(Member { name: rung.name.clone(), share, model: model.clone() }),
            _ => None,
        };
        let members: Vec<Member> = match &rung.model {
            RungModel::Average(members) => members.iter().map(|&(one, share)| member(&self.ladder[one], share)).collect::<Option<_>>()?,
            _ => vec![member(rung, 1.0)?],
        };
        Some(fitted(&self.prepared, &rung.name, members, self.expected(index), rung.nuisances.clone()))
    }

    /// What a rung promises for the next recording.
    #[must_use]
    pub fn expected(&self, rung: usize) -> Expected {
        let rung = &self.ladder[rung];
        Expected { rmse: rung.cv_rmse, interval: rung.cv_interval, left_out: self.splits.what.clone(), calibrated: rung.calibrated.clone() }
    }
}

/// A model file.
pub(super) fn fitted(prepared: &Prepared, name: &str, members: Vec<Member>, expected: Expected, nuisances: Vec<Nuisance>) -> FittedModel {
    FittedModel {
        kind: fitted::KIND.to_owned(),
        format_version: fitted::FORMAT_VERSION,
        name: name.to_owned(),
        program: format!("catheter {}", env!("CARGO_PKG_VERSION")),
        sample_period_s: prepared.period_s,
        inputs: prepared.inputs.clone(),
        output: prepared.output.clone(),
        expected,
        data: prepared.sources.clone(),
        nuisances,
        members,
    }
}
