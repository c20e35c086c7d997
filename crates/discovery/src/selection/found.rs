//! What the search hands on.

use crate::model::structure::Model;
use crate::result::{Candidate, RunnerUp};

/// What the search hands on to the verdict.
#[derive(Default)]
pub struct Found {
    /// Names, the effect that is missed most first.
    pub order: Vec<&'static str>,
    /// Every effect tried alone, best first.
    pub candidates: Vec<Candidate>,
    /// The second best explanation.
    pub runner_up: Option<RunnerUp>,
    /// Whether the second explains as much with as few parameters.
    pub twins: bool,
    /// Whether the second takes the place of an effect that the recordings do not tell it from.
    pub alike: bool,
    /// How many deviations the first lies above the second.
    pub apart: f64,
    /// Where something jumps: mean square by which even a right observer misses the times of the jumps.
    pub jump_scatter: Option<f64>,
}

/// The model that was found, and what goes with it.
pub struct Outcome {
    /// The model with the effects, on the operators of the fine grid that have a weight.
    pub model: Model,
    /// The model of the second best explanation.
    pub second: Option<Model>,
    /// What goes to the verdict.
    pub found: Found,
    /// The best explanations that the search has met, on the fine grid: those that something which jumps may stand beside.
    pub met: Vec<Model>,
    /// Every effect alone, in its best form, on the coarse grid, best first.
    pub tried: Vec<Model>,
}
