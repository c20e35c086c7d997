//! The criterion by which explanations are compared: the log predictive density of recordings that took no part in the fit.
//!
//! Every explanation is fitted to some recordings and predicts the others, sample by sample, under one noise model: white noise, a slowly
//! varying model error (an Ornstein-Uhlenbeck process) and a share of samples from anywhere in the range. Its three numbers are those of the
//! greatest likelihood on the recordings of the fit. What sticks and slips is predicted by its switching filter under the same noise.
//!
//! Explanations are compared recording by recording, two by two, with Wilcoxon's signed ranks. The *confidence set* holds those that no other is
//! significantly better than (Hansen, Lunde and Nason 2011): the loser of the clearest pair leaves as long as a pair as clear has a probability
//! below [`LEVEL`] when chance decides for each recording which way it speaks. Of few recordings, stretches are compared.
//!
//! A *margin* is what nobody cares about. A dearer member that is not better than a cheaper one by the margin leaves too. The first of those that
//! stay is the explanation; where the model without effects stays, there is none.

use std::collections::{BTreeMap, BTreeSet};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::data::noise;
use crate::data::session::{Role, Run, Session};
use crate::model::structure::{Model, Scope};
use crate::model::workspace::Workspace;
use crate::observers::jumps;
use crate::observers::law::{Seen, SlipLaw};
use crate::result::Member;
use crate::search::forms::polished;
use crate::search::parallel::in_parallel;
use crate::search::simplex::most_along;
use crate::selection::settings::{FEWEST_FOR_HALVES, LEVEL, MATERIAL, MATERIAL_SHARE};
use crate::selection::switching_likelihood::QuasiStatic;
use crate::selection::switching_refits::{with_lag, without_jumps};

/// Folds of recordings, where there are many.
const FOLDS: usize = 4;
/// Draws of signs, and of recordings.
const RESAMPLES: usize = 2000;
/// Fewest recordings, or stretches of equal length of them where there are fewer, that are compared.
const CLUSTERS: usize = 20;
/// Evaluations for each parameter when a model is fitted to the recordings of a fold.
const EVALUATIONS: usize = 8;
/// White noise that is tried, in units of the noise at rest.
const NOISES: [f64; 7] = [1.0, 1.25, 1.6, 2.2, 3.5, 7.0, 20.0];

/// An explanation and how well it predicts.
#[derive(Clone, Debug)]
pub struct Scored {
    /// Which of the models compared it is.
    pub index: usize,
    /// Names of its effects, in alphabetical order.
    pub names: Vec<&'static str>,
    /// Number of parameters that its effects count as.
    pub cost: usize,
    /// Number of those that they have: more in forms that say the same with one of them at a limit.
    pub parameters: usize,
    /// Mean log predictive density of each recording, nats per sample.
    pub densities: Vec<f64>,
    /// Probability of a distance from the other members like its own, were all as good.
    pub p_value: f64,
}

impl Scored {
    /// Mean over the recordings.
    pub fn mean(&self) -> f64 {
        self.densities.iter().sum::<f64>() / self.densities.len().max(1) as f64
    }
}

/// Names of a model's effects, each once, in alphabetical order.
fn names(model: &Model) -> Vec<&'static str> {
    let names: BTreeSet<&'static str> = model.names().collect();
    names.into_iter().collect()
}

/// The recordings that are worked with.
pub fn sources(session: &Session) -> Vec<usize> {
    let sources: BTreeSet<usize> = session.worked().map(|run| run.source.0).collect();
    sources.into_iter().collect()
}

