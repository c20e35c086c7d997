//! Which physical effect does the simulation lack? From recordings to a verdict, a better model and the figures that show it.
//!
//! The baseline is a bank of play operators with weights that are not negative. Every effect of the [`catalogue`] is fitted on top of it,
//! its parameters by a grid and a simplex, the weights of everything linear inside (variable projection), on one half of the recordings;
//! the other half selects. Effects come in one at a time, are polished together and leave again when they stop paying. What is still
//! there in the end decides between `named` and `unknown`. Kept-out recordings only give the final figures.

pub mod catalogue;
pub mod corpus;
pub mod effects;
pub mod file;
mod least_squares;
mod mask;
mod model;
mod noise;
mod search;
mod session;
mod whereabouts;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

use serde::Serialize;

pub use model::{Model, Slot};
pub use session::{Role, Run, Session, SessionError};
pub use whereabouts::Disagreement;

use crate::recording::Recording;
use catalogue::Form;
use search::Fitted;

/// How to discover.
#[derive(Clone, Debug)]
pub struct DiscoverConfig {
    /// Worker threads.
    pub threads: usize,
    /// Most effects to add.
    pub most_effects: usize,
    /// Seed of the surrogates.
    pub seed: u64,
}

impl Default for DiscoverConfig {
    fn default() -> Self {
        Self { threads: std::thread::available_parallelism().map_or(1, usize::from), most_effects: 3, seed: 1 }
    }
}

/// What was found out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The model explains the recordings down to the noise.
    None,
    /// The effects named explain the gap.
    Named,
    /// Two effects explain it equally well.
    Ambiguous,
    /// Nothing in the catalogue explains it.
    Unknown,
}

/// An effect that was named.
#[derive(Clone, Debug, Serialize)]
pub struct Effect {
    /// Name from the vocabulary.
    pub name: String,
    /// Which form of it.
    pub form: String,
    /// How sure, 0 to 1, against all other effects.
    pub confidence: f64,
    /// Parameters in the lab's units.
    pub parameters: BTreeMap<String, f64>,
    /// Where each non-linear parameter lies with 95 % confidence.
    pub intervals: BTreeMap<String, [f64; 2]>,
}

/// The effect that came second.
#[derive(Clone, Debug, Serialize)]
pub struct RunnerUp {
    /// Its name.
    pub name: String,
    /// Whether the recordings tell it from the first.
    pub separable: bool,
}

/// One effect tried alone.
#[derive(Clone, Debug, Serialize)]
pub struct Candidate {
    /// Its name.
    pub name: String,
    /// Share of the mean square that it takes away on the selecting samples, 0 to 1; may be negative.
    pub score: f64,
    /// Probability of such a gain by chance.
    pub p_value: f64,
}

/// The result, with the keys of the command's contract.
#[derive(Clone, Debug, Serialize)]
pub struct Discovery {
    /// Verdict.
    pub verdict: Verdict,
    /// Effects, the largest first.
    pub effects: Vec<Effect>,
    /// Second best explanation.
    pub runner_up: Option<RunnerUp>,
    /// RMSE of the model without the effects on kept-out samples, output units.
    pub rmse_before: f64,
    /// RMSE of the model with them on kept-out samples, output units.
    pub rmse_after: f64,
    /// Noise, output units.
    pub noise_floor: f64,
    /// Share of the gap closed, `(before - after) / (before - floor)`, 0 to 1.
    pub gap_closed: f64,
    /// Every effect tried alone, best first.
    pub candidates: Vec<Candidate>,
    /// Where the model without effects and the measurement disagree.
    #[serde(rename = "where")]
    pub disagreements: Vec<Disagreement>,
    /// The same in a sentence.
    pub summary: String,
    /// Samples left out as outliers.
    pub excluded_samples: usize,
    /// Names of the kept-out recordings.
    pub kept_out: Vec<String>,
}

/// A finished discovery: the result and what it was made of.
pub struct Finding {
    /// The result.
    pub discovery: Discovery,
    /// The recordings, normalised.
    pub session: Session,
    /// The model without effects.
    pub before: Model,
    /// The model with them.
    pub after: Model,
}

