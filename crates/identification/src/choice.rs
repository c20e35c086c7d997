//! Which rung is shipped: the simplest that is as good as the best, and an average of those that are nearly as good as one more rung.
//!
//! The errors of two rungs on the same units rise and fall together, so what is compared is the mean of `ln(error / best's error)`
//! over units with its standard error (the one-standard-error rule of L. Breiman et al., Classification and Regression Trees, 1984,
//! section 3.4.3, on paired differences).

use crate::search::root_mean_square;
use crate::{Partition, SplitKind, Unit};

/// Seconds of data in fewer than three recordings below which only rungs of one addition take part: blocks of so little data are near
/// copies of each other, and reward whatever fits most.
pub const SMALL_S: f64 = 120.0;
/// Rungs within this factor of the best error take part in the average.
const NEAR: f64 = 1.3;
/// A simpler rung is as good within this relative error, whatever the standard error.
const MATERIAL: f64 = 0.02;
/// However uncertain the comparison, no rung is taken that is worse than the best by more than this relative error.
const MOST: f64 = 0.03;
/// Units below which a standard error says nothing: then the best is taken, which often is the average.
const FEW: usize = 6;

/// What a choice needs to know of a rung.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Short name.
    pub name: String,
    /// Error on each unit by a model and settings that it took no part in.
    pub errors: Vec<f64>,
    /// Predictions by those models, one list a recording.
    pub predictions: Vec<Vec<f64>>,
    /// Whether it may be chosen, or take part in an average, on these data.
    pub eligible: bool,
}

/// How much the data can decide.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// Whole recordings were left out: every rung takes part.
    Recordings,
    /// Blocks of one or two long recordings: rungs whose weights are bound in sign take part.
    Blocks,
    /// Blocks of little data: of those, rungs of one addition.
    Little,
}

impl Evidence {
    /// Of a partition of so many seconds of data.
    #[must_use]
    pub fn of(partition: &Partition, duration_s: f64) -> Self {
        match partition.kind() {
            SplitKind::Groups | SplitKind::Recordings => Self::Recordings,
            SplitKind::Blocks if duration_s < SMALL_S => Self::Little,
            SplitKind::Blocks => Self::Blocks,
        }
    }

    /// Whether a rung takes part.
    #[must_use]
    pub fn admits(self, rung: &crate::Rung) -> bool {
        match self {
            Self::Recordings => true,
            Self::Blocks => rung.bound,
            Self::Little => rung.bound && rung.small,
        }
    }
}

/// Mean logarithmic error; infinite when one is not finite. `floor` is what the rig itself repeats: below it nobody can tell two models
/// apart.
fn level(errors: &[f64], floor: f64) -> f64 {
    let sum: f64 = errors.iter().map(|error| error.max(floor).max(f64::MIN_POSITIVE).ln()).sum();
    let mean = sum / errors.len().max(1) as f64;
    if mean.is_finite() && errors.iter().all(|error| error.is_finite()) { mean } else { f64::INFINITY }
}

/// Shares of rungs in a weighted mean, none negative, one in sum; and that mean as an entry.
#[derive(Clone, Debug)]
pub struct Average {
    /// Index of each member among the entries, and its share.
    pub members: Vec<(usize, f64)>,
    /// Errors and predictions; the shares behind those of a fold come from the other folds.
    pub entry: Entry,
}

/// The weighted mean of the rungs that are near the best (stacked regression: L. Breiman, Machine Learning 24, 1996); `None` when fewer
/// than two are near.
///
/// The shares minimise the squared error of predictions by models that took no part, relative to that of the members on each unit.
/// Where units are few, or blocks of one recording, all shares are equal. `residuals` gives what the predictions of a recording leave of
/// a unit.
#[must_use]
pub fn average(entries: &[Entry], partition: &Partition, residuals: impl Fn(&Unit, &[f64]) -> Vec<f64>) -> Option<Average> {
    let best = entries.iter().filter(|entry| entry.eligible).map(|entry| level(&entry.errors, 0.0)).fold(f64::INFINITY, f64::min);
    let near = |index: &usize| entries[*index].eligible && level(&entries[*index].errors, 0.0) <= best + NEAR.ln();
    let members: Vec<usize> = (0..entries.len()).filter(near).collect();
    if members.len() < 2 || !best.is_finite() {
        return None;
    }
    let stacking = Stacking::new(&members, entries, partition, &residuals);
    let mut predictions: Vec<Vec<f64>> = entries[members[0]].predictions.iter().map(|one| vec![f64::NAN; one.len()]).collect();
    for fold in 0..partition.folds() {
        let shares = stacking.shares(|unit| partition.fold_of(unit) != fold);
        for (_, unit) in partition.units().iter().enumerate().filter(|(index, _)| partition.fold_of(*index) == fold) {
            for sample in unit.samples.clone() {
                let parts = members.iter().zip(&shares).map(|(&member, share)| share * entries[member].predictions[unit.series][sample]);
                predictions[unit.series][sample] = parts.sum();
            }
        }
    }
    let errors = partition.units().iter().map(|unit| root_mean_square(&residuals(unit, &predictions[unit.series]))).collect();
    let shares = stacking.shares(|_| true);
    let members = members.into_iter().zip(shares).filter(|&(_, share)| share > 0.0).collect();
    Some(Average { members, entry: Entry { name: "average".to_owned(), errors, predictions, eligible: true } })
}