/// The session once for each fold: what is predicted has the role to select. One recording has its two roles changed; few recordings are left out one by
/// one; of more, those dealt to the same of [`FOLDS`] folds, the ones that move most first. The first of many is always fitted: what the material went
/// through before the session shows in it alone, and who has not seen it cannot foretell it.
fn folds(session: &Session) -> Vec<Session> {
    let sources = sources(session);
    if sources.len() == 1 {
        let mut swapped = session.clone();
        for role in swapped.runs.iter_mut().flat_map(|run| &mut run.role) {
            *role = match *role {
                Role::Fit => Role::Select,
                Role::Select => Role::Fit,
                other => other,
            };
        }
        return vec![session.clone(), swapped];
    }
    let travel = |source: usize| -> f64 {
        let of = |run: &Run| run.input.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f64>();
        session.worked().filter(|run| run.source.0 == source).map(of).sum()
    };
    let few = sources.len() < FEWEST_FOR_HALVES;
    let first = session.worked().next().map(|run| run.source.0).filter(|_| !few);
    let mut dealt: Vec<(f64, usize)> =
        sources.iter().filter(|source| Some(**source) != first).map(|&source| (travel(source), source)).collect();
    dealt.sort_by(|x, y| y.0.total_cmp(&x.0));
    let folds = if few { dealt.len() } else { FOLDS };
    let leaving = |hand: usize| {
        let mut fold = session.clone();
        for run in &mut fold.runs {
            let is_left_out = dealt.iter().position(|(_, source)| *source == run.source.0).is_some_and(|place| place % folds == hand);
            let role = if is_left_out { Role::Select } else { Role::Fit };
            run.role.iter_mut().filter(|role| role.is_worked_with()).for_each(|of| *of = role);
            run.screens = true;
        }
        fold.screen_some();
        fold
    };
    (0..folds).map(leaving).collect()
}

/// Which recording a sample belongs to, and which of so many stretches of it.
fn cluster(run: &Run, stretches: usize, sample: usize) -> (usize, usize) {
    (run.source.0, if stretches > 1 { run.part * stretches + sample * stretches / run.input.len() } else { 0 })
}

/// Sums of log densities, and numbers of samples, of recordings or stretches of them.
type Sums = BTreeMap<(usize, usize), (f64, f64)>;

/// Adds what a model, fitted to a fold, predicts of the recordings left out. What comes before `start_up_s` does not count.
fn predict(sums: &mut Sums, model: &Model, session: &Session, floor: f64, start_up_s: f64) {
    let stretches = CLUSTERS.div_ceil(sources(session).len());
    let mut fitted = model.clone();
    // Weights that slips have told are not for a fit to the output to change.
    if !model.fixed_weights {
        let mut workspace = Workspace::new(session);
        fitted = polished(model, &mut workspace, Scope::Fit, EVALUATIONS);
        if fitted.needs_sum() {
            fitted.fit_in(&mut workspace, Scope::Fit);
        }
        fitted = fitted.regrown();
        fitted.fit(session, Scope::Fit);
    }
    for (run, densities) in session.runs.iter().zip(densities(&fitted, session, floor, start_up_s)) {
        for (sample, density) in densities.iter().enumerate().filter(|(sample, _)| run.time_s[*sample] >= start_up_s) {
            if run.role[sample] == Role::Select && run.keep[sample] {
                let sum = sums.entry(cluster(run, stretches, sample)).or_insert((0.0, 0.0));
                sum.0 += density;
                sum.1 += 1.0;
            }
        }
    }
}

/// A model by its mean log density of each recording predicted so far, in the order of the recordings.
fn scored(index: usize, model: &Model, sums: &Sums) -> Scored {
    let densities = sums.values().map(|(sum, count)| sum / count).collect();
    let parameters = model.slots.iter().map(|slot| slot.parameters.len()).sum();
    Scored { index, names: names(model), cost: model.cost(), parameters, densities, p_value: 1.0 }
}

/// Those that stay in the race: not who is behind the best in every one of the recordings so far by more than anybody could care about, where these are so
/// many that chance does not do that to one of all at [`LEVEL`]; stretches of one recording are no recordings more. The model without effects and the best
/// one that has an effect which the very best has not are wanted in any case.
fn in_the_race(scored: &[Scored], recordings: usize) -> Vec<usize> {
    let by_mean = |x: &&Scored, y: &&Scored| x.mean().total_cmp(&y.mean());
    let Some(best) = scored.iter().max_by(by_mean) else { return Vec::new() };
    let other = |one: &&Scored| one.names.iter().any(|name| !best.names.contains(name));
    let second = scored.iter().filter(other).max_by(by_mean).map(|one| one.index);
    let is_behind = |one: &Scored| best.densities.iter().zip(&one.densities).all(|(best, own)| best - own > MATERIAL[1]);
    let chance = scored.len() as f64 * 0.5_f64.powi(recordings as i32);
    let stays = |one: &&Scored| one.index == 0 || Some(one.index) == second || chance >= LEVEL || !is_behind(one);
    scored.iter().filter(stays).map(|one| one.index).collect()
}