/// Least share of the mean square that the first effect takes away.
const LEAST_GAIN: f64 = 0.012;
/// Least share of the original excess over the noise that a further effect takes away.
const LEAST_FURTHER_SHARE: f64 = 0.02;
/// Least share of the remaining excess over the noise that a further effect takes away.
const LEAST_FURTHER_GAIN: f64 = 0.2;
/// Blocked deviations that an improvement must reach.
const LEAST_DEVIATIONS: f64 = 3.0;
/// What a parameter must bring, as a share of the mean square, when effects compete.
const PRICE: f64 = 0.012;

/// Runs `work` for every item on several threads; results in the order of the items, whatever the number of threads.
fn in_parallel<T: Send, I: Sync>(items: &[I], threads: usize, work: impl Fn(&I) -> T + Sync) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let mut results: Vec<Option<T>> = items.iter().map(|_| None).collect();
    let chunks = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads.clamp(1, items.len().max(1)))
            .map(|_| {
                scope.spawn(|| {
                    let mut done = Vec::new();
                    loop {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        let Some(item) = items.get(index) else { break done };
                        done.push((index, work(item)));
                    }
                })
            })
            .collect();
        workers.into_iter().map(|worker| worker.join()).collect::<Vec<_>>()
    });
    for chunk in chunks {
        match chunk {
            Ok(done) => done.into_iter().for_each(|(index, value)| results[index] = Some(value)),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
    results.into_iter().flatten().collect()
}

/// How many deviations the blocked mean of `before - after` lies above zero.
fn deviations(before: &[f64], after: &[f64]) -> f64 {
    let differences: Vec<f64> = before.iter().zip(after).map(|(x, y)| x - y).collect();
    let n = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / n;
    // Neighbouring blocks share their errors: the variance of the mean takes lags up to three blocks (Newey and West 1987).
    let mut variance = differences.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n;
    for lag in 1..=3_usize {
        let covariance: f64 = differences.windows(lag + 1).map(|pair| (pair[0] - mean) * (pair[lag] - mean)).sum::<f64>() / n;
        variance += 2.0 * (1.0 - lag as f64 / 4.0) * covariance;
    }
    mean / (variance.max(1e-30) / n).sqrt()
}

/// Upper tail of the normal distribution.
fn tail(deviations: f64) -> f64 {
    // Complementary error function, Abramowitz and Stegun 7.1.26 (absolute error below 1.5e-7).
    let x = deviations.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let poly = t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let upper = 0.5 * poly * (-x * x).exp();
    if deviations >= 0.0 { upper } else { 1.0 - upper }
}

/// A candidate with its test.
#[derive(Clone)]
struct Tried {
    fitted: Fitted,
    form: &'static dyn Form,
    deviations: f64,
}

impl Tried {
    /// What it is judged by: the logarithm of the mean square that remains and the price of its parameters.
    fn judgement(&self) -> f64 {
        self.fitted.select.max(1e-30).ln() + PRICE * self.fitted.model.cost() as f64
    }
}

/// Everything the selection works with.
struct Bench<'a> {
    session: &'a Session,
    forms: Vec<&'static dyn Form>,
    threads: usize,
}

