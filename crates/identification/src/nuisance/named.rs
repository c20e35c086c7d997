//! What may be a nuisance, what is named as one, and what a reference leaves of a recording.

use super::place::place;
use super::statistics::range;
use crate::Series;

/// A slow signal beside the inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariate {
    /// What it is: `drift` for session time, `temperature`.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// One value a sample, one list a recording.
    pub values: Vec<Vec<f64>>,
}

/// What a search knows of possible nuisances before it looks at any two recordings together.
#[derive(Clone, Debug, Default)]
pub(crate) struct Candidates {
    /// Index of the first sample behind the most likely step of each recording.
    pub steps: Vec<Option<usize>>,
    /// Covariates, less [`Self::centres`] and over [`Self::halves`].
    pub covariates: Vec<Covariate>,
    /// Mean over the recordings of each covariate: where a model stands.
    pub centres: Vec<f64>,
    /// Half of each one's range.
    pub halves: Vec<f64>,
}

/// What is decided, and what it was estimated as.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Nuisances {
    /// Whether each recording has a zero of its own.
    pub zeros: bool,
    /// Whether each recording has a step.
    pub steps: Vec<bool>,
    /// Coefficient of each covariate, for the covariate centred and scaled; absent: no nuisance.
    pub covariates: Vec<Option<f64>>,
    /// Estimates by the reference, for recordings that took part: the zero less the mean zero.
    pub offsets: Vec<f64>,
    /// The same: height of each step.
    pub heights: Vec<f64>,
}

/// What a reference leaves of a recording that took no part in it.
pub(crate) struct Left {
    pub series: usize,
    /// Samples in order, and what is left there by a reference without zeros in its weights.
    pub samples: Vec<usize>,
    pub left: Vec<f64>,
    /// The same by a reference that knows of steps alone, constant taken off.
    pub as_is: Vec<f64>,
}

impl Candidates {
    /// Looks for a place in each recording by itself, and centres the covariates.
    pub fn of(series: &[Series], columns: impl Fn(&Series, &[usize]) -> Vec<Vec<f64>>) -> Self {
        Self { steps: series.iter().map(|one| place(one, &columns)).collect(), ..Self::default() }
    }

    /// Takes covariates that move.
    pub fn with(mut self, covariates: Vec<Covariate>, recordings: usize) -> Self {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let useful = |covariate: &Covariate| {
            let (low, high) = range(covariate.values.iter().flatten().copied());
            high > low && covariate.values.len() == recordings && (high - low).is_finite()
        };
        for mut covariate in covariates.into_iter().filter(useful) {
            let (low, high) = range(covariate.values.iter().flatten().copied());
            let centre = mean(&covariate.values.iter().map(|one| mean(one)).collect::<Vec<_>>());
            let half = 0.5 * (high - low);
            covariate.values.iter_mut().flatten().for_each(|value| *value = (*value - centre) / half);
            self.covariates.push(covariate);
            self.centres.push(centre);
            self.halves.push(half);
        }
        self
    }
}

impl Nuisances {
    /// None at all.
    pub(crate) fn none(candidates: &Candidates) -> Self {
        Self {
            zeros: false,
            steps: vec![false; candidates.steps.len()],
            covariates: vec![None; candidates.covariates.len()],
            offsets: vec![0.0; candidates.steps.len()],
            heights: vec![0.0; candidates.steps.len()],
        }
    }

    /// All that can be projected out: for a reference.
    pub(crate) fn all(candidates: &Candidates) -> Self {
        Self { zeros: true, steps: candidates.steps.iter().map(Option::is_some).collect(), ..Self::none(candidates) }
    }

    /// Whether nothing is named.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        !self.zeros && !self.steps.contains(&true) && self.covariates.iter().all(Option::is_none)
    }

    /// What the covariates move sample `index` of a recording by.
    pub(crate) fn moved(&self, candidates: &Candidates, series: usize, index: usize) -> f64 {
        let pairs = self.covariates.iter().zip(&candidates.covariates);
        pairs.filter_map(|(coefficient, covariate)| Some((*coefficient)? * covariate.values[series][index])).sum()
    }

    /// The output of a recording that took part, its nuisances taken off; the mean zero stays.
    pub(crate) fn cleaned(&self, candidates: &Candidates, series: usize, output: &[f64]) -> Vec<f64> {
        let step = candidates.steps[series].filter(|_| self.steps[series]).unwrap_or(usize::MAX);
        let height = |index: usize| if index >= step { self.heights[series] } else { 0.0 };
        let own = if self.zeros { self.offsets[series] } else { 0.0 };
        output.iter().enumerate().map(|(index, value)| value - own - height(index) - self.moved(candidates, series, index)).collect()
    }
}

/// Places of what is left that lie before a step that is named.
pub(super) fn before_step(candidates: &Candidates, one: &Left, found: &Nuisances) -> std::ops::Range<usize> {
    let step = candidates.steps[one.series].filter(|_| found.steps[one.series]).unwrap_or(usize::MAX);
    0..one.samples.partition_point(|&sample| sample < step)
}

impl Left {
    /// What the reference with zeros in its weights leaves, or the one without.
    pub(super) fn values(&self, with_zeros: bool) -> &[f64] {
        if with_zeros { &self.left } else { &self.as_is }
    }
}

/// What predictions leave of a unit with its own nuisances taken off, as far as they are named: how well the shape is known.
pub(crate) fn shape_residuals(
    nuisances: &Nuisances,
    candidates: &Candidates,
    predictions: &[f64],
    one: &Series,
    unit: &crate::Unit,
) -> Vec<f64> {
    let left = |sample: usize| one.output[sample] - predictions[sample] - nuisances.moved(candidates, unit.series, sample);
    let mut left: Vec<f64> = unit.samples.clone().map(left).collect();
    let step = candidates.steps[unit.series].filter(|_| nuisances.steps[unit.series]).unwrap_or(usize::MAX);
    let (before, behind) = left.split_at_mut(step.saturating_sub(unit.samples.start).min(unit.samples.len()));
    for (part, has_own_zero) in [(before, nuisances.zeros), (behind, true)] {
        if has_own_zero && !part.is_empty() {
            let zero = part.iter().sum::<f64>() / part.len() as f64;
            part.iter_mut().for_each(|value| *value -= zero);
        }
    }
    left
}
