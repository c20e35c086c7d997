//! The criterion by which explanations are compared: the log predictive density of recordings that took no part in the fit.
//!
//! Every explanation is fitted to some recordings and predicts the others, sample by sample, under one noise model: white noise, a slowly
//! varying model error (an Ornstein-Uhlenbeck process) and a share of samples from anywhere in the range. Its three numbers are those of the
//! greatest likelihood on the recordings of the fit. What sticks and slips is predicted by its switching filter under the same noise.
//!
//! Explanations are compared recording by recording. The *confidence set* holds those that no other is significantly better than (Hansen,
//! Lunde and Nason 2011): the one furthest below the mean leaves as long as a bootstrap over recordings gives a mean that far above it
//! a probability below [`LEVEL`].

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::data::noise;
use crate::data::session::{Role, Run, Session};
use crate::model::structure::{Model, Scope};
use crate::observers::jumps;
use crate::observers::law::{Seen, SlipLaw};
use crate::search::forms::polish;
use crate::search::parallel::in_parallel;
use crate::selection::switching_likelihood::QuasiStatic;
use crate::selection::switching_selection::without_jumps;

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
    let mut sources: Vec<usize> = session.worked().map(|run| run.source.0).collect();
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

/// Scores one explanation: mean log density of each recording that it predicts, in the order of the recordings. What comes before `start_up_s` does
/// not count.
fn score(model: &Model, folds: &[Session], floor: f64, start_up_s: f64) -> Scored {
    let alone = is_alone(&folds[0]);
    let mut sums: BTreeMap<(usize, usize), (f64, f64)> = BTreeMap::new();
    for session in folds {
        let mut fitted = polish(model, session, Scope::Fit, EVALUATIONS).model.regrown();
        fitted.fit(session, Scope::Fit);
        let densities = densities(&fitted, session, floor, start_up_s);
        for (run, densities) in session.runs.iter().zip(densities) {
            for (sample, density) in densities.iter().enumerate().filter(|(sample, _)| run.time_s[*sample] >= start_up_s) {
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

/// Whether there is but one recording to work with.
fn is_alone(session: &Session) -> bool {
    let first = session.worked().next().map(|run| run.source.0);
    session.worked().all(|run| Some(run.source.0) == first)
}

/// Log predictive density of every sample of every recording, by a fitted model.
fn densities(model: &Model, session: &Session, floor: f64, start_up_s: f64) -> Vec<Vec<f64>> {
    if let Some(slot) = model.slots.iter().find(|slot| slot.form.jumps().is_some())
        && let Some(drive) = slot.form.jumps()
    {
        let (law, own) = SlipLaw::of_parameters(drive, &slot.parameters);
        let smooth = without_jumps(model);
        let quasi_static = |times: f64| QuasiStatic::new(session, &smooth, own * times, slot.form.feels_sensor());
        let times = most(NOISES, |&times| quasi_static(times).fitting(&law));
        return quasi_static(times).of_every_recording(|seen| jumps::observe(seen, &law).log_likelihood);
    }
    let simulated = simulate(model, session, start_up_s);
    let smooth = |run: &Run, noise: f64, amplitude: f64, time_s: f64| {
        let (none, quasi_static) = (&[][..], &simulated[run.index][..]);
        let seen = Seen {
            command: none,
            followed: none,
            quasi_static,
            measured: &run.output,
            keep: &run.keep,
            period_s: run.period_s,
            noise,
            bank: None,
        };
        jumps::smooth(&seen, amplitude, time_s)
    };
    let (mut sum, mut count) = (0.0, 1.0);
    let fitted = |run: &Run, sample: usize| run.role[sample] == Role::Fit && run.keep[sample];
    for run in session.worked() {
        for sample in (0..run.output.len()).filter(|&sample| fitted(run, sample)) {
            sum += (run.output[sample] - simulated[run.index][sample]).powi(2);
            count += 1.0;
        }
    }
    let excess = (sum / count - floor * floor).max(0.04 * floor * floor).sqrt();
    let likelihood = |&(times, share, time_s): &(f64, f64, f64)| -> f64 {
        let screens = session.runs.iter().filter(|run| run.screens && run.role.contains(&Role::Fit));
        let of = |run: &Run| {
            let densities = smooth(run, times * floor, share * excess, time_s);
            densities.iter().enumerate().filter(|(sample, _)| fitted(run, *sample)).map(|(_, density)| density).sum::<f64>()
        };
        screens.map(of).sum()
    };
    let grid = NOISES.into_iter().flat_map(|times| {
        [0.4, 0.7, 1.0, 1.4].into_iter().flat_map(move |share| [0.04, 0.1, 0.25, 0.6, 2.0, 10.0].map(|time_s| (times, share, time_s)))
    });
    let (times, share, time_s) = most(grid, likelihood);
    session.runs.iter().map(|run| smooth(run, times * floor, share * excess, time_s)).collect()
}

/// What a model simulates of every recording, of which it sees the measured output of the start-up only.
fn simulate(model: &Model, session: &Session, start_up_s: f64) -> Vec<Vec<f64>> {
    if !model.slots.iter().any(|slot| slot.form.reads_output()) {
        return model.outputs(session, |_| true);
    }
    let mut shown = session.clone();
    for run in &mut shown.runs {
        let time_s = &run.time_s;
        run.keep.iter_mut().zip(time_s).for_each(|(keep, time_s)| *keep &= *time_s < start_up_s);
    }
    model.outputs(&shown, |_| true)
}

/// The item that `value` is greatest for.
fn most<T>(items: impl IntoIterator<Item = T>, value: impl Fn(&T) -> f64) -> T {
    let mut valued: Vec<(f64, T)> = items.into_iter().map(|item| (value(&item), item)).collect();
    valued.sort_by(|x, y| y.0.total_cmp(&x.0));
    valued.swap_remove(0).1
}

/// Scores explanations; the first is the baseline.
#[must_use]
pub fn compare(session: &Session, models: &[Model], threads: usize) -> Vec<Scored> {
    let folds = folds(session);
    let floor = models.iter().map(|model| noise::floor(session, &model.residuals(session))).fold(f64::MAX, f64::min);
    let start_up_s = models.iter().map(Model::start_up_s).fold(0.0, f64::max);
    in_parallel(models, threads, |model| score(model, &folds, floor, start_up_s))
}

/// The confidence set at [`LEVEL`], best first, each member with its probability.
#[must_use]
pub fn confidence_set(mut scored: Vec<Scored>, seed: u64) -> Vec<Scored> {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let recordings = scored.first().map_or(0, |one| one.densities.len());
    if recordings < 2 {
        return scored;
    }
    let draws: Vec<Vec<usize>> = (0..RESAMPLES).map(|_| (0..recordings).map(|_| generator.random_range(0..recordings)).collect()).collect();
    let mut least_sure: f64 = 0.0;
    while scored.len() > 1 {
        let count = scored.len() as f64;
        let mean: Vec<f64> = (0..recordings).map(|at| scored.iter().map(|one| one.densities[at]).sum::<f64>() / count).collect();
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
        let (worst, most) =
            (0..scored.len()).map(|at| (at, averages[at] / scatter[at])).max_by(|x, y| x.1.total_cmp(&y.1)).unwrap_or((0, 0.0));
        let beyond = (0..RESAMPLES).filter(|&draw| (0..scored.len()).any(|at| drawn[at][draw] / scatter[at] >= most)).count();
        let p_value = beyond as f64 / RESAMPLES as f64;
        least_sure = least_sure.max(p_value);
        if least_sure >= LEVEL {
            scored[worst].p_value = least_sure;
            break;
        }
        scored.remove(worst);
    }
    scored.sort_by(|x, y| y.mean().total_cmp(&x.mean()));
    scored
}

/// The members of a confidence set without those that have all effects of another member and more.
#[must_use]
pub fn simplest(set: &[Scored]) -> Vec<Scored> {
    let more =
        |one: &Scored, other: &Scored| one.names.len() > other.names.len() && other.names.iter().all(|name| one.names.contains(name));
    let mut simplest: Vec<Scored> = Vec::new();
    for one in set.iter().filter(|one| !set.iter().any(|other| more(one, other))) {
        if simplest.iter().all(|other| other.names != one.names) {
            simplest.push(one.clone());
        }
    }
    simplest
}