impl Bench<'_> {
    fn selecting_blocks(&self, model: &Model) -> Vec<f64> {
        let residual = model.residuals(self.session);
        noise::blocks(self.session, &residual, |run, sample| self.session.runs[run].role[sample] == Role::Select)
    }

    /// Every form on top of `base`, best first.
    fn round(&self, base: &Model) -> Vec<Tried> {
        let residual = base.residuals(self.session);
        let before = self.selecting_blocks(base);
        let forms: Vec<&'static dyn Form> =
            self.forms.iter().copied().filter(|form| !base.slots.iter().any(|slot| slot.form.name() == form.name())).collect();
        let fitted = in_parallel(&forms, self.threads, |form| {
            search::fit_form(base, *form, self.session, &residual).map(|fitted| {
                let deviations = deviations(&before, &self.selecting_blocks(&fitted.model));
                Tried { fitted, form: *form, deviations }
            })
        });
        let mut tried: Vec<Tried> = fitted.into_iter().flatten().collect();
        tried.sort_by(|x, y| x.judgement().total_cmp(&y.judgement()));
        tried
    }

    /// The best few, polished together with what is already there; best first.
    fn polished(&self, tried: &[Tried], effort: usize) -> Vec<Tried> {
        let mut names: Vec<&str> = Vec::new();
        let mut best: Vec<&Tried> = Vec::new();
        for one in tried {
            // Two forms of an effect at most, four effects at most.
            if names.iter().filter(|name| **name == one.form.name()).count() < 2 && best.len() < 5 {
                names.push(one.form.name());
                best.push(one);
            }
        }
        let mut polished = in_parallel(&best, self.threads, |one| {
            let mut fitted = search::polish(&one.fitted.model, self.session, effort);
            // Whether the muscle remembers earlier recordings shows only when nothing large is missing any more.
            let mut turned = fitted.model.clone();
            turned.carry = !turned.carry;
            if turned.fit(self.session, model::Scope::Both).1 < 0.98 * fitted.select {
                let turned = search::polish(&turned, self.session, effort);
                if turned.select < fitted.select {
                    fitted = turned;
                }
            }
            let fitted = if fitted.select < one.fitted.select * 1.001 { fitted } else { one.fitted.clone() };
            Tried { fitted, form: one.form, deviations: one.deviations }
        });
        polished.sort_by(|x, y| x.judgement().total_cmp(&y.judgement()));
        polished
    }
}

/// Finds what the model lacks in `recordings`; `kept` take no part in any choice (some of `recordings` are set apart when empty).
///
/// # Errors
/// When there is too little to learn from.
pub fn discover(recordings: &[Recording], kept: &[Recording], config: &DiscoverConfig) -> Result<Finding, SessionError> {
    let mut session = Session::new(recordings, kept)?;
    let zero: Vec<Vec<f64>> = session.runs.iter().map(|run| run.output.clone()).collect();
    mask::outliers(&mut session, &zero, false);
    let mut before = baseline(&session);
    let residual = before.residuals(&session);
    mask::outliers(&mut session, &residual, true);
    // A second look: the first fit was pulled about by what it is to find.
    before.fit(&session, model::Scope::Fit);
    let residual = before.residuals(&session);
    mask::outliers(&mut session, &residual, true);
    let (_, mut select) = before.fit(&session, model::Scope::Both);
    let bench = Bench { session: &session, forms: catalogue::forms(), threads: config.threads };

    let mut model = before.clone();
    let first_select = select;
    let mut candidates: Vec<Candidate> = Vec::new();
    let mut runner_up = None;
    let mut order: Vec<&'static str> = Vec::new();
    let mut twins = false;
    for round in 0..config.most_effects {
        let floor_square = noise::floor(&session, &model.residuals(&session)).powi(2);
        if round > 0 && select < 1.1 * floor_square {
            break;
        }
        let tried = bench.round(&model);
        if round == 0 {
            for one in &tried {
                if !candidates.iter().any(|candidate| candidate.name == one.form.name()) {
                    candidates.push(Candidate {
                        name: one.form.name().to_owned(),
                        score: 1.0 - one.fitted.select / select,
                        p_value: tail(one.deviations),
                    });
                }
            }
        }
        let best = bench.polished(&tried, 20);
        let Some(chosen) = best.first() else { break };
        let gain = 1.0 - chosen.fitted.select / select;
        let excess = (first_select - floor_square).max(0.05 * floor_square);
        let enough = if round == 0 {
            gain >= LEAST_GAIN
        } else {
            let taken = select - chosen.fitted.select;
            taken >= LEAST_FURTHER_SHARE * excess && taken >= LEAST_FURTHER_GAIN * (select - floor_square) && gain >= 2.0 * LEAST_GAIN
        };
        let deviations = deviations(&bench.selecting_blocks(&model), &bench.selecting_blocks(&chosen.fitted.model));
        if !enough || deviations < LEAST_DEVIATIONS {
            break;
        }
        if round == 0 {
            runner_up = best.iter().chain(&tried).find(|one| one.form.name() != chosen.form.name()).map(|second| {
                let apart = self::deviations(&bench.selecting_blocks(&second.fitted.model), &bench.selecting_blocks(&chosen.fitted.model));
                twins = second.fitted.model.cost() <= chosen.fitted.model.cost() && second.fitted.select < 1.005 * chosen.fitted.select;
                RunnerUp {
                    name: second.form.name().to_owned(),
                    separable: apart > 2.0 && second.fitted.select > 1.01 * chosen.fitted.select,
                }
            });
        }
        model = chosen.fitted.model.clone();
        select = chosen.fitted.select;
        order.push(chosen.form.name());
        // What came in earlier leaves when it no longer pays.
        loop {
            let mut left = None;
            for slot in 0..model.slots.len() {
                if model.slots.len() < 2 {
                    break;
                }
                let fewer = search::polish(&model.without(slot), &session, 20);
                if fewer.select < select * (1.0 + LEAST_GAIN) || fewer.select - select < LEAST_FURTHER_SHARE * excess {
                    left = Some((slot, fewer));
                    break;
                }
            }
            let Some((slot, fewer)) = left else { break };
            let name = model.slots[slot].form.name();
            order.retain(|other| *other != name);
            model = fewer.model;
            select = fewer.select;
        }
    }
    let final_fit = search::polish(&model, &session, 40);
    let mut after = if final_fit.select <= select * 1.001 { final_fit.model } else { model };
    drop(bench);
    // Fast motion that the first model lacked may have looked wrong: only what the last model finds wrong too is an outlier.
    for run in &mut session.runs {
        run.keep.fill(true);
    }
    let residual = after.residuals(&session);
    mask::outliers(&mut session, &residual, true);
    let excluded: usize = session.runs.iter().map(|run| run.keep.iter().filter(|keep| !**keep).count()).sum();
    after.fit_all(&session);
    before.fit_all(&session);
    let mut discovery = judge(&session, &before, &after, &order, candidates, runner_up, twins, excluded);
    discovery.disagreements = whereabouts::disagreements(&session, &before.residuals(&session), config.seed);
    discovery.summary = whereabouts::sentence(&discovery.disagreements);
    Ok(Finding { discovery, session, before, after })
}