/// Products of the members' residuals, one square matrix a unit.
struct Stacking {
    members: usize,
    /// Whether the data can tell shares at all.
    decides: bool,
    products: Vec<Vec<f64>>,
}

/// Pull of the shares towards equal ones, as a share of the members' mean square.
const EVEN: f64 = 0.1;

impl Stacking {
    fn new(members: &[usize], entries: &[Entry], partition: &Partition, residuals: &impl Fn(&Unit, &[f64]) -> Vec<f64>) -> Self {
        let count = members.len();
        let of = |unit: &Unit| {
            let left: Vec<Vec<f64>> = members.iter().map(|&member| residuals(unit, &entries[member].predictions[unit.series])).collect();
            let mut product = Vec::with_capacity(count * count);
            for row in &left {
                product.extend(left.iter().map(|column| row.iter().zip(column).map(|(a, b)| a * b).sum::<f64>()));
            }
            // Every unit counts alike, however long and however hard.
            let trace: f64 = (0..count).map(|member| product[member * (count + 1)]).sum();
            product.iter_mut().for_each(|value| *value /= trace.max(f64::MIN_POSITIVE));
            product
        };
        let decides = partition.kind() != SplitKind::Blocks && partition.units().len() >= FEW;
        Self { members: count, decides, products: partition.units().iter().map(of).collect() }
    }

    /// Shares from the units that take part.
    fn shares(&self, takes_part: impl Fn(usize) -> bool) -> Vec<f64> {
        let count = self.members;
        let even = vec![1.0 / count as f64; count];
        if !self.decides {
            return even;
        }
        let mut gram = vec![0.0; count * count];
        for (_, product) in self.products.iter().enumerate().filter(|(unit, _)| takes_part(*unit)) {
            gram.iter_mut().zip(product).for_each(|(sum, value)| *sum += value);
        }
        let trace: f64 = (0..count).map(|member| gram[member * (count + 1)]).sum();
        (0..count).for_each(|member| gram[member * (count + 1)] += EVEN * trace / count as f64);
        // The minimum of w'Gw with w >= 0 and sum(w) = 1 lies on the ray of v, the non-negative solution of Gv = 1.
        let Some(ray) = crate::nnls::solve_definite(&gram, &vec![1.0; count], &vec![true; count], &vec![false; count]) else { return even };
        let sum: f64 = ray.iter().sum();
        if sum > 0.0 { ray.iter().map(|value| value / sum).collect() } else { even }
    }
}

/// The index of the rung to ship: of the `entries`, simplest first, the first that is as good as the best.
#[must_use]
pub fn simplest(entries: &[Entry], floor: f64) -> Option<usize> {
    let levels: Vec<f64> = entries.iter().map(|entry| if entry.eligible { level(&entry.errors, floor) } else { f64::INFINITY }).collect();
    let best = (0..levels.len()).filter(|&index| levels[index].is_finite()).min_by(|&a, &b| levels[a].total_cmp(&levels[b]))?;
    (0..entries.len()).filter(|&index| levels[index].is_finite()).find(|&index| {
        let log = |error: &f64| error.max(floor).max(f64::MIN_POSITIVE).ln();
        let differences: Vec<f64> =
            entries[index].errors.iter().zip(&entries[best].errors).map(|(one, best)| log(one) - log(best)).collect();
        let allowed = if differences.len() < FEW { 0.0 } else { standard_error(&differences).clamp(MATERIAL.ln_1p(), MOST.ln_1p()) };
        levels[index] - levels[best] <= allowed
    })
}

