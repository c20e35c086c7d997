//! A model on a finer grid of thresholds, and without the operators that have no weight.

use crate::model::grid::coarse;
use crate::model::structure::Model;

impl Model {
    /// This model on a grid twice as fine; the new operators have no weight until the next fit.
    #[must_use]
    pub fn refined(&self) -> Self {
        let mut model = self.clone();
        model.thresholds.clear();
        model.base.truncate(1);
        for (index, &threshold) in self.thresholds.iter().enumerate() {
            if index > 0 {
                model.thresholds.push(0.5 * (self.thresholds[index - 1] + threshold));
                model.base.push(0.0);
            }
            model.thresholds.push(threshold);
            model.base.push(self.base[index + 1]);
        }
        model
    }

    /// This model with all operators of the fine grid besides its own; those that it had not have no weight until the next fit.
    #[must_use]
    pub fn regrown(&self) -> Self {
        let mut model = self.clone();
        let coarse = coarse();
        let between = coarse.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
        for threshold in coarse.iter().copied().chain(between) {
            let at = model.thresholds.partition_point(|other| *other < threshold);
            if model.thresholds.get(at) != Some(&threshold) {
                model.thresholds.insert(at, threshold);
                model.base.insert(at + 1, 0.0);
            }
        }
        model
    }

    /// This model without the operators that have no weight: it predicts the same. The first operator stays: with stops it is the
    /// spring beside them.
    #[must_use]
    pub fn pruned(&self) -> Self {
        let mut model = self.clone();
        let stays = |index: usize| index == 0 || self.base[index + 1] != 0.0;
        model.thresholds = self.thresholds.iter().enumerate().filter(|(index, _)| stays(*index)).map(|(_, value)| *value).collect();
        let weights = self.base[1..].iter().enumerate().filter(|(index, _)| stays(*index)).map(|(_, value)| *value);
        model.base = self.base[..1].iter().copied().chain(weights).collect();
        model
    }
}
