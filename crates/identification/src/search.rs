//! The search for recipes, and the nested cross-validation of all rungs.
//!
//! On one training set the rungs are searched in order, each from what earlier ones found, setting by setting; a candidate's score is
//! its error on the inner folds that took no part in its weights. Moments of candidates are remembered: the outer folds meet many of
//! them again, and only add and subtract.

use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use crate::nuisance::{self, Candidates, Left};
use crate::recipe::{Recipe, Spectrum, Surroundings};
use crate::regression::BOUND_PENALTIES;
use crate::regression::Normal;
use crate::split::Training;
use crate::{
    Covariate, Fit, LinearModel, Moments, Nuisances, PENALTIES, Partition, Rung, Series, Signs, SplitKind, Weights, moments, rungs,
};

/// Rows that the second moments are made from at most; longer data are thinned evenly, behind memory that moves with all samples.
const ROWS: usize = 40_000;

/// Numbers of moments kept at most: half a gigabyte.
const KEPT: usize = 64 << 20;
/// Rounds in which a reference's weights and coefficients of covariates are estimated in turn.
const ROUNDS: usize = 4;
/// A penalty is as good as the best within this factor of its error.
const NEARLY: f64 = 1.01;

/// A candidate that was scored.
#[derive(Clone, Debug)]
pub struct Found {
    /// Its settings.
    pub recipe: Recipe,
    /// Its ridge penalty.
    pub penalty: f64,
    /// Mean RMSE over the units of the inner folds, beside the nuisances, in the output's unit.
    pub score: f64,
    /// What was projected out.
    pub nuisances: Arc<Nuisances>,
}

/// The result of one rung.
#[derive(Clone, Debug)]
pub struct RungResult {
    /// Its name.
    pub name: &'static str,
    /// What it is, in words.
    pub what: &'static str,
    /// Whether its weights are bound in sign.
    pub bound: bool,
    /// What all data chose.
    pub found: Found,
    /// The model fitted to all data.
    pub model: LinearModel,
    /// Error on each unit by a model and settings that it took no part in.
    pub errors: Vec<f64>,
    /// Dead time and lag in s that each outer fold found for itself, and last those of all data.
    pub paths: Vec<(f64, f64)>,
    /// Those models' predictions, free running, one list a recording; samples that count in no unit are not a number.
    pub predictions: Vec<Vec<f64>>,
}

/// Data, partition, and the moments made so far.
pub struct Search<'a> {
    series: &'a [Series],
    partition: &'a Partition,
    around: Surroundings,
    origin: f64,
    stride: usize,
    known: Mutex<HashMap<Recipe, Arc<Vec<Moments>>>>,
    candidates: Candidates,
    /// What was decided on, by the units that decided.
    decided: Mutex<HashMap<Vec<usize>, Arc<Nuisances>>>,
}

impl<'a> Search<'a> {
    /// Prepares the search; `seed` is that of random features.
    #[must_use]
    pub fn new(series: &'a [Series], partition: &'a Partition, sample_period_s: f64, seed: u64) -> Self {
        let samples: usize = series.iter().map(Series::len).sum();
        let origin = series.iter().flat_map(|one| &one.output).sum::<f64>() / samples.max(1) as f64;
        let around = Surroundings::of(series, sample_period_s, seed);
        let beside = Recipe { polynomial: 3, plays: 8, spectrum: Spectrum::Input, ..Recipe::line() }.structure(&around);
        let columns = |one: &Series, rows: &[usize]| {
            let mut columns = Vec::new();
            let inputs: Vec<&[f64]> = one.inputs.iter().map(Vec::as_slice).collect();
            beside.for_each_column(&inputs, &one.gaps, |_, values| columns.push(rows.iter().map(|&row| values[row]).collect()));
            columns
        };
        Self {
            series,
            partition,
            candidates: Candidates::of(series, columns),
            around,
            origin,
            stride: samples.div_ceil(ROWS).max(1),
            known: Mutex::new(HashMap::new()),
            decided: Mutex::new(HashMap::new()),
        }
    }