/// The baseline that fits better: operators that begin fresh in every recording, or ones that remember.
fn baseline(session: &Session) -> Model {
    let mut fresh = Model::baseline(false, false);
    let mut stops = Model::baseline(false, true);
    let (fresh_square, _) = fresh.fit(session, model::Scope::Fit);
    let (stops_square, _) = stops.fit(session, model::Scope::Fit);
    if stops_square < 0.5 * fresh_square {
        return stops;
    }
    let mut carried = Model::baseline(true, false);
    let (carried_square, _) = carried.fit(session, model::Scope::Fit);
    if carried_square < 0.98 * fresh_square { carried } else { fresh }
}

/// Root mean square over kept-out samples, or over all others when none is kept; masked samples count if `all`.
fn rmse(session: &Session, residual: &[Vec<f64>], all: bool) -> f64 {
    let any_kept = session.count(Role::Kept) > 0;
    let mut sum = 0.0;
    let mut count = 0.0_f64;
    for (run, residual) in session.runs.iter().zip(residual) {
        for (sample, value) in residual.iter().enumerate() {
            if (run.role[sample] == Role::Kept || !any_kept) && (all || run.keep[sample]) {
                sum += value * value;
                count += 1.0;
            }
        }
    }
    (sum / count.max(1.0)).sqrt()
}

/// Correlation of neighbouring residuals.
fn neighbour_correlation(session: &Session, residual: &[Vec<f64>]) -> f64 {
    let (mut square, mut product) = (1e-30, 0.0);
    for (run, residual) in session.runs.iter().zip(residual) {
        for (pair, keep) in residual.windows(2).zip(run.keep.windows(2)) {
            if keep[0] && keep[1] {
                square += pair[0] * pair[0];
                product += pair[0] * pair[1];
            }
        }
    }
    (product / square).clamp(0.0, 0.98)
}