fn standard_error(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    if values.len() < 2 {
        return f64::INFINITY;
    }
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Series;
    use crate::search::errors;

    /// Six units from three.
    fn entry(errors: &[f64]) -> Entry {
        let errors: Vec<f64> = errors.iter().copied().cycle().take(2 * errors.len().max(3)).collect();
        let errors = errors.as_slice();
        Entry { name: String::new(), errors: errors.to_vec(), predictions: Vec::new(), eligible: true }
    }

    #[test]
    fn a_tie_goes_to_the_simpler_and_a_clear_gain_does_not() {
        let simple = entry(&[1.0, 1.1, 0.9, 1.02]);
        let tied = entry(&[1.01, 1.08, 0.9, 1.0]);
        let better = entry(&[0.5, 0.55, 0.45, 0.5]);
        assert_eq!(simplest(&[simple.clone(), tied], 0.0), Some(0));
        assert_eq!(simplest(&[simple.clone(), better.clone()], 0.0), Some(1));
        assert_eq!(simplest(&[simple.clone(), better.clone()], 2.0), Some(0), "below what the rig repeats");
        assert_eq!(simplest(&[simple.clone(), Entry { eligible: false, ..better }], 0.0), Some(0));
        assert_eq!(simplest(&[entry(&[f64::NAN]), entry(&[1.0])], 0.0), Some(1));
        assert_eq!(simplest(&[], 0.0), None);
        let few = |errors: &[f64]| Entry { errors: errors.to_vec(), ..entry(&[1.0]) };
        assert_eq!(simplest(&[few(&[1.01, 1.0]), few(&[1.0, 1.0])], 0.0), Some(1), "two units tell nothing of the standard error");
    }

    /// Eight recordings; the first member errs by one half, the second by minus one, the third by ten.
    #[test]
    fn shares_cancel_errors_and_are_judged_by_folds_that_took_no_part_in_them() {
        let output: Vec<f64> = (0..50).map(|k| (f64::from(k) * 0.3).sin()).collect();
        let series: Vec<Series> = (0..8)
            .map(|index| Series {
                name: format!("r{index}"),
                group: String::new(),
                inputs: vec![output.clone()],
                output: output.clone(),
                gaps: Vec::new(),
                skip: 0,
            })
            .collect();
        let partition = Partition::new(&series);
        let member = |offset: f64| {
            let predictions: Vec<Vec<f64>> = (0..8).map(|_| output.iter().map(|value| value + offset).collect()).collect();
            let errors = errors(&predictions, &series, &partition);
            Entry { name: String::new(), errors, predictions, eligible: true }
        };
        let left = |unit: &Unit, predictions: &[f64]| -> Vec<f64> {
            let samples = unit.samples.clone();
            series[unit.series].output[samples.clone()]
                .iter()
                .zip(&predictions[samples])
                .map(|(measured, predicted)| measured - predicted)
                .collect()
        };
        let made = average(&[member(0.9), member(-1.0), member(10.0)], &partition, left).expect("two are near");
        let shares: Vec<f64> = made.members.iter().map(|member| member.1).collect();
        assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12 && shares.iter().all(|&share| share > 0.0));
        assert_eq!(made.members.iter().map(|member| member.0).collect::<Vec<_>>(), [0, 1], "the third is far from the best");
        assert!(made.entry.errors.iter().all(|&error| error < 0.05), "the errors cancel: {:?}", made.entry.errors);
        // A fold where the first alone would be best is judged by the shares of the others.
        let odd = |offset: f64| {
            let mut entry = member(offset);
            let odd: Vec<usize> = (0..8).filter(|&unit| partition.fold_of(unit) == 0).collect();
            for &unit in &odd {
                entry.predictions[unit] = output.iter().map(|value| value + if offset > 0.0 { 0.5 } else { 1.5 }).collect();
            }
            entry.errors = errors(&entry.predictions, &series, &partition);
            entry
        };
        let made = average(&[odd(0.9), odd(-1.0)], &partition, left).expect("two are near");
        for unit in (0..8).filter(|&unit| partition.fold_of(unit) == 0) {
            assert!((0.9..1.05).contains(&made.entry.errors[unit]), "{:?}", made.entry.errors);
        }
    }

    #[test]
    fn however_noisy_the_comparison_a_clearly_worse_mean_is_not_taken() {
        let noisy = entry(&[2.0, 0.6, 1.9, 0.7]);
        let steady = entry(&[1.0, 1.0, 1.0, 1.0]);
        assert_eq!(simplest(&[noisy, steady], 0.0), Some(1));
    }
}
