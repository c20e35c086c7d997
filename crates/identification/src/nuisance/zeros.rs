//! Whether each recording has a zero of its own; what all nuisances are estimated as.

use super::covariates::estimate_covariates;
use super::halves::{Halves, square_as_is};
use super::named::{Candidates, Left, Nuisances, before_step};
use super::statistics::{LEVEL, f_beyond};

/// Mean square error that zeros must take away, as a share.
const ZEROS_MATTER: f64 = 0.5;
/// Fewest recordings whose zeros can be compared.
const FEWEST: usize = 3;

/// Decides whether each recording has a zero of its own, beside steps and covariates that are named. `inside` is what the reference
/// without zeros leaves of recordings that it was fitted to: levels that it can explain at all may belong to an operating point.
pub(crate) fn decide_on_zeros(candidates: &Candidates, left: &[Left], inside: &[Left], found: &mut Nuisances) {
    if left.len() < FEWEST {
        return;
    }
    let halves: Vec<Halves> = left.iter().map(|one| Halves::of(candidates, one, &one.left, found)).collect();
    let mean = halves.iter().map(Halves::mean).sum::<f64>() / halves.len() as f64;
    let after: f64 = halves.iter().map(Halves::crossed).sum();
    let between = halves.iter().map(|one| 2.0 * (one.mean() - mean).powi(2)).sum::<f64>() / (halves.len() - 1) as f64;
    let within = halves.iter().map(|one| 0.5 * (one.first - one.second).powi(2)).sum::<f64>() / halves.len() as f64;
    let chance = f_beyond(between / within.max(f64::MIN_POSITIVE), (halves.len() - 1) as f64, halves.len() as f64);
    let before = square_as_is(candidates, left, found).min(square_as_is(candidates, inside, found));
    found.zeros = chance < LEVEL && after < (1.0 - ZEROS_MATTER) * before;
}

/// Estimates what is named, from what a reference that all recordings took part in leaves.
pub(crate) fn estimate(candidates: &Candidates, left: &[Left], found: &mut Nuisances) {
    if found.zeros {
        estimate_covariates(candidates, left, true, found);
    }
    let halves: Vec<Halves> = left.iter().map(|one| Halves::of(candidates, one, &one.left, found)).collect();
    let mean = halves.iter().map(Halves::mean).sum::<f64>() / halves.len().max(1) as f64;
    for (one, halves) in left.iter().zip(&halves) {
        found.offsets[one.series] = halves.mean() - mean;
        let behind = before_step(candidates, one, found).end..one.samples.len();
        if found.steps[one.series] && !behind.is_empty() {
            let count = behind.len() as f64;
            let sum: f64 = behind.map(|place| one.left[place] - found.moved(candidates, one.series, one.samples[place])).sum();
            found.heights[one.series] = sum / count - halves.mean();
        }
    }
}
