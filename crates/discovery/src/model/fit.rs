//! Fitting the weights of a model.

use crate::data::session::Session;
use crate::model::least_squares::Gram;
use crate::model::structure::{Model, Scope};
use crate::model::workspace::Workspace;

impl Model {
    /// Fits the weights, with passes where an effect acts on the model's own output; mean squares of fitted and selecting samples.
    ///
    /// With passes the figures are those of the last weights on columns made with them: what [`Self::predict`] then leaves, whether or not
    /// the passes have settled.
    pub fn fit(&mut self, session: &Session, scope: Scope) -> (f64, f64) {
        self.fit_in(&mut Workspace::new(session), scope)
    }

    /// As [`Self::fit`].
    pub(crate) fn fit_in(&mut self, workspace: &mut Workspace<'_>, scope: Scope) -> (f64, f64) {
        let mut sums = workspace.sums(self, scope);
        if self.fixed_weights {
            let weights = self.weigh_jumps(&sums.fit);
            return (sums.fit.mean_square(&weights), sums.select.mean_square(&weights));
        }
        let mut weights = sums.fit.solve(&sums.free, &self.weights());
        self.take(&weights);
        if self.needs_sum() {
            for _ in 0..PASSES {
                sums = workspace.sums(self, scope);
                weights = sums.fit.solve(&sums.free, &weights);
                self.take(&weights);
            }
            sums = workspace.sums(self, scope);
        }
        (sums.fit.mean_square(&weights), sums.select.mean_square(&weights))
    }

    /// One pass of a fit to the fitted samples, by what effects make of the weights so far.
    pub(crate) fn fit_once(&mut self, session: &Session, scope: Scope) {
        let sums = Workspace::new(session).sums(self, scope);
        let weights = sums.fit.solve(&sums.free, &self.weights());
        self.take(&weights);
    }

    /// Fits the weight of what jumps beside all others as they are; the weights then.
    fn weigh_jumps(&mut self, sums: &Gram) -> Vec<f64> {
        let Some(slot) = self.slots.iter().position(|slot| slot.form.jumps().is_some()) else { return self.weights() };
        let before = self.slots[..slot].iter().map(|slot| slot.weights.len()).sum::<usize>();
        self.slots[slot].weights = vec![0.0];
        let others = self.weights();
        self.slots[slot].weights = vec![sums.weight_beside(self.base.len() + before, &others).max(0.0)];
        self.weights()
    }

    /// Fits the weights to fitted and selecting samples together.
    pub fn fit_all(&mut self, session: &Session) -> f64 {
        let passes = if self.needs_sum() && !self.fixed_weights { 1 + PASSES } else { 1 };
        let mut workspace = Workspace::new(session);
        let mut result = f64::MAX;
        for _ in 0..passes {
            let mut sums = workspace.sums(self, Scope::Both);
            sums.fit.add(&sums.select);
            let weights = if self.fixed_weights { self.weigh_jumps(&sums.fit) } else { sums.fit.solve(&sums.free, &self.weights()) };
            result = sums.fit.mean_square(&weights);
            self.take(&weights);
        }
        result
    }
}

/// Passes after the first where an effect acts on the model's own output.
const PASSES: usize = 2;
