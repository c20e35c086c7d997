//! What the search hands on.

use crate::data::session::Session;
use crate::model::structure::Model;
use crate::result::Candidate;

/// What the search hands on beside models.
#[derive(Default)]
pub struct Found {
    /// Names of the effects that came in.
    pub order: Vec<&'static str>,
    /// Every effect tried alone, best first.
    pub candidates: Vec<Candidate>,
    /// Where something jumps: mean square by which even a right observer misses the times of the jumps.
    pub jump_scatter: Option<f64>,
    /// What every effect that jumps gains there over the best smooth observer, nats per sample.
    pub jump_gains: Vec<(&'static str, f64)>,
}

/// The model that was found, and what goes with it.
pub struct Outcome {
    /// The model with the effects, on the operators of the fine grid that have a weight.
    pub model: Model,
    /// What goes to the verdict.
    pub found: Found,
    /// The best explanations that the search has met, on the fine grid: those that something which jumps may stand beside, and before them other
    /// kinds of jumps and a valve's simulations, where something was found to jump.
    pub met: Vec<Model>,
    /// Every effect alone, in its best form, on the coarse grid, best first.
    pub tried: Vec<Model>,
}

impl Outcome {
    /// Of a model that nothing is looked for beside.
    #[must_use]
    pub fn of(session: &Session, model: &Model) -> Self {
        let mut fine = model.refined();
        fine.fit_all(session);
        Self { model: fine.pruned(), found: Found::default(), met: Vec::new(), tried: Vec::new() }
    }
}
