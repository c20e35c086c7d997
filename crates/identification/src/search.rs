//! The search for recipes, and the nested cross-validation of all rungs.
//!
//! On one training set the rungs are searched in order, each from what earlier ones found, setting by setting; a candidate's score is
//! its error on the inner folds that took no part in its weights. Moments of candidates are remembered: the outer folds meet many of
//! them again, and only add and subtract.

use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use crate::recipe::{Recipe, Surroundings};
use crate::regression::BOUND_PENALTIES;
use crate::regression::Normal;
use crate::split::Training;
use crate::{Fit, LinearModel, Moments, PENALTIES, Partition, Rung, Series, Signs, Weights, moments};

/// Rows that the second moments are made from at most; longer data are thinned evenly, behind memory that moves with all samples.
const ROWS: usize = 40_000;

/// Numbers of moments kept at most: half a gigabyte.
const KEPT: usize = 64 << 20;
/// A penalty is as good as the best within this factor of its error.
const NEARLY: f64 = 1.01;

/// A candidate that was scored.
#[derive(Clone, Debug)]
pub struct Found {
    /// Its settings.
    pub recipe: Recipe,
    /// Its ridge penalty.
    pub penalty: f64,
    /// Mean RMSE over the units of the inner folds, in the output's unit.
    pub score: f64,
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
    /// Constant of each unit under that model, in the output's unit.
    pub zeros: Vec<f64>,
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
}

impl<'a> Search<'a> {
    /// Prepares the search; `seed` is that of random features.
    #[must_use]
    pub fn new(series: &'a [Series], partition: &'a Partition, sample_period_s: f64, seed: u64) -> Self {
        let samples: usize = series.iter().map(Series::len).sum();
        let origin = series.iter().flat_map(|one| &one.output).sum::<f64>() / samples.max(1) as f64;
        Self {
            series,
            partition,
            around: Surroundings::of(series, sample_period_s, seed),
            origin,
            stride: samples.div_ceil(ROWS).max(1),
            known: Mutex::new(HashMap::new()),
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
        let made = Arc::new(moments::moments(&key.structure(&self.around), self.series, self.partition.units(), self.stride, self.origin));
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
    fn score(&self, recipe: &Recipe, training: &Training) -> Option<Found> {
        let moments = self.moments(recipe);
        let structure = recipe.structure(&self.around);
        let signs = recipe.signs(&structure);
        let penalties = if signs == Signs::Free { &PENALTIES[..] } else { &BOUND_PENALTIES[..] };
        let mut sums = vec![0.0; penalties.len()];
        let mut units = 0.0;
        for (fit, select) in &training.inner {
            let normal = Normal::new(&moments, fit, &self.zeros_of(recipe));
            for (sum, &penalty) in sums.iter_mut().zip(penalties) {
                match normal.solve(&moments, fit, penalty, &signs) {
                    Some(weights) => {
                        let error = |&unit: &usize| moments[unit].rmse(weights.constant, &weights.columns);
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
        sum.is_finite().then(|| Found { recipe: recipe.clone(), penalty: *penalty, score: sum / units })
    }

    /// Which units share a constant: all, or those of one recording.
    fn zeros_of(&self, recipe: &Recipe) -> Vec<usize> {
        self.partition.units().iter().map(|unit| if recipe.own_zeros { unit.series } else { 0 }).collect()
    }

    /// Searches one rung from a start.
    fn climb(&self, rung: &Rung, start: Recipe, training: &Training) -> Option<Found> {
        let mut best = self.score(&start, training)?;
        for _ in 0..rung.rounds {
            let before = best.score;
            for setting in rung.settings {
                for candidate in setting(&best.recipe, &self.around) {
                    if candidate == best.recipe {
                        continue;
                    }
                    if let Some(trial) = self.score(&candidate, training)
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
        let mut found: Vec<Option<Found>> = Vec::new();
        for rung in rungs {
            let earlier = rung.from.iter().filter_map(|name| {
                let index = rungs.iter().position(|other| other.name == *name)?;
                found.get(index)?.as_ref()
            });
            let start = earlier.min_by(|a, b| a.score.total_cmp(&b.score)).map_or_else(Recipe::line, |found| found.recipe.clone());
            found.push(self.climb(rung, (rung.enter)(start, &self.around), training));
        }
        found
    }

    /// Weights and model of a candidate.
    fn fit(&self, found: &Found, fit: &Fit) -> Option<(LinearModel, Weights, Arc<Vec<Moments>>)> {
        let moments = self.moments(&found.recipe);
        let structure = found.recipe.structure(&self.around);
        let signs = found.recipe.signs(&structure);
        let weights = Normal::new(&moments, fit, &self.zeros_of(&found.recipe)).solve(&moments, fit, found.penalty, &signs)?;
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
        let (model, weights, moments) = self.fit(&found, &self.partition.training().all)?;
        paths.push((model.structure.dead_time_s, model.structure.lag_s));
        let zeros = moments.iter().map(|one| one.rmse_with_own_zero(&weights.columns).1 + self.origin).collect();
        Some(RungResult {
            name: rung.name,
            what: rung.what,
            bound: rung.bound,
            found,
            model: model.pruned(),
            zeros,
            errors,
            predictions,
            paths,
        })
    }
}

/// Root mean square error of predictions on each unit.
#[must_use]
pub fn errors(predictions: &[Vec<f64>], series: &[Series], partition: &Partition) -> Vec<f64> {
    let error = |unit: &crate::Unit| {
        let pairs = predictions[unit.series][unit.samples.clone()].iter().zip(&series[unit.series].output[unit.samples.clone()]);
        let squares: f64 = pairs.map(|(predicted, measured)| (predicted - measured).powi(2)).sum();
        (squares / unit.samples.len().max(1) as f64).sqrt()
    };
    partition.units().iter().map(error).collect()
}
