//! The criterion by which explanations are compared: the log predictive density of recordings that took no part in the fit.
//!
//! Every explanation is fitted to some recordings and predicts the others, sample by sample, under one noise model: white noise, a slowly
//! varying model error (an Ornstein-Uhlenbeck process) and a share of samples from anywhere in the range. Its three numbers are those of the
//! greatest likelihood on the recordings of the fit. What sticks and slips is predicted by its switching filter under the same noise.
//!
//! Explanations are compared recording by recording, two by two, with Wilcoxon's signed ranks. The *confidence set* holds those that no other is
//! significantly better than (Hansen, Lunde and Nason 2011): the loser of the clearest pair leaves as long as a pair as clear has a probability
//! below [`LEVEL`] when chance decides for each recording which way it speaks. Of fewer than six recordings, stretches are compared.

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
use crate::selection::settings::{FEWEST_FOR_HALVES, MOST_COMPARED};
use crate::selection::switching_likelihood::QuasiStatic;
use crate::selection::switching_refits::without_jumps;

/// Probability by which an explanation leaves the confidence set that is as good as the best.
pub const LEVEL: f64 = 0.1;
/// Difference, nats per sample, that nobody cares about: innovations whose standard deviations differ by one percent.
const MATERIAL: f64 = 0.01;
/// Draws of signs.
const RESAMPLES: usize = 2000;
/// Stretches of a recording that are compared where recordings are few.
const STRETCHES: usize = 12;
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

/// The recordings that are worked with.
fn sources(session: &Session) -> Vec<usize> {
    let mut sources: Vec<usize> = session.worked().map(|run| run.source.0).collect();
    sources.sort_unstable();
    sources.dedup();
    sources
}