/// Log predictive density of every sample of every recording, by a fitted model.
pub fn densities(model: &Model, session: &Session, floor: f64, start_up_s: f64) -> Vec<Vec<f64>> {
    if let Some(slot) = model.slots.iter().find(|slot| slot.form.jumps().is_some())
        && let Some(drive) = slot.form.jumps()
    {
        let (law, own) = SlipLaw::of_parameters(drive, &slot.parameters);
        let smooth = with_lag(&without_jumps(model), drive, law.lag_s);
        let quasi_static = |times: f64| QuasiStatic::new(session, &smooth, own * times, slot.form.spec().feels_sensor);
        let [times] = most_along([&NOISES], |&[times]| quasi_static(times).fitting(&law));
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
    let likelihood = |&[times, share, time_s]: &[f64; 3]| -> f64 {
        let screens = session.runs.iter().filter(|run| run.screens && run.role.contains(&Role::Fit));
        let of = |run: &Run| {
            let densities = smooth(run, times * floor, share * excess, time_s);
            densities.iter().enumerate().filter(|(sample, _)| fitted(run, *sample)).map(|(_, density)| density).sum::<f64>()
        };
        screens.map(of).sum()
    };
    // Standard deviations of the model error in units of what the noise does not explain, and its time constants, s.
    let [times, share, time_s] = most_along([&NOISES, &[1.0, 0.7, 0.4, 1.4], &[0.25, 0.04, 0.1, 0.6, 2.0, 10.0]], likelihood);
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

/// Explanations compared.
pub struct Comparison {
    /// All of them, the model without effects first.
    scored: Vec<Scored>,
    /// The simplest members of the confidence set, best first.
    pub set: Vec<Scored>,
    /// Difference, nats per sample, that nobody cares about.
    margin: f64,
    seed: u64,
}

impl Comparison {
    /// Compares models, of which the first has no effects; there is one at least.
    pub fn new(session: &Session, models: &[Model], seed: u64, threads: usize) -> Self {
        let folds = folds(session);
        let floors = in_parallel(models, threads, |model| noise::floor(session, &model.residuals(session)));
        let floor = floors.into_iter().fold(f64::MAX, f64::min);
        let start_up_s = models.iter().map(Model::start_up_s).fold(0.0, f64::max);
        let mut racing: Vec<(usize, Sums)> = (0..models.len()).map(|index| (index, Sums::new())).collect();
        for fold in &folds {
            racing = in_parallel(&racing, threads, |(index, sums)| {
                let mut sums = sums.clone();
                predict(&mut sums, &models[*index], fold, floor, start_up_s);
                (*index, sums)
            });
            let so_far: Vec<Scored> = racing.iter().map(|(index, sums)| scored(*index, &models[*index], sums)).collect();
            let recordings: BTreeSet<usize> = racing[0].1.keys().map(|(source, _)| *source).collect();
            let stay = in_the_race(&so_far, recordings.len());
            racing.retain(|(index, _)| stay.contains(index));
        }
        Self::of(racing.iter().map(|(index, sums)| scored(*index, &models[*index], sums)).collect(), seed)
    }

    /// From what was scored, the model without effects first.
    fn of(scored: Vec<Scored>, seed: u64) -> Self {
        let most = scored.iter().map(Scored::mean).fold(f64::MIN, f64::max);
        let margin = (MATERIAL_SHARE * (most - scored[0].mean())).clamp(MATERIAL[0], MATERIAL[1]);
        let set = simplest(&confidence_set(scored.clone(), margin, seed), margin);
        // Nobody cares about what the simplest of them explains.
        let is_little = set.first().is_some_and(|first| first.mean() - scored[0].mean() <= margin);
        let set = if is_little { scored[..1].to_vec() } else { set };
        Self { scored, set, margin, seed }
    }

    /// Whether no explanation is better than none.
    pub fn holds_none(&self) -> bool {
        self.set.iter().any(|member| member.index == 0)
    }

    /// Which of the models is the explanation: the first of the set, or the one without effects where that is in it.
    pub fn best(&self) -> usize {
        if self.holds_none() { 0 } else { self.set.first().map_or(0, |member| member.index) }
    }

    /// How much better a model that is still in the race predicts than the one without effects, nats per sample.
    pub fn gain(&self, index: usize) -> f64 {
        self.scored.iter().find(|one| one.index == index).map_or(0.0, |one| one.mean() - self.scored[0].mean())
    }

    /// A member of the set for the result.
    pub fn member(&self, member: &Scored) -> Member {
        Member {
            effects: member.names.iter().map(|name| (*name).to_owned()).collect(),
            criterion: self.gain(member.index),
            p_value: member.p_value,
        }
    }

    /// The best of those that have an effect which the explanation does not have, and whether the recordings tell it apart.
    pub fn second(&self) -> Option<(&Scored, bool)> {
        let best = self.scored.iter().find(|one| one.index == self.best())?;
        let other = |one: &&Scored| one.names.iter().any(|name| !best.names.contains(name));
        let second =
            self.set.iter().find(other).or_else(|| self.scored.iter().filter(other).max_by(|x, y| x.mean().total_cmp(&y.mean())))?;
        Some((second, self.set.iter().all(|member| member.index != second.index)))
    }

    /// Probability that an effect is part of the explanation: the share of draws of recordings, with replacement, by which the cheapest model that no
    /// other one is better than by the margin has it. Two are compared as for the set.
    pub fn probability(&self, name: &str) -> f64 {
        let mut generator = ChaCha8Rng::seed_from_u64(self.seed);
        let recordings = self.scored[0].densities.len();
        let ranks = |one: &Scored| -> Vec<Vec<f64>> {
            let others = self.scored.iter().filter(|other| other.index != one.index);
            others.map(|other| signed_ranks(&other.densities, &one.densities, self.margin)).collect()
        };
        let beaten_by: Vec<Vec<Vec<f64>>> = self.scored.iter().map(ranks).collect();
        let has_it = |_: &usize| {
            let drawn: Vec<usize> = (0..recordings).map(|_| generator.random_range(0..recordings)).collect();
            let sum = |values: &Vec<f64>| drawn.iter().map(|&at| values[at]).sum::<f64>();
            let beaten = |at: usize| beaten_by[at].iter().map(sum).fold(0.0, f64::max);
            let key = |at: usize| (beaten(at), self.scored[at].cost, -sum(&self.scored[at].densities));
            let order = |x: (f64, usize, f64), y: (f64, usize, f64)| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)).then(x.2.total_cmp(&y.2));
            let best = (0..self.scored.len()).map(|at| (key(at), at)).min_by(|x, y| order(x.0, y.0));
            best.is_some_and(|(_, at)| self.scored[at].names.contains(&name))
        };
        (0..RESAMPLES).filter(has_it).count() as f64 / RESAMPLES as f64
    }
}