/// The verdict and the figures.
#[expect(clippy::too_many_arguments, reason = "called once, with everything the search has found")]
fn judge(
    session: &Session,
    before: &Model,
    after: &Model,
    order: &[&'static str],
    candidates: Vec<Candidate>,
    runner_up: Option<RunnerUp>,
    twins: bool,
    excluded: usize,
) -> Discovery {
    let (residual_before, residual_after) = (before.residuals(session), after.residuals(session));
    let floor = noise::floor(session, &residual_after);
    let scale = session.output_scale.abs();
    let with_outliers = excluded * 2000 > session.runs.iter().map(|run| run.input.len()).sum::<usize>();
    let rmse_before = rmse(session, &residual_before, with_outliers);
    let rmse_after = rmse(session, &residual_after, false);
    // The verdict rests on the samples that were worked with; kept-out ones only report.
    let worked = |residual: &[Vec<f64>], all: bool| {
        let samples = session.runs.iter().zip(residual).flat_map(|(run, residual)| {
            residual.iter().enumerate().filter(move |&(at, _)| run.role[at] != Role::Kept && (all || run.keep[at])).map(|(_, value)| value)
        });
        let (sum, count) = samples.fold((0.0, 0.0_f64), |(sum, count), value| (sum + value * value, count + 1.0));
        (sum / count.max(1.0)).sqrt()
    };
    let (was, is) = (worked(&residual_before, with_outliers), worked(&residual_after, false));
    let stands_out = is > 1.15 * floor;
    let unexplained = if was > 1.02 * floor { ((is - floor) / (was - floor)).clamp(0.0, 1.0) } else { 0.0 };
    let mut effects: Vec<Effect> = Vec::new();
    let deviations = search::parameter_deviations(after, session, neighbour_correlation(session, &residual_after));
    for name in order {
        let before: usize = after.slots.iter().take_while(|slot| slot.form.name() != *name).map(|slot| slot.parameters.len()).sum();
        let Some(slot) = after.slots.iter().find(|slot| slot.form.name() == *name) else { continue };
        let mut parameters: BTreeMap<String, f64> =
            slot.form.parameters().iter().zip(&slot.parameters).map(|(parameter, &value)| parameter.tell(value, session)).collect();
        parameters.extend(slot.form.tell(&slot.weights, session));
        let intervals = slot
            .form
            .parameters()
            .iter()
            .zip(&slot.parameters)
            .zip(&deviations[before..])
            .filter(|(_, deviation)| **deviation > 0.0)
            .map(|((parameter, &value), deviation)| {
                let (name, low) = parameter.tell((value - 1.96 * deviation).max(parameter.low), session);
                (name, [low, parameter.tell((value + 1.96 * deviation).min(parameter.high), session).1])
            })
            .collect();
        effects.push(Effect {
            name: (*name).to_owned(),
            form: slot.form.form().to_owned(),
            confidence: (1.0 - unexplained).clamp(0.0, 1.0),
            parameters,
            intervals,
        });
    }
    if with_outliers {
        let share = excluded as f64 / session.runs.iter().map(|run| run.input.len()).sum::<usize>() as f64;
        effects.push(Effect {
            name: "outliers".to_owned(),
            form: "samples that no motion could have caused".to_owned(),
            confidence: 0.99,
            parameters: BTreeMap::from([("share".to_owned(), share)]),
            intervals: BTreeMap::new(),
        });
    }
    let verdict = if stands_out && (unexplained > 0.10 || effects.is_empty()) {
        Verdict::Unknown
    } else if effects.is_empty() {
        Verdict::None
    } else if twins && runner_up.as_ref().is_some_and(|second| !second.separable) && effects.len() == 1 {
        Verdict::Ambiguous
    } else {
        Verdict::Named
    };
    let kept_out = session.runs.iter().filter(|run| run.role.contains(&Role::Kept)).map(|run| run.name.clone()).collect();
    let (noise_floor, gap) = (floor * scale, rmse_before - floor);
    Discovery {
        verdict,
        effects,
        runner_up,
        rmse_before: rmse_before * scale,
        rmse_after: rmse_after * scale,
        noise_floor,
        gap_closed: if gap > 0.0 { ((rmse_before - rmse_after) / gap).clamp(0.0, 1.0) } else { 0.0 },
        candidates,
        disagreements: Vec::new(),
        summary: String::new(),
        excluded_samples: excluded,
        kept_out,
    }
}

#[cfg(test)]
mod tests;
