//! Fitting the weights of a model.

use crate::data::session::Session;
use crate::model::least_squares::Gram;
use crate::model::structure::{Model, Scope};
use crate::model::workspace::{Sums, Workspace};

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
        let (sums, weights) = self.settle(|model| workspace.sums(model, scope));
        (sums.fit.mean_square(&weights), sums.select.mean_square(&weights))
    }

    /// Fits the weights to the samples that `sums_of` makes the first of its sums of; the weights, and the sums of columns made
    /// with them.
    ///
    /// Where an effect acts on the model's own output its columns hang on the weights. Each pass goes to the weights that the columns of the last ones
    /// ask for, or half as far where that leaves more: a friction that is strong turns its own sum about, and passes in full would miss each other.
    fn settle(&mut self, mut sums_of: impl FnMut(&Self) -> Sums) -> (Sums, Vec<f64>) {
        let mut sums = sums_of(self);
        if self.fixed_weights {
            self.weigh_jumps(&sums.fit);
            return (sums, self.weights());
        }
        let mut weights = sums.fit.solve(&sums.free, &self.weights());
        self.take(&weights);
        if !self.needs_sum() {
            return (sums, weights);
        }
        sums = sums_of(self);
        let mut square = sums.fit.mean_square(&weights);
        let mut share = 1.0;
        for _ in 0..PASSES {
            let aim = sums.fit.solve(&sums.free, &weights);
            let trial: Vec<f64> = weights.iter().zip(&aim).map(|(from, to)| from + share * (to - from)).collect();
            self.take(&trial);
            let sums_there = sums_of(self);
            let there = sums_there.fit.mean_square(&trial);
            if there < square {
                let has_settled = there > SETTLED * square;
                (weights, sums, square, share) = (trial, sums_there, there, f64::min(2.0 * share, 1.0));
                if has_settled {
                    break;
                }
            } else {
                share *= 0.5;
            }
        }
        self.take(&weights);
        (sums, weights)
    }

    /// One pass of a fit to the fitted samples, by what effects make of the weights so far.
    pub(crate) fn fit_once(&mut self, session: &Session, scope: Scope) {
        let sums = Workspace::new(session).sums(self, scope);
        self.take(&sums.fit.solve(&sums.free, &self.weights()));
    }

    /// Fits the weight of what jumps beside all others as they are.
    fn weigh_jumps(&mut self, sums: &Gram) {
        let Some(slot) = self.slots.iter().position(|slot| slot.form.jumps().is_some()) else { return };
        let before = self.slots[..slot].iter().map(|slot| slot.weights.len()).sum::<usize>();
        self.slots[slot].weights = vec![0.0];
        let others = self.weights();
        self.slots[slot].weights = vec![sums.weight_beside(self.base.len() + before, &others).max(0.0)];
    }

    /// Fits the weights to fitted and selecting samples together.
    pub fn fit_all(&mut self, session: &Session) {
        let mut workspace = Workspace::new(session);
        self.settle(|model| {
            let mut sums = workspace.sums(model, Scope::Both);
            sums.fit.add(&sums.select);
            sums
        });
    }
}

/// Most passes after the first where an effect acts on the model's own output.
const PASSES: usize = 6;

/// What a pass leaves of the mean square where another one is not worth its time.
const SETTLED: f64 = 0.998;

#[cfg(test)]
mod tests {
    use std::path::Path;

    use recording::{Recording, Signal};

    use super::*;
    use crate::effects::smooth_hysteresis;
    use crate::model::initial_state::InitialState;

    /// Root mean square that a model leaves of the only recording.
    fn left(model: &Model, session: &Session) -> f64 {
        let squares = model.predict(&session.runs[0]).iter().zip(&session.runs[0].output).map(|(p, y)| (y - p).powi(2)).sum::<f64>();
        (squares / session.runs[0].output.len() as f64).sqrt()
    }

    #[test]
    fn shorter_steps_leave_no_more_than_full_ones_and_far_less_where_full_ones_miss_each_other() {
        let time_s: Vec<f64> = (0..1500).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 1.0 + (0.9 * time).sin() * (0.11 * time).cos()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let mut session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        for friction in [-0.15, -0.08, 0.1, 0.2] {
            let bare = Model::baseline(InitialState::Fresh, false).with(smooth_hysteresis::FORMS[0], vec![0.2, -0.3, 1.5]);
            let mut rig = bare.clone();
            rig.base = (0..bare.base.len()).map(|weight| if weight == 0 { 0.1 } else { 0.6 / (weight * weight) as f64 }).collect();
            rig.slots[0].weights = vec![friction];
            session.runs[0].output = rig.predict(&session.runs[0]);
            let mut fitted = bare.clone();
            fitted.fit_all(&session);
            let mut in_full = bare.clone();
            (0..3).for_each(|_| in_full.fit_once(&session, Scope::Both));
            let [shorter, full] = [fitted, in_full].map(|model| left(&model, &session));
            assert!(shorter <= full && (friction < 0.0 || shorter < 0.5 * full), "friction {friction}: {shorter}, in full {full}");
        }
    }
}