/// The confidence set at [`LEVEL`], best first, each member with its probability.
fn confidence_set(mut scored: Vec<Scored>, margin: f64, seed: u64) -> Vec<Scored> {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let recordings = scored.first().map_or(0, |one| one.densities.len());
    // Were two explanations as good, each recording could as well have spoken for the other: the same recordings for all pairs.
    let draw = |_| (0..recordings).map(|_| if generator.random_bool(0.5) { 1.0 } else { -1.0 }).collect::<Vec<f64>>();
    let signs: Vec<Vec<f64>> = (0..RESAMPLES).map(draw).collect();
    let mut surest: f64 = 0.0;
    while scored.len() > 1 {
        let pairs: Vec<(usize, Vec<f64>)> = (0..scored.len())
            .flat_map(|worse| (0..scored.len()).filter(move |better| *better != worse).map(move |better| (worse, better)))
            .map(|(worse, better)| (worse, signed_ranks(&scored[better].densities, &scored[worse].densities, margin)))
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

/// Wilcoxon's signed ranks of the differences beyond a margin, over the norm of the ranks: a few recordings in which much happens do not hide all others.
fn signed_ranks(better: &[f64], worse: &[f64], margin: f64) -> Vec<f64> {
    let differences: Vec<f64> = better.iter().zip(worse).map(|(better, worse)| better - worse - margin).collect();
    let mut order: Vec<usize> = (0..differences.len()).collect();
    order.sort_by(|&x, &y| differences[x].abs().total_cmp(&differences[y].abs()));
    let mut ranks = vec![0.0; differences.len()];
    for (rank, &at) in order.iter().enumerate() {
        ranks[at] = (rank + 1) as f64 * differences[at].signum();
    }
    let norm = ranks.iter().map(|rank| rank * rank).sum::<f64>().sqrt().max(1e-12);
    ranks.iter().map(|rank| rank / norm).collect()
}

/// The members of a confidence set that no simpler one does as well as: one with all effects of another member and more leaves, and so does a dearer one that
/// is not better by the margin, as which counts the form of the same effects that says it with more parameters. Each set of effects stays once.
fn simplest(set: &[Scored], margin: f64) -> Vec<Scored> {
    let more =
        |one: &Scored, other: &Scored| one.names.len() > other.names.len() && other.names.iter().all(|name| one.names.contains(name));
    let price = |one: &Scored, other: &Scored| (one.cost, if one.names == other.names { one.parameters } else { 0 });
    let dearer = |one: &Scored, other: &Scored| price(one, other) > price(other, one) && one.mean() < other.mean() + margin;
    let mut simplest: Vec<Scored> = Vec::new();
    for one in set.iter().filter(|one| !set.iter().any(|other| more(one, other) || dearer(one, other))) {
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
        Scored { index: names.len(), names: names.to_vec(), cost: names.len(), parameters: names.len(), densities, p_value: 1.0 }
    }

    /// Deviations without a mean, the same every time.
    fn scatter(seed: u64, size: f64, count: usize) -> Vec<f64> {
        let mut deviate = crate::tests::deviates(seed);
        (0..count).map(|_| size * deviate()).collect()
    }

    #[test]
    fn what_is_better_in_every_recording_is_alone_in_the_set_and_equals_stay_together() {
        let level = scatter(3, 0.5, 20);
        let plus = |by: f64, seed: u64| -> Vec<f64> { level.iter().zip(scatter(seed, 0.05, 20)).map(|(x, y)| x + y + by).collect() };
        let all = |better: f64| vec![scored(&[], plus(0.0, 5)), scored(&["creep"], plus(better, 6)), scored(&["resonance"], plus(0.0, 7))];
        let names = |set: Vec<Scored>| -> Vec<String> { set.iter().map(|one| one.names.join("+")).collect() };
        assert_eq!(names(confidence_set(all(0.2), MATERIAL[1], 1)), ["creep"]);
        let mut equal = names(confidence_set(all(0.0), MATERIAL[1], 1));
        equal.sort_unstable();
        assert_eq!(equal, ["", "creep", "resonance"]);
    }

    #[test]
    fn a_gain_that_differs_by_orders_of_magnitude_between_recordings_is_seen_and_one_recording_alone_decides_nothing() {
        let bare = scatter(8, 0.1, 16);
        let with = |gains: &dyn Fn(usize) -> f64| bare.iter().enumerate().map(|(at, value)| value + gains(at)).collect::<Vec<f64>>();
        let set =
            |densities: Vec<f64>| confidence_set(vec![scored(&[], bare.clone()), scored(&["creep"], densities)], MATERIAL[1], 1).len();
        assert_eq!(set(with(&|at| MATERIAL[1] + 1e-4 * 10_f64.powi(at as i32 % 5))), 1);
        assert_eq!(set(with(&|at| if at == 3 { 50.0 } else { 1e-3 * (at % 3) as f64 })), 2);
    }

    #[test]
    fn false_alarms_are_as_rare_as_the_level_says() {
        let alarms = (0..200_u64)
            .filter(|seed| {
                let one = |name: &'static [&'static str], offset: u64| scored(name, scatter(1 + 7 * seed + offset, 0.1, 12));
                let set =
                    confidence_set(vec![one(&[], 0), one(&["creep"], 1), one(&["resonance"], 2), one(&["leakage"], 3)], MATERIAL[1], 1);
                !set.iter().any(|member| member.names.is_empty())
            })
            .count();
        // The bare model is one of four that may leave: at most a tenth of the time, two standard deviations allowed.
        assert!(alarms <= 200 / 10 + 9, "{alarms} of 200");
    }

    #[test]
    fn who_is_behind_in_every_recording_leaves_the_race_and_who_is_ahead_in_one_or_second_does_not() {
        let race = |densities: usize, recordings: usize| {
            let level = scatter(4, 0.5, densities);
            let minus = |by: f64| level.iter().map(|value| value - by).collect::<Vec<f64>>();
            let mut ahead_in_one = minus(0.9);
            ahead_in_one[2] += 1.0;
            let of = [(vec![], minus(2.0)), (vec!["creep"], minus(0.0)), (vec!["leakage"], minus(0.4)), (vec!["resonance"], minus(0.5))];
            let all = of.into_iter().chain([(vec!["slew-limit"], ahead_in_one), (vec!["creep", "leakage"], minus(0.005))]);
            let all: Vec<Scored> =
                all.enumerate().map(|(index, (names, densities))| Scored { index, ..scored(&names, densities) }).collect();
            in_the_race(&all, recordings)
        };
        assert_eq!(race(10, 10), [0, 1, 4, 5]);
        assert_eq!(race(4, 4), [0, 1, 2, 3, 4, 5], "four recordings may all speak for one by chance");
        assert_eq!(race(10, 1), [0, 1, 2, 3, 4, 5], "stretches of one recording are no more than it");
    }

    #[test]
    fn a_member_with_more_effects_or_parameters_than_another_is_not_among_the_simplest() {
        // The second says the same as the third with more parameters, and a little better by chance.
        let fuller = Scored { parameters: 6, ..scored(&["creep"], vec![0.905]) };
        let set = [scored(&["creep", "leakage"], vec![1.0]), fuller, scored(&["creep"], vec![0.9]), scored(&["resonance"], vec![0.8])];
        let simple: Vec<(String, usize)> = simplest(&set, 0.01).iter().map(|one| (one.names.join("+"), one.parameters)).collect();
        assert_eq!(simple, [("creep".to_owned(), 1), ("resonance".to_owned(), 1)]);
    }

    #[test]
    fn the_hidden_effect_comes_first_and_where_nothing_is_hidden_the_bare_model_is_in_the_set() {
        for (hidden, delay_s) in [(vec!["dead-time".to_owned()], 0.1), (Vec::new(), 0.01)] {
            let case = rig::hide(&CaseConfig { effects: hidden.clone(), seed: 585, ..CaseConfig::default() }).expect("a case");
            let session = Session::new(&case.recordings[..12], &[]).expect("a session");
            let bare = Model::baseline(InitialState::carrying(case.truth.continuous), false);
            let delayed = bare.with(dead_time::FORMS[0], vec![delay_s]);
            let lagging = bare.with(pneumatic_lag::FORMS[0], vec![delay_s]);
            let compared = Comparison::new(&session, &[bare, delayed, lagging], 1, 2);
            if hidden.is_empty() {
                assert!(compared.holds_none(), "{:?}", compared.set);
            } else {
                assert!(compared.best() == 1 && compared.set[0].names == ["dead-time"], "{:?}", compared.set);
            }
        }
    }
}
