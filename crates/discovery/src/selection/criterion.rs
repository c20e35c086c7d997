//! The criterion by which explanations are compared: the log predictive density of recordings that took no part in the fit.
//!
//! Every explanation is fitted to some recordings and predicts the others, sample by sample, under one noise model: white noise, a slowly
//! varying model error (an Ornstein-Uhlenbeck process) and a share of samples from anywhere in the range. Its three numbers are those of the
//! greatest likelihood on the recordings of the fit. What sticks and slips is predicted by its switching filter under the same noise.
//!
//! Explanations are compared recording by recording. The *confidence set* holds those that no other is significantly better than (Hansen,
//! Lunde and Nason 2011): the one furthest below the mean leaves as long as a bootstrap over recordings gives a mean that far above it
//! a probability below [`LEVEL`].

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::chain::form::Form;
use crate::data::noise;
use crate::data::session::{Role, Run, Session};
use crate::model::structure::{Model, Scope};
use crate::observers::jumps;
use crate::observers::law::JumpLaw;
use crate::search::forms::polish;
use crate::search::parallel::in_parallel;
use crate::selection::jump_evidence::Pull;
use crate::selection::jump_naming::without_jumps;

/// Probability by which an explanation leaves the confidence set that is as good as the best.
pub const LEVEL: f64 = 0.1;
/// Samples of the bootstrap.
const RESAMPLES: usize = 2000;
/// Fewest recordings of which whole halves are left out; of fewer each is left out in turn.
const FEWEST_FOR_HALVES: usize = 6;
/// Evaluations for each parameter when a model is fitted to the recordings of a fold.
const EVALUATIONS: usize = 8;
/// White noise that is tried, in units of the noise at rest.
const NOISES: [f64; 7] = [1.0, 1.25, 1.6, 2.2, 3.5, 7.0, 20.0];

/// An explanation and how well it predicts.
#[derive(Clone, Debug)]
pub struct Scored {
    /// Names of its effects, in alphabetical order.
    pub names: Vec<&'static str>,
    /// Mean log predictive density of each recording, nats per sample.
    pub densities: Vec<f64>,
    /// Probability of a distance from the other members like its own, were all as good.
    pub p_value: f64,
}

impl Scored {
    /// Mean over the recordings.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.densities.iter().sum::<f64>() / self.densities.len().max(1) as f64
    }
}

/// Names of a model's effects, each once, in alphabetical order.
fn names(model: &Model) -> Vec<&'static str> {
    let mut names: Vec<&'static str> = model.names().collect();
    names.sort_unstable();
    names.dedup();
    names
}

/// The session once for each fold: what is predicted has the role to select.
fn folds(session: &Session) -> Vec<Session> {
    let mut sources: Vec<usize> = session.runs.iter().filter(|run| run.is_worked_with()).map(|run| run.source.0).collect();
    sources.sort_unstable();
    sources.dedup();
    if sources.len() == 1 || sources.len() >= FEWEST_FOR_HALVES {
        let mut swapped = session.clone();
        for role in swapped.runs.iter_mut().flat_map(|run| &mut run.role) {
            *role = match *role {
                Role::Fit => Role::Select,
                Role::Select => Role::Fit,
                other => other,
            };
        }
        swapped.screen_some();
        return vec![session.clone(), swapped];
    }
    let leaving = |left_out: &usize| {
        let mut fold = session.clone();
        for run in &mut fold.runs {
            let role = if run.source.0 == *left_out { Role::Select } else { Role::Fit };
            run.role.iter_mut().filter(|role| role.is_worked_with()).for_each(|of| *of = role);
            run.screens = true;
        }
        fold
    };
    sources.iter().map(leaving).collect()
}

/// Which recording a sample belongs to, or which stretch of the only one.
fn cluster(run: &Run, alone: bool, sample: usize) -> (usize, usize) {
    if alone { (run.source.0, run.part * 100 + sample * 12 / run.input.len()) } else { (run.source.0, 0) }
}

/// Scores one explanation: mean log density of each recording that it predicts, in the order of the recordings.
fn score(model: &Model, folds: &[Session], floor: f64) -> Scored {
    let alone = folds.len() == 2 && {
        let first = folds[0].runs.iter().find(|run| run.is_worked_with()).map(|run| run.source.0);
        folds[0].runs.iter().filter(|run| run.is_worked_with()).all(|run| Some(run.source.0) == first)
    };
    let mut sums: std::collections::BTreeMap<(usize, usize), (f64, f64)> = std::collections::BTreeMap::new();
    for session in folds {
        let mut fitted = polish(model, session, Scope::Fit, EVALUATIONS).model;
        fitted = fitted.regrown();
        fitted.fit(session, Scope::Fit);
        let densities = densities(&fitted, session, floor);
        for (run, densities) in session.runs.iter().zip(densities) {
            for (sample, density) in densities.iter().enumerate() {
                if run.role[sample] == Role::Select && run.keep[sample] {
                    let sum = sums.entry(cluster(run, alone, sample)).or_insert((0.0, 0.0));
                    sum.0 += density;
                    sum.1 += 1.0;
                }
            }
        }
    }
    Scored { names: names(model), densities: sums.into_values().map(|(sum, count)| sum / count).collect(), p_value: 1.0 }
}