    /// Adds slow signals that the zero may answer to; those that never move are left out.
    #[must_use]
    pub fn with_covariates(mut self, covariates: Vec<Covariate>) -> Self {
        self.candidates = self.candidates.with(covariates, self.series.len());
        self
    }

    /// The covariates that take part, each with the value where models stand and the half range that its coefficient is for.
    pub fn covariates(&self) -> impl Iterator<Item = (&Covariate, f64, f64)> {
        let candidates = &self.candidates;
        candidates.covariates.iter().zip(&candidates.centres).zip(&candidates.halves).map(|((one, &centre), &half)| (one, centre, half))
    }

    /// First sample behind the step of a recording, where one is named.
    #[must_use]
    pub fn step(&self, nuisances: &Nuisances, series: usize) -> Option<usize> {
        self.candidates.steps[series].filter(|_| nuisances.steps[series])
    }

    /// The output of a recording that took part in a decision, its nuisances taken off.
    #[must_use]
    pub fn cleaned(&self, nuisances: &Nuisances, series: usize) -> Vec<f64> {
        nuisances.cleaned(&self.candidates, series, &self.series[series].output)
    }

    /// What the covariates that are named move each sample of a recording by.
    #[must_use]
    pub fn moved(&self, nuisances: &Nuisances, series: usize) -> Vec<f64> {
        (0..self.series[series].len()).map(|index| nuisances.moved(&self.candidates, series, index)).collect()
    }

    /// Root mean square errors of predictions on each unit, its nuisances taken off as far as all data name them: how well a shape is
    /// known, and what rungs are compared by.
    #[must_use]
    pub fn shape_errors(&self, predictions: &[Vec<f64>]) -> Vec<f64> {
        let residuals = |unit: &crate::Unit| self.shape_residuals(unit, &predictions[unit.series]);
        self.partition.units().iter().map(|unit| root_mean_square(&residuals(unit))).collect()
    }

    /// What the predictions of a recording leave of one of its units, the nuisances taken off that all data name.
    #[must_use]
    pub fn shape_residuals(&self, unit: &crate::Unit, predictions: &[f64]) -> Vec<f64> {
        let nuisances = self.nuisances(&self.partition.training());
        nuisance::shape_residuals(&nuisances, &self.candidates, predictions, &self.series[unit.series], unit)
    }

    /// What the data of a training set name; decided once.
    #[must_use]
    pub fn nuisances(&self, training: &Training) -> Arc<Nuisances> {
        let key = training.all.units().to_vec();
        // Note(unwrap): no thread panics while it holds the lock.
        if let Some(found) = self.decided.lock().expect("the lock is whole").get(&key) {
            return Arc::clone(found);
        }
        let found = Arc::new(self.decide(training).unwrap_or_else(|| Nuisances::none(&self.candidates)));
        self.decided.lock().expect("the lock is whole").insert(key, Arc::clone(&found));
        found
    }

