//! What is left of a recording, half by half and as it is.

use super::named::{Candidates, Left, Nuisances, before_step};

/// The two halves of what is left of a recording before its step, the covariates' part taken off.
pub(super) struct Halves {
    /// Means, and mean squares about them.
    pub(super) first: f64,
    pub(super) second: f64,
    pub(super) first_square: f64,
    pub(super) second_square: f64,
}

impl Halves {
    pub(super) fn of(candidates: &Candidates, one: &Left, values: &[f64], found: &Nuisances) -> Self {
        let places = before_step(candidates, one, found);
        let values: Vec<f64> = places.map(|place| values[place] - found.moved(candidates, one.series, one.samples[place])).collect();
        let (first, second) = values.split_at(values.len() / 2);
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let square = |values: &[f64]| {
            let centre = mean(values);
            mean(&values.iter().map(|value| (value - centre).powi(2)).collect::<Vec<_>>())
        };
        Self { first: mean(first), second: mean(second), first_square: square(first), second_square: square(second) }
    }

    pub(super) fn mean(&self) -> f64 {
        0.5 * (self.first + self.second)
    }

    /// Mean square about a given zero.
    pub(super) fn square_about(&self, zero: f64) -> f64 {
        0.5 * (self.first_square + self.second_square + (self.first - zero).powi(2) + (self.second - zero).powi(2))
    }

    /// Mean square of each half about the zero of the other.
    pub(super) fn crossed(&self) -> f64 {
        0.5 * (self.first_square + self.second_square) + (self.first - self.second).powi(2)
    }
}

/// Mean square of the error of the reference without zeros, the covariates' part taken off, summed over recordings.
pub(super) fn square_as_is(candidates: &Candidates, left: &[Left], found: &Nuisances) -> f64 {
    let of = |one: &Left| {
        let kept = before_step(candidates, one, found);
        let count = kept.len().max(1) as f64;
        let left = |place: usize| one.as_is[place] - found.moved(candidates, one.series, one.samples[place]);
        kept.map(|place| left(place).powi(2)).sum::<f64>() / count
    };
    left.iter().map(of).sum()
}