/// Log predictive density of every sample of every recording, by a fitted model.
fn densities(model: &Model, session: &Session, floor: f64) -> Vec<Vec<f64>> {
    let jumping: Option<&'static dyn Form> = model.slots.iter().map(|slot| slot.form).find(|form| form.jumps().is_some());
    if let (Some(form), Some(slot)) = (jumping, model.slots.iter().find(|slot| slot.form.jumps().is_some()))
        && let Some(drive) = form.jumps()
    {
        let (law, own) = JumpLaw::of_parameters(drive, &slot.parameters);
        let pull = without_jumps(model);
        let best = NOISES.map(|times| {
            let pull = Pull::new(session, &pull, own * times, form.feels_sensor());
            (pull.fitting(&law), times)
        });
        let times = best.into_iter().max_by(|x, y| x.0.total_cmp(&y.0)).map_or(1.0, |best| best.1);
        return Pull::new(session, &pull, own * times, form.feels_sensor()).of_every_recording(|seen| jumps::observe(seen, &law).evidence);
    }
    let best = NOISES.map(|times| (Pull::new(session, model, floor * times, false).smoothest(), times));
    let best = best.into_iter().max_by(|x, y| x.0.0.total_cmp(&y.0.0));
    let Some(((_, amplitude, time_s), times)) = best else { return Vec::new() };
    Pull::new(session, model, floor * times, false).of_every_recording(|seen| jumps::smooth(seen, amplitude, time_s))
}

/// Scores explanations; the first is the baseline.
#[must_use]
pub fn compare(session: &Session, models: &[Model], threads: usize) -> Vec<Scored> {
    let folds = folds(session);
    let floor = models.iter().map(|model| noise::floor(session, &model.residuals(session))).fold(f64::MAX, f64::min);
    in_parallel(models, threads, |model| score(model, &folds, floor))
}

/// The confidence set at [`LEVEL`], best first, each member with its probability.
#[must_use]
pub fn confidence_set(mut scored: Vec<Scored>, seed: u64) -> Vec<Scored> {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let recordings = scored.first().map_or(0, |one| one.densities.len());
    if recordings < 2 {
        return scored;
    }
    let draws: Vec<Vec<usize>> =
        (0..RESAMPLES).map(|_| (0..recordings).map(|_| generator.random_range(0..recordings)).collect()).collect();
    let mut least_sure: f64 = 0.0;
    let mut gone = Vec::new();
    while scored.len() > 1 {
        let count = scored.len() as f64;
        let mean: Vec<f64> =
            (0..recordings).map(|at| scored.iter().map(|one| one.densities[at]).sum::<f64>() / count).collect();
        // How far each lies below the mean of all, by recording.
        let below: Vec<Vec<f64>> =
            scored.iter().map(|one| mean.iter().zip(&one.densities).map(|(mean, own)| mean - own).collect()).collect();
        let average = |values: &[f64]| values.iter().sum::<f64>() / recordings as f64;
        let averages: Vec<f64> = below.iter().map(|values| average(values)).collect();
        let drawn: Vec<Vec<f64>> = below
            .iter()
            .zip(&averages)
            .map(|(values, centre)| {
                draws.iter().map(|draw| draw.iter().map(|&at| values[at]).sum::<f64>() / recordings as f64 - centre).collect()
            })
            .collect();
        let scatter: Vec<f64> =
            drawn.iter().map(|of| (of.iter().map(|value| value * value).sum::<f64>() / RESAMPLES as f64).sqrt().max(1e-12)).collect();
        let (worst, most) = (0..scored.len())
            .map(|at| (at, averages[at] / scatter[at]))
            .max_by(|x, y| x.1.total_cmp(&y.1))
            .unwrap_or((0, 0.0));
        let beyond = (0..RESAMPLES).filter(|&draw| (0..scored.len()).any(|at| drawn[at][draw] / scatter[at] >= most)).count();
        let p_value = beyond as f64 / RESAMPLES as f64;
        least_sure = least_sure.max(p_value);
        if least_sure >= LEVEL {
            for one in &mut scored {
                one.p_value = one.p_value.min(1.0);
            }
            scored[worst].p_value = least_sure;
            break;
        }
        gone.push(scored.remove(worst));
    }
    scored.sort_by(|x, y| y.mean().total_cmp(&x.mean()));
    scored
}

/// The members of a confidence set without those that have all effects of another member and more.
#[must_use]
pub fn simplest(set: &[Scored]) -> Vec<Scored> {
    let more = |one: &Scored, other: &Scored| one.names.len() > other.names.len() && other.names.iter().all(|name| one.names.contains(name));
    let mut simplest: Vec<Scored> = Vec::new();
    for one in set.iter().filter(|one| !set.iter().any(|other| more(one, other))) {
        if simplest.iter().all(|other| other.names != one.names) {
            simplest.push(one.clone());
        }
    }
    simplest
}