    /// Decides by references that took no part; `None` when none can be fitted.
    fn decide(&self, training: &Training) -> Option<Nuisances> {
        let all = Arc::new(Nuisances::all(&self.candidates));
        let climbed = rungs::references().into_iter().filter_map(|rung| {
            let start = Recipe { own_zeros: true, ..(rung.enter)(Recipe::line(), &self.around) };
            self.climb(&rung, start, training, &all)
        });
        let reference = climbed.min_by(|one, other| one.score.total_cmp(&other.score))?;
        let outputs = training.all.units().iter().map(|&unit| &self.partition.units()[unit]);
        let (low, high) = outputs
            .flat_map(|unit| &self.series[unit.series].output[unit.samples.clone()])
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)));
        let mut left = Vec::new();
        for (fit, select) in &training.inner {
            self.add_left(&mut left, &reference, fit, select.units())?;
        }
        let mut found = nuisance::decide_on_steps(&self.candidates, &left, high - low);
        if self.partition.kind() != SplitKind::Blocks {
            let recipe = Recipe { own_zeros: false, ..reference.recipe.clone() };
            let as_is = |found: &Nuisances, left: &mut Vec<Left>| -> Option<()> {
                let plain = Found { recipe: recipe.clone(), nuisances: Arc::new(found.clone()), ..reference.clone() };
                let mut made = Vec::new();
                for (fit, select) in &training.inner {
                    self.add_left(&mut made, &plain, fit, select.units())?;
                }
                left.iter_mut().zip(made).for_each(|(one, other)| one.as_is = other.left);
                Some(())
            };
            as_is(&found, &mut left)?;
            while nuisance::name_covariate(&self.candidates, &left, &mut found) {
                // Weights and coefficients in turn, until they agree.
                for _ in 0..ROUNDS {
                    as_is(&found, &mut left)?;
                    nuisance::estimate_covariates(&self.candidates, &left, false, &mut found);
                }
            }
            let plain = Found { recipe, nuisances: Arc::new(found.clone()), ..reference.clone() };
            let mut inside = Vec::new();
            self.add_left(&mut inside, &plain, &training.all, training.all.units())?;
            inside.iter_mut().for_each(|one| one.as_is.clone_from(&one.left));
            nuisance::decide_on_zeros(&self.candidates, &left, &inside, &mut found);
        }
        if !found.is_empty() {
            let mut inside = Vec::new();
            self.add_left(&mut inside, &reference, &training.all, training.all.units())?;
            nuisance::estimate(&self.candidates, &inside, &mut found);
        }
        Some(found)
    }

    /// What a candidate with weights from `fit` leaves of some units, put together by recording.
    fn add_left(&self, left: &mut Vec<Left>, found: &Found, fit: &Fit, units: &[usize]) -> Option<()> {
        let (model, ..) = self.fit(found, fit)?;
        for &unit in units {
            let unit = &self.partition.units()[unit];
            let one = &self.series[unit.series];
            let inputs: Vec<&[f64]> = one.inputs.iter().map(Vec::as_slice).collect();
            let simulated = model.simulate(&inputs, &one.gaps);
            let place = left.iter().position(|other| other.series == unit.series).unwrap_or_else(|| {
                left.push(Left { series: unit.series, samples: Vec::new(), left: Vec::new(), as_is: Vec::new() });
                left.len() - 1
            });
            left[place].samples.extend(unit.samples.clone());
            left[place].left.extend(unit.samples.clone().map(|sample| one.output[sample] - simulated[sample]));
        }
        Some(())
    }

    /// Moments of a recipe's columns, beside the covariates.
    fn moments_beside(&self, recipe: &Recipe, nuisances: &Nuisances) -> Arc<Vec<Moments>> {
        let moments = self.moments(recipe);
        match nuisances.covariates.iter().any(Option::is_some) {
            true => Arc::new(moments.iter().map(|one| one.less(&nuisances.covariates)).collect()),
            false => moments,
        }
    }

    /// The moments of a recipe's columns, one set a unit.
    fn moments(&self, recipe: &Recipe) -> Arc<Vec<Moments>> {
        // What does not change the columns.
        let key = Recipe { own_zeros: false, bound: crate::recipe::Bound::Free, falling: 0, ..recipe.clone() };
        // Note(unwrap): no thread panics while it holds the lock.
        if let Some(found) = self.known.lock().expect("the lock is whole").get(&key) {
            return Arc::clone(found);
        }
        let made = Arc::new(moments::moments(
            &key.structure(&self.around),
            self.series,
            self.partition.units(),
            self.stride,
            self.origin,
            &self.candidates,
        ));
        let mut known = self.known.lock().expect("the lock is whole");
        let numbers: usize = made.iter().map(|one| one.gram.len()).sum();
        // Rungs with many columns on many recordings would fill any memory; what is forgotten is made again.
        if known.values().map(|kept| kept.iter().map(|one| one.gram.len()).sum::<usize>()).sum::<usize>() + numbers > KEPT {
            known.clear();
        }
        known.insert(key, Arc::clone(&made));
        made
    }

    /// Scores a recipe on inner folds: the best penalty and its mean error.
    fn score(&self, recipe: &Recipe, training: &Training, nuisances: &Arc<Nuisances>) -> Option<Found> {
        let moments = self.moments_beside(recipe, nuisances);
        let structure = recipe.structure(&self.around);
        let signs = recipe.signs(&structure);
        let penalties = if signs == Signs::Free { &PENALTIES[..] } else { &BOUND_PENALTIES[..] };
        let mut sums = vec![0.0; penalties.len()];
        let mut units = 0.0;
        for (fit, select) in &training.inner {
            let normal = Normal::new(&moments, fit, &self.zeros_of(recipe, nuisances));
            for (sum, &penalty) in sums.iter_mut().zip(penalties) {
                match normal.solve(&moments, fit, penalty, &signs) {
                    Some(weights) => {
                        // A recording whose zero is a nuisance is judged by its shape.
                        let constant = (!nuisances.zeros).then_some(weights.constant);
                        let step = |unit: usize| nuisances.steps[self.partition.units()[unit].series];
                        let error = |&unit: &usize| moments[unit].rmse_beside_nuisances(constant, step(unit), &weights.columns);
                        *sum += select.units().iter().map(error).sum::<f64>();
                    }
                    None => *sum = f64::INFINITY,
                }
            }
            units += select.units().len() as f64;
        }
        let best = sums.iter().copied().fold(f64::INFINITY, f64::min);
        // The largest penalty that costs next to nothing: what the data do not ask for is not there.
        let (sum, penalty) = sums.into_iter().zip(penalties).rfind(|(sum, _)| *sum <= best * NEARLY)?;
        sum.is_finite().then(|| Found { recipe: recipe.clone(), penalty: *penalty, score: sum / units, nuisances: Arc::clone(nuisances) })
    }

    /// Which parts of units share a constant: all, those of one recording, or those of one recording on one side of its step.
    fn zeros_of(&self, recipe: &Recipe, nuisances: &Nuisances) -> Vec<[usize; 2]> {
        let of = |unit: &crate::Unit| {
            let before = if recipe.own_zeros { 1 + 2 * unit.series } else { 0 };
            [before, if nuisances.steps[unit.series] { 2 + 2 * unit.series } else { before }]
        };
        self.partition.units().iter().map(of).collect()
    }

    /// Searches one rung from a start.
    fn climb(&self, rung: &Rung, start: Recipe, training: &Training, nuisances: &Arc<Nuisances>) -> Option<Found> {
        // Zeros that are there are no setting.
        let with_zeros = |recipe: Recipe| Recipe { own_zeros: recipe.own_zeros || nuisances.zeros, ..recipe };
        let mut best = self.score(&with_zeros(start), training, nuisances)?;
        for _ in 0..rung.rounds {
            let before = best.score;
            for setting in rung.settings {
                for candidate in setting(&best.recipe, &self.around).into_iter().map(with_zeros) {
                    if candidate == best.recipe {
                        continue;
                    }
                    if let Some(trial) = self.score(&candidate, training, nuisances)
                        && trial.score < best.score
                    {
                        best = trial;
                    }
                }
            }
            if best.score >= before * (1.0 - 1e-3) {
                break;
            }
        }
        Some(best)
    }

    /// Searches all rungs on one training set; the results are in the order of `rungs`.
    #[must_use]
    pub fn ladder(&self, rungs: &[Rung], training: &Training) -> Vec<Option<Found>> {
        let nuisances = self.nuisances(training);
        let mut found: Vec<Option<Found>> = Vec::new();
        for rung in rungs {
            let earlier = rung.from.iter().filter_map(|name| {
                let index = rungs.iter().position(|other| other.name == *name)?;
                found.get(index)?.as_ref()
            });
            let start = earlier.min_by(|a, b| a.score.total_cmp(&b.score)).map_or_else(Recipe::line, |found| found.recipe.clone());
            found.push(self.climb(rung, (rung.enter)(start, &self.around), training, &nuisances));
        }
        found
    }

    /// Weights and model of a candidate.
    fn fit(&self, found: &Found, fit: &Fit) -> Option<(LinearModel, Weights, Arc<Vec<Moments>>)> {
        let moments = self.moments_beside(&found.recipe, &found.nuisances);
        let structure = found.recipe.structure(&self.around);
        let signs = found.recipe.signs(&structure);
        let weights =
            Normal::new(&moments, fit, &self.zeros_of(&found.recipe, &found.nuisances)).solve(&moments, fit, found.penalty, &signs)?;
        let range = fit
            .units()
            .iter()
            .map(|&unit| moments[unit].range)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |sum, one| (sum.0.min(one.0 + self.origin), sum.1.max(one.1 + self.origin)));
        Some((LinearModel::new(structure, &weights, self.origin, range, signs != Signs::Free), weights, moments))
    }

    /// The model of a candidate; `None` when the data do not determine it.
    #[must_use]
    pub fn model(&self, found: &Found, fit: &Fit) -> Option<LinearModel> {
        self.fit(found, fit).map(|(model, ..)| model)
    }

    /// All rungs, chosen and fitted on all data, with the errors that nested cross-validation gives them. Outer folds share `threads`
    /// threads; the results do not depend on their number. `done` is called after each outer fold.
    pub fn nested(&self, rungs: &[Rung], threads: usize, done: &(dyn Fn(usize, usize) + Sync)) -> Vec<RungResult> {
        let outer = self.partition.outer();
        // The last job is all data.
        let jobs = outer.len() + 1;
        let next = AtomicUsize::new(0);
        let finished = AtomicUsize::new(0);
        let results: Mutex<Vec<Option<Vec<Option<Found>>>>> = Mutex::new(vec![None; jobs]);
        let work = || {
            loop {
                let job = next.fetch_add(1, Ordering::Relaxed);
                if job >= jobs {
                    break;
                }
                let training = outer.get(job).map_or_else(|| self.partition.training(), |outer| outer.training.clone());
                let found = self.ladder(rungs, &training);
                results.lock().expect("the lock is whole")[job] = Some(found);
                done(finished.fetch_add(1, Ordering::Relaxed) + 1, jobs);
            }
        };
        std::thread::scope(|scope| {
            for _ in 1..threads.min(jobs) {
                scope.spawn(work);
            }
            work();
        });
        let results: Vec<Vec<Option<Found>>> = results.into_inner().expect("the lock is whole").into_iter().flatten().collect();
        rungs.iter().enumerate().filter_map(|(index, rung)| self.result(index, rung, &outer, &results)).collect()
    }

    fn result(&self, index: usize, rung: &Rung, outer: &[crate::split::Outer], results: &[Vec<Option<Found>>]) -> Option<RungResult> {
        let mut predictions: Vec<Vec<f64>> = self.series.iter().map(|one| vec![f64::NAN; one.len()]).collect();
        let mut paths = Vec::new();
        for (fold, found) in outer.iter().zip(results) {
            let (model, ..) = self.fit(found[index].as_ref()?, &fold.training.all)?;
            for &unit in fold.test.units() {
                let unit = &self.partition.units()[unit];
                let one = &self.series[unit.series];
                let inputs: Vec<&[f64]> = one.inputs.iter().map(Vec::as_slice).collect();
                let simulated = model.simulate(&inputs, &one.gaps);
                predictions[unit.series][unit.samples.clone()].copy_from_slice(&simulated[unit.samples.clone()]);
            }
            paths.push((model.structure.dead_time_s, model.structure.lag_s));
        }
        let errors = errors(&predictions, self.series, self.partition);
        let found = results.last()?[index].clone()?;
        let (model, ..) = self.fit(&found, &self.partition.training().all)?;
        paths.push((model.structure.dead_time_s, model.structure.lag_s));
        Some(RungResult { name: rung.name, what: rung.what, bound: rung.bound, found, model: model.pruned(), errors, predictions, paths })
    }
}

/// Root mean square error of predictions on each unit.
#[must_use]
pub fn errors(predictions: &[Vec<f64>], series: &[Series], partition: &Partition) -> Vec<f64> {
    let residuals = |unit: &crate::Unit| -> Vec<f64> {
        let pairs = predictions[unit.series][unit.samples.clone()].iter().zip(&series[unit.series].output[unit.samples.clone()]);
        pairs.map(|(predicted, measured)| measured - predicted).collect()
    };
    partition.units().iter().map(|unit| root_mean_square(&residuals(unit))).collect()
}

pub(crate) fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64).sqrt()
}