/// The session once for each fold: what is predicted has the role to select.
fn folds(session: &Session) -> Vec<Session> {
    let sources = sources(session);
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

/// Which recording a sample belongs to; of few recordings, which stretch of it.
fn cluster(run: &Run, few: bool, sample: usize) -> (usize, usize) {
    (run.source.0, if few { run.part * STRETCHES + sample * STRETCHES / run.input.len() } else { 0 })
}

/// Scores one explanation: mean log density of each recording that it predicts, in the order of the recordings. What comes before `start_up_s` does
/// not count.
fn score(model: &Model, folds: &[Session], floor: f64, start_up_s: f64) -> Scored {
    let few = sources(&folds[0]).len() < FEWEST_FOR_HALVES;
    let mut sums: BTreeMap<(usize, usize), (f64, f64)> = BTreeMap::new();
    for session in folds {
        let mut fitted = polish(model, session, Scope::Fit, EVALUATIONS).model.regrown();
        fitted.fit(session, Scope::Fit);
        let densities = densities(&fitted, session, floor, start_up_s);
        for (run, densities) in session.runs.iter().zip(densities) {
            for (sample, density) in densities.iter().enumerate().filter(|(sample, _)| run.time_s[*sample] >= start_up_s) {
                if run.role[sample] == Role::Select && run.keep[sample] {
                    let sum = sums.entry(cluster(run, few, sample)).or_insert((0.0, 0.0));
                    sum.0 += density;
                    sum.1 += 1.0;
                }
            }
        }
    }
    Scored { names: names(model), densities: sums.into_values().map(|(sum, count)| sum / count).collect(), p_value: 1.0 }
}

/// Log predictive density of every sample of every recording, by a fitted model.
fn densities(model: &Model, session: &Session, floor: f64, start_up_s: f64) -> Vec<Vec<f64>> {
    if let Some(slot) = model.slots.iter().find(|slot| slot.form.jumps().is_some())
        && let Some(drive) = slot.form.jumps()
    {
        let (law, own) = SlipLaw::of_parameters(drive, &slot.parameters);
        let smooth = without_jumps(model);
        let quasi_static = |times: f64| QuasiStatic::new(session, &smooth, own * times, slot.form.spec().feels_sensor);
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
    if !model.slots.iter().any(|slot| slot.form.spec().reads_output) {
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

/// Explanations compared.
pub struct Comparison {
    /// The model without effects.
    pub bare: Scored,
    /// The model that was found.
    pub found: Scored,
    /// The simplest members of the confidence set, best first.
    pub set: Vec<Scored>,
}

impl Comparison {
    /// Compares the model that was found with the one without effects and with `others`, most of which came near it.
    #[must_use]
    pub fn new(session: &Session, bare: &Model, found: &Model, others: &[&Model], seed: u64, threads: usize) -> Option<Self> {
        let parts: Vec<Model> = (0..found.slots.len()).map(|slot| found.without(slot)).collect();
        let mut models: Vec<&Model> = vec![bare, found];
        for model in parts.iter().chain(others.iter().copied()) {
            if models.len() < MOST_COMPARED && models.iter().all(|other| other.forms() != model.forms()) {
                models.push(model);
            }
        }
        let folds = folds(session);
        let floor = models.iter().map(|model| noise::floor(session, &model.residuals(session))).fold(f64::MAX, f64::min);
        let start_up_s = models.iter().map(|model| model.start_up_s()).fold(0.0, f64::max);
        let scored = in_parallel(&models, threads, |model| score(model, &folds, floor, start_up_s));
        let [bare, found, ..] = &scored[..] else { return None };
        let (bare, found) = (bare.clone(), found.clone());
        Some(Self { bare, found, set: simplest(&confidence_set(scored, seed)) })
    }

    /// How much better a model with these effects predicts than the one without any, nats per sample; nothing when it was not compared.
    #[must_use]
    pub fn gain(&self, model: &Model) -> Option<f64> {
        let names = names(model);
        let compared = std::iter::once(&self.found).chain(&self.set).chain([&self.bare]);
        compared.into_iter().find(|scored| scored.names == names).map(|scored| scored.mean() - self.bare.mean())
    }
}

/// The confidence set at [`LEVEL`], best first, each member with its probability.
fn confidence_set(mut scored: Vec<Scored>, seed: u64) -> Vec<Scored> {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let recordings = scored.first().map_or(0, |one| one.densities.len());
    // Were two explanations as good, each recording could as well have spoken for the other: the same recordings for all pairs.
    let draw = |_| (0..recordings).map(|_| if generator.random_bool(0.5) { 1.0 } else { -1.0 }).collect::<Vec<f64>>();
    let signs: Vec<Vec<f64>> = (0..RESAMPLES).map(draw).collect();
    let mut surest: f64 = 0.0;
    while scored.len() > 1 {
        let pairs: Vec<(usize, Vec<f64>)> = (0..scored.len())
            .flat_map(|worse| (0..scored.len()).filter(move |better| *better != worse).map(move |better| (worse, better)))
            .map(|(worse, better)| (worse, signed_ranks(&scored[better].densities, &scored[worse].densities)))
            .collect();
        let sum = |ranks: &[f64]| ranks.iter().sum::<f64>();
        let Some((worst, most)) = pairs.iter().map(|(worse, ranks)| (*worse, sum(ranks))).max_by(|x, y| x.1.total_cmp(&y.1)) else {
            break;
        };
        let reaches = |signs: &&Vec<f64>| {
            pairs.iter().any(|(_, ranks)| ranks.iter().zip(*signs).map(|(rank, sign)| rank * sign).sum::<f64>() >= most - 1e-9)
        };
        surest = surest.max(signs.iter().filter(reaches).count() as f64 / RESAMPLES as f64);
        if surest >= LEVEL {
            scored[worst].p_value = surest;
            break;
        }
        scored.remove(worst);
    }
    scored.sort_by(|x, y| y.mean().total_cmp(&x.mean()));
    scored
}

/// Wilcoxon's signed ranks of the differences beyond [`MATERIAL`], over the norm of the ranks: a few recordings in which much happens do not hide all others.
fn signed_ranks(better: &[f64], worse: &[f64]) -> Vec<f64> {
    let differences: Vec<f64> = better.iter().zip(worse).map(|(better, worse)| better - worse - MATERIAL).collect();
    let mut order: Vec<usize> = (0..differences.len()).collect();
    order.sort_by(|&x, &y| differences[x].abs().total_cmp(&differences[y].abs()));
    let mut ranks = vec![0.0; differences.len()];
    for (rank, &at) in order.iter().enumerate() {
        ranks[at] = (rank + 1) as f64 * differences[at].signum();
    }
    let norm = ranks.iter().map(|rank| rank * rank).sum::<f64>().sqrt().max(1e-12);
    ranks.iter().map(|rank| rank / norm).collect()
}

/// The members of a confidence set without those that have all effects of another member and more.
fn simplest(set: &[Scored]) -> Vec<Scored> {
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

#[cfg(test)]
mod tests {
    use virtual_rig::{self as rig, CaseConfig};

    use super::*;
    use crate::effects::{dead_time, pneumatic_lag};
    use crate::model::initial_state::InitialState;

    fn scored(names: &[&'static str], densities: Vec<f64>) -> Scored {
        Scored { names: names.to_vec(), densities, p_value: 1.0 }
    }

    /// Deviations without a mean, the same every time.
    fn scatter(seed: u64, size: f64, count: usize) -> Vec<f64> {
        let mut deviate = crate::data::closed_form::deviates(seed);
        (0..count).map(|_| size * deviate()).collect()
    }

    #[test]
    fn what_is_better_in_every_recording_is_alone_in_the_set_and_equals_stay_together() {
        let level = scatter(3, 0.5, 20);
        let plus = |by: f64, seed: u64| -> Vec<f64> { level.iter().zip(scatter(seed, 0.05, 20)).map(|(x, y)| x + y + by).collect() };
        let all = |better: f64| vec![scored(&[], plus(0.0, 5)), scored(&["creep"], plus(better, 6)), scored(&["resonance"], plus(0.0, 7))];
        let names = |set: Vec<Scored>| -> Vec<String> { set.iter().map(|one| one.names.join("+")).collect() };
        assert_eq!(names(confidence_set(all(0.2), 1)), ["creep"]);
        let mut equal = names(confidence_set(all(0.0), 1));
        equal.sort_unstable();
        assert_eq!(equal, ["", "creep", "resonance"]);
    }

    #[test]
    fn a_gain_that_differs_by_orders_of_magnitude_between_recordings_is_seen_and_one_recording_alone_decides_nothing() {
        let bare = scatter(8, 0.1, 16);
        let with = |gains: &dyn Fn(usize) -> f64| bare.iter().enumerate().map(|(at, value)| value + gains(at)).collect::<Vec<f64>>();
        let set = |densities: Vec<f64>| confidence_set(vec![scored(&[], bare.clone()), scored(&["creep"], densities)], 1).len();
        assert_eq!(set(with(&|at| MATERIAL + 1e-4 * 10_f64.powi(at as i32 % 5))), 1);
        assert_eq!(set(with(&|at| if at == 3 { 50.0 } else { 1e-3 * (at % 3) as f64 })), 2);
    }

    #[test]
    fn false_alarms_are_as_rare_as_the_level_says() {
        let alarms = (0..200_u64)
            .filter(|seed| {
                let one = |name: &'static [&'static str], offset: u64| scored(name, scatter(1 + 7 * seed + offset, 0.1, 12));
                let set = confidence_set(vec![one(&[], 0), one(&["creep"], 1), one(&["resonance"], 2), one(&["leakage"], 3)], 1);
                !set.iter().any(|member| member.names.is_empty())
            })
            .count();
        // The bare model is one of four that may leave: at most a tenth of the time, two standard deviations allowed.
        assert!(alarms <= 200 / 10 + 9, "{alarms} of 200");
    }

    #[test]
    fn a_member_with_more_effects_than_another_is_not_among_the_simplest() {
        let set = [scored(&["creep", "leakage"], vec![1.0]), scored(&["creep"], vec![0.9]), scored(&["resonance"], vec![0.8])];
        let simple: Vec<String> = simplest(&set).iter().map(|one| one.names.join("+")).collect();
        assert_eq!(simple, ["creep", "resonance"]);
    }

    fn holds_the_bare(compared: &Comparison) -> bool {
        compared.set.iter().any(|member| member.names == compared.bare.names)
    }

    #[test]
    fn the_hidden_effect_comes_first_and_where_nothing_is_hidden_the_bare_model_is_in_the_set() {
        for (hidden, delay_s) in [(vec!["dead-time".to_owned()], 0.1), (Vec::new(), 0.01)] {
            let case = rig::hide(&CaseConfig { effects: hidden.clone(), seed: 585, ..CaseConfig::default() }).expect("a case");
            let session = Session::new(&case.recordings[..12], &[]).expect("a session");
            let bare = Model::baseline(InitialState::carrying(case.truth.continuous), false);
            let delayed = bare.with(dead_time::FORMS[0], vec![delay_s]);
            let lagging = bare.with(pneumatic_lag::FORMS[0], vec![delay_s]);
            let compared = Comparison::new(&session, &bare, &delayed, &[&lagging], 1, 2).expect("three models");
            if hidden.is_empty() {
                assert!(holds_the_bare(&compared), "{:?}", compared.set);
            } else {
                assert!(!holds_the_bare(&compared) && compared.set[0].names == ["dead-time"], "{:?}", compared.set);
            }
        }
    }
}
