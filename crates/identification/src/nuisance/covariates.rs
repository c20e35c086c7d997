//! Whether the zero answers to a slow signal, and by how much.

use super::halves::{Halves, square_as_is};
use super::named::{Candidates, Covariate, Left, Nuisances, before_step};
use super::statistics::{LEVEL, f_beyond, line};

/// Mean square error that a covariate must take away, as a share.
const COVARIATE_MATTERS: f64 = 0.15;
/// Fewest recordings that can show a line.
const FEWEST_LINE: usize = 5;

/// Names the most significant covariate that is not named yet, if it is significant and matters; whether there was one. What is left by
/// either reference may show it: the one with zeros of their own where those are large, the other where recordings are at different
/// operating points, whose levels tell nothing once each has a zero.
pub(crate) fn name_covariate(candidates: &Candidates, left: &[Left], found: &mut Nuisances) -> bool {
    if left.len() < FEWEST_LINE {
        return false;
    }
    let plain = Nuisances { covariates: vec![None; found.covariates.len()], ..found.clone() };
    let columns: Vec<Vec<f64>> = candidates.covariates.iter().map(|one| means(one, candidates, left, found)).collect();
    let named: Vec<usize> = (0..columns.len()).filter(|&index| found.covariates[index].is_some()).collect();
    let free: Vec<usize> = (0..columns.len()).filter(|index| !named.contains(index)).collect();
    let freedom = left.len() as f64 - named.len() as f64 - 2.0;
    if freedom < 1.0 {
        return false;
    }
    let trial = |with_zeros: bool, more: usize| {
        let halves: Vec<Halves> = left.iter().map(|one| Halves::of(candidates, one, one.values(with_zeros), &plain)).collect();
        let zeros: Vec<f64> = halves.iter().map(Halves::mean).collect();
        // Mean square of what each recording leaves about a zero that is predicted from the others.
        let scatter: f64 = halves.iter().map(|one| one.square_about(one.mean())).sum();
        let now: Vec<&[f64]> = named.iter().map(|&index| columns[index].as_slice()).collect();
        let with: Vec<&[f64]> = now.iter().copied().chain([columns[more].as_slice()]).collect();
        let (_, without, _) = line(&now, &zeros)?;
        let (coefficients, squares, left_out) = line(&with, &zeros)?;
        let chance = f_beyond((without - squares) / (squares / freedom).max(f64::MIN_POSITIVE), 1.0, freedom);
        Some((chance, left_out + scatter, more, coefficients))
    };
    let trials = [true, false].into_iter().flat_map(|with_zeros| free.iter().filter_map(move |&more| trial(with_zeros, more)));
    let tried = 2.0 * free.len() as f64;
    let before = square_as_is(candidates, left, found);
    let good = trials.filter(|(chance, after, ..)| chance * tried < LEVEL && *after < (1.0 - COVARIATE_MATTERS) * before);
    let Some((_, _, more, coefficients)) = good.min_by(|one, other| one.1.total_cmp(&other.1)) else { return false };
    for (index, coefficient) in named.into_iter().chain([more]).zip(coefficients) {
        found.covariates[index] = Some(coefficient);
    }
    true
}

/// Estimates the named covariates anew from what is left by the reference with or without zeros.
pub(crate) fn estimate_covariates(candidates: &Candidates, left: &[Left], with_zeros: bool, found: &mut Nuisances) {
    let named: Vec<usize> = (0..found.covariates.len()).filter(|&index| found.covariates[index].is_some()).collect();
    if named.is_empty() {
        return;
    }
    let plain = Nuisances { covariates: vec![None; found.covariates.len()], ..found.clone() };
    let zeros: Vec<f64> = left.iter().map(|one| Halves::of(candidates, one, one.values(with_zeros), &plain).mean()).collect();
    let columns: Vec<Vec<f64>> = named.iter().map(|&index| means(&candidates.covariates[index], candidates, left, found)).collect();
    if let Some((coefficients, ..)) = line(&columns.iter().map(Vec::as_slice).collect::<Vec<_>>(), &zeros) {
        named.iter().zip(coefficients).for_each(|(&index, coefficient)| found.covariates[index] = Some(coefficient));
    }
}

/// Mean of a covariate over each recording before its step.
fn means(covariate: &Covariate, candidates: &Candidates, left: &[Left], found: &Nuisances) -> Vec<f64> {
    let mean = |one: &Left| {
        let kept = before_step(candidates, one, found);
        let count = kept.len().max(1) as f64;
        kept.map(|place| covariate.values[one.series][one.samples[place]]).sum::<f64>() / count
    };
    left.iter().map(mean).collect()
}
