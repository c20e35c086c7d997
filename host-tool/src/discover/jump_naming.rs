//! Naming what jumps: a sticking tip or a valve with a dead band, where nothing smooth explains the recordings.
//!
//! All are judged by the same measure, the likelihood of each sample after those before it ([`super::jumps`]), on recordings that took no
//! part in fitting: the best smooth explanation that the search has found, and the jumps of either kind. A smooth observer may read slow
//! errors from the output just as a jump observer may read seats, so jumps win by holding still and leaping alone.

use super::catalogue::Form;
use super::find::Outcome;
use super::jumps::{self, Drive, Expected, JumpLaw, NEVER, Seen};
use super::model::{Model, Scope};
use super::rounds::{self, Bench};
use super::session::{Role, Run, Session};
use super::{Candidate, RunnerUp, effects, noise, tail, verdict};

/// Blocked deviations by which jumps must beat everything smooth. Smooth laws that the catalogue lacks come near what holds and moves, so
/// chance is not what this guards against.
const LEAST_DEVIATIONS: f64 = 5.0;
/// The same where the logarithm of the likelihood ratio is [`LARGE_EVIDENCE`] per sample: what slow strokes show, and fast ones do not, is
/// uneven by nature.
const LEAST_DEVIATIONS_OF_LARGE: f64 = 3.0;
/// Logarithm of a likelihood ratio, per sample, that chance does not reach.
const LARGE_EVIDENCE: f64 = 0.1;
/// Logarithm of the likelihood ratio, per sample, that jumps must reach.
const LEAST_EVIDENCE: f64 = 0.01;
/// Largest wander of the pull, in break-away distances: with more, holding says nothing.
const MOST_WANDER: f64 = 0.4;
/// Least break-away distance, in deviations of the noise: shorter ones cannot be seen.
const LEAST_BREAK_AWAY: f64 = 2.0;
/// Blocked deviations by which one kind of jumps must beat the other to be told from it.
const APART: f64 = 2.0;
/// Levels of the output at each of which the evidence must be for jumps: friction and valves hold everywhere, a wall at one place.
const LEVELS: usize = 4;

/// A model's pull and the noise for the observers.
struct Pull<'a> {
    session: &'a Session,
    values: Vec<Vec<f64>>,
    /// Its range.
    low: f64,
    high: f64,
    noise: f64,
    /// Root mean square of what the pull misses beyond the noise.
    excess: f64,
}

/// Evidence on the selecting samples.
struct Evidence {
    /// Mean of every second.
    blocks: Vec<f64>,
    /// Mean at every level of the output while it moves.
    levels: [f64; LEVELS],
}

impl Evidence {
    fn mean(&self) -> f64 {
        self.blocks.iter().sum::<f64>() / self.blocks.len().max(1) as f64
    }

    /// Whether it is more than `less` at every level.
    fn is_above_everywhere(&self, less: &Self) -> bool {
        self.levels.iter().zip(&less.levels).all(|(more, less)| more > less)
    }
}

/// A law with the evidence for it.
struct Judged {
    evidence: Evidence,
    form: &'static dyn Form,
    law: JumpLaw,
}

impl Judged {
    /// The best law of this form.
    fn new(session: &Session, base: &Model, form: &'static dyn Form, noise: f64) -> Self {
        let drive = form.jumps().unwrap_or(Drive::Pull);
        // The lag of what moves shows in the mean, whatever its seats.
        let lagging = lags(drive).iter().map(|&lag_s| {
            let mut lagging = if lag_s > 0.0 { base.with(effects::pneumatic_lag::FORMS[0], vec![lag_s]) } else { base.clone() };
            let (fit, _) = lagging.fit(session, Scope::Both);
            (fit, lagging, lag_s)
        });
        let (_, lagging, lag_s) = lagging.min_by(|x, y| x.0.total_cmp(&y.0)).unwrap_or_else(|| (0.0, base.clone(), 0.0));
        let pull = Pull::new(session, &lagging, noise);
        let law = pull.law(drive, lag_s);
        Self { evidence: pull.selecting(|seen| jumps::observe(seen, &law).evidence), form, law }
    }
}

impl<'a> Pull<'a> {
    fn new(session: &'a Session, model: &Model, noise: f64) -> Self {
        let values: Vec<Vec<f64>> = session.runs.iter().map(|run| model.predict(run)).collect();
        let (mut sum, mut count) = (0.0, 1.0);
        for (run, values) in session.runs.iter().zip(&values) {
            for sample in (0..values.len()).filter(|&sample| run.keep[sample] && run.role[sample] == Role::Fit) {
                sum += (run.output[sample] - values[sample]).powi(2);
                count += 1.0;
            }
        }
        let excess = (sum / count - noise * noise).max(0.04 * noise * noise).sqrt();
        let all = || values.iter().flatten().copied();
        let (low, high) = (all().fold(f64::MAX, f64::min), all().fold(f64::MIN, f64::max));
        Self { session, values, low, high, noise, excess }
    }

    fn seen<'b>(&'b self, run: &'b Run) -> Seen<'b> {
        let pull = &self.values[run.index];
        Seen { command: &run.input, pull, measured: &run.output, keep: &run.keep, period_s: run.period_s, noise: self.noise }
    }

    /// Sum of the evidence on the fitted samples, of the screening recordings only unless `all`.
    fn fitted(&self, all: bool, evidence: impl Fn(&Seen<'_>) -> Vec<f64>) -> f64 {
        let runs = self.session.runs.iter().filter(|run| (all || run.screens) && run.role.contains(&Role::Fit));
        runs.map(|run| {
            let of = evidence(&self.seen(run));
            of.iter().zip(&run.role).filter(|(_, role)| **role == Role::Fit).map(|(value, _)| value).sum::<f64>()
        })
        .sum()
    }

    /// Evidence on the selecting samples.
    fn selecting(&self, evidence: impl Fn(&Seen<'_>) -> Vec<f64>) -> Evidence {
        let mut blocks = Vec::new();
        let mut sums = [(0.0, 1e-30); LEVELS];
        for run in self.session.runs.iter().filter(|run| run.role.contains(&Role::Select)) {
            let of = evidence(&self.seen(run));
            let length = (1.0 / run.period_s).round().max(4.0) as usize;
            for (block, roles) in of.chunks(length).zip(run.role.chunks(length)) {
                if roles.iter().all(|role| *role == Role::Select) {
                    blocks.push(block.iter().sum::<f64>() / block.len() as f64);
                }
            }
            let moves = |sample: usize| sample > 0 && run.input[sample] != run.input[sample - 1];
            for sample in (0..of.len()).filter(|&sample| run.role[sample] == Role::Select && moves(sample)) {
                let level = ((self.values[run.index][sample] - self.low) / (self.high - self.low) * LEVELS as f64).floor();
                let (sum, count) = &mut sums[level.clamp(0.0, LEVELS as f64 - 1.0) as usize];
                *sum += of[sample];
                *count += 1.0;
            }
        }
        Evidence { blocks, levels: sums.map(|(sum, count)| sum / count) }
    }

    /// The best smooth observer of this pull, by the selecting samples.
    fn smooth(&self) -> Evidence {
        let wanders = [0.4, 0.7, 1.0, 1.4].map(|share| share * self.excess);
        let grid = wanders.into_iter().flat_map(|wander| [0.04, 0.1, 0.25, 0.6, 2.0].map(|time_s| (wander, time_s)));
        let judged = grid.map(|(wander, time_s)| (self.fitted(false, |seen| jumps::smooth(seen, wander, time_s)), wander, time_s));
        let (_, wander, time_s) = judged.max_by(|x, y| x.0.total_cmp(&y.0)).unwrap_or((0.0, self.excess, 0.25));
        self.selecting(|seen| jumps::smooth(seen, wander, time_s))
    }

    /// The best law of jumps that break away by `drive`.
    fn law(&self, drive: Drive, lag_s: f64) -> JumpLaw {
        // Landing beyond the drive and never sliding, or landing on it and sliding with it.
        const KINDS: [(f64, f64); 7] = [(1.0, NEVER), (0.7, NEVER), (0.4, NEVER), (0.0, 0.1), (0.0, 0.3), (0.0, 0.8), (0.0, NEVER)];
        let evidence = |law: &JumpLaw, all: bool| self.fitted(all, |seen| jumps::observe(seen, law).evidence);
        let better = |best: (f64, JumpLaw), law: JumpLaw, all: bool| {
            if law.break_away < LEAST_BREAK_AWAY * self.noise {
                return best;
            }
            let law = JumpLaw { wander: law.wander.min(MOST_WANDER * law.break_away), ..law };
            let value = evidence(&law, all);
            if value > best.0 { (value, law) } else { best }
        };
        let (scatter, wander) = (0.25, 0.5 * self.excess);
        let first = JumpLaw { drive, break_away: 0.16, landing: 0.0, sliding_speed: NEVER, scatter, wander, lag_s };
        let mut best = (f64::MIN, first);
        for break_away in super::effects::ladder(0.01, 0.16, 10) {
            for (landing, sliding_speed) in KINDS {
                best = better(best, JumpLaw { break_away, landing, sliding_speed, ..first }, false);
            }
        }
        best.0 = evidence(&best.1, true);
        for size in [0.15, 0.07, 0.035] {
            for sign in [-size, size] {
                let here = best.1;
                best = better(best, JumpLaw { break_away: here.break_away * (1.0 + sign), ..here }, true);
                let here = best.1;
                best = better(best, JumpLaw { landing: (here.landing + sign).clamp(0.0, 1.0), ..here }, true);
                let here = best.1;
                best = better(best, JumpLaw { scatter: here.scatter * (1.0 + 4.0 * sign), ..here }, true);
                let here = best.1;
                best = better(best, JumpLaw { wander: here.wander * (1.0 + 4.0 * sign), ..here }, true);
                if best.1.sliding_speed < NEVER {
                    let here = best.1;
                    best = better(best, JumpLaw { sliding_speed: here.sliding_speed * (1.0 + 3.0 * sign), ..here }, true);
                }
            }
        }
        best.1
    }
}

/// Lags that are tried for what moves, s: a light tip on its spring follows within milliseconds, a valve's flow takes longer.
fn lags(drive: Drive) -> &'static [f64] {
    match drive {
        Drive::Pull => &[0.0, 0.004, 0.008],
        Drive::Command => &[0.0, 0.01, 0.02, 0.03, 0.045],
    }
}

/// Deviations by which `more` lies above `less`, block by block.
fn above(more: &Evidence, less: &Evidence) -> f64 {
    rounds::deviations(&more.blocks, &less.blocks)
}

/// Puts jumps in the place of what was found, where that leaves too much and jumps explain the recordings better than it; `base` is the model
/// before the search.
pub fn rename(bench: &Bench<'_>, base: &Model, outcome: Outcome) -> Outcome {
    let session = bench.session;
    let forms: Vec<&'static dyn Form> = bench.forms.iter().copied().filter(|form| form.jumps().is_some()).collect();
    let mut base = base.refined();
    base.fit(session, Scope::Both);
    let base = base.pruned();
    if forms.is_empty() || !verdict::is_unexplained(session, &base, &outcome.model) {
        return outcome;
    }
    let noise = noise::floor(session, &outcome.model.residuals(session));
    let mut judged = rounds::in_parallel(&forms, bench.threads, |form| Judged::new(session, &base, *form, noise));
    judged.sort_by(|x, y| y.evidence.mean().total_cmp(&x.evidence.mean()));
    let smooth_base = Pull::new(session, &base, noise).smooth();
    let found = Pull::new(session, &outcome.model, noise).smooth();
    // A valve that the search has found jumps too, and no tip: its simulation saw no more of the output than where the pressure began.
    let simulated = outcome.found.order == ["valve-dead-band"];
    let best = judged.iter().find(|one| !simulated || one.form.name() == "valve-dead-band").unwrap_or(&judged[0]);
    let evidence = if simulated && found.mean() > best.evidence.mean() { &found } else { &best.evidence };
    let smooth = if simulated || smooth_base.mean() > found.mean() { &smooth_base } else { &found };
    let deviations = above(evidence, smooth);
    let gain = evidence.mean() - smooth.mean();
    let least = if gain > LARGE_EVIDENCE { LEAST_DEVIATIONS_OF_LARGE } else { LEAST_DEVIATIONS };
    if deviations < least || gain < LEAST_EVIDENCE || !evidence.is_above_everywhere(smooth) {
        return outcome;
    }
    let first_select = base.clone().fit(session, Scope::Both).1;
    let mut model = base.with(best.form, best.law.as_parameters(noise));
    let (_, select) = model.fit(session, Scope::Both);
    let scatter = scatter(session, best, &model, noise);
    let mut outcome = outcome;
    let name = best.form.name();
    let other = judged.iter().find(|one| one.form.name() != name);
    if let Some(other) = other {
        outcome.found.apart = above(evidence, &other.evidence);
        let separable = outcome.found.apart > APART;
        outcome.found.twins = !separable;
        outcome.found.runner_up = Some(RunnerUp { name: other.form.name().to_owned(), separable });
        let mut second = base.with(other.form, other.law.as_parameters(noise));
        second.fit(session, Scope::Both);
        outcome.second = Some(second);
    }
    outcome.found.jump_scatter = Some(scatter);
    outcome.found.candidates.retain(|candidate| candidate.name != name);
    outcome.found.candidates.insert(0, Candidate { name: name.to_owned(), score: 1.0 - select / first_select, p_value: tail(deviations) });
    if !simulated {
        outcome.found.order = vec![name];
        outcome.model = model;
    }
    outcome
}

/// Mean square by which the observer expects to miss, without the noise.
fn scatter(session: &Session, judged: &Judged, model: &Model, noise: f64) -> f64 {
    let slot = model.slots.iter().position(|slot| slot.form.form() == judged.form.form()).unwrap_or(0);
    let (mut sum, mut count) = (0.0, 1e-30);
    let pull = Pull::new(session, &model.without(slot), noise);
    for run in session.runs.iter().filter(|run| !run.role.contains(&Role::Kept)) {
        let Expected { variance, .. } = jumps::observe(&pull.seen(run), &judged.law);
        sum += variance.iter().sum::<f64>();
        count += variance.len() as f64;
    }
    sum / count
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::path::Path;

    use crate::discover::{DiscoverConfig, Discovery, Verdict, discover};
    use crate::recording::{Recording, Signal};
    use crate::rig::{self, CaseConfig, Generator};

    /// Twelve decaying sines of a closed-form rig: three play operators, and a tip on a stick band of 0.5 mm that jumps by 0.35 mm. The full
    /// stroke is about 8 mm and the noise 0.5 % of it.
    fn stick_band(band_mm: f64, travel_mm: f64) -> Vec<Recording> {
        const STEPS: usize = 40;
        let mut kept = 0x2545_F491_4F6C_DD1D_u64;
        let mut noise = move || {
            // Sum of twelve uniform deviates: variance one.
            (0..12).fold(-6.0, |sum, _| {
                kept ^= kept << 13;
                kept ^= kept >> 7;
                kept ^= kept << 17;
                sum + (kept >> 11) as f64 / (1_u64 << 53) as f64
            })
        };
        let command = |frequency_hz: f64, decay_per_s: f64, time_s: f64| {
            let time_s = (time_s - 2.0_f64).max(0.0);
            1.4 * (-decay_per_s * time_s).exp() * (1.0 - (std::f64::consts::TAU * frequency_hz * time_s).cos())
        };
        let mut record = |index: u32| {
            let (frequency_hz, decay_per_s) = ([0.15, 0.3, 0.5, 0.7][(index % 4) as usize], [0.02, 0.06, 0.12][(index / 4) as usize]);
            let mut plays = [(0.1, 1.2, 0.0), (0.35, 0.9, 0.0), (0.8, 0.9, 0.0)];
            let mut place_mm: f64 = 0.0;
            let (mut times, mut inputs, mut outputs) = (Vec::new(), Vec::new(), Vec::new());
            for step in 0..1100 * STEPS {
                let time_s = step as f64 * 0.02 / STEPS as f64;
                let input = command(frequency_hz, decay_per_s, time_s);
                let pull_mm: f64 = plays
                    .iter_mut()
                    .map(|(threshold, weight, state)| {
                        *state = f64::max(*state, input - *threshold).min(input + *threshold);
                        *weight * *state
                    })
                    .sum();
                let stretch_mm = pull_mm - place_mm;
                if band_mm > 0.0 && stretch_mm.abs() > band_mm {
                    place_mm = pull_mm - stretch_mm.signum() * (band_mm - travel_mm);
                } else if band_mm <= 0.0 {
                    place_mm = pull_mm;
                }
                if step % STEPS == 0 {
                    times.push(time_s);
                    inputs.push(input);
                    outputs.push(place_mm + 0.035 * noise());
                }
            }
            let path = format!("run{index:02}.csv");
            Recording::new(Path::new(&path), Signal::pressure_bar(), Signal::displacement_mm(), times, inputs, outputs)
                .expect("a recording")
        };
        (0..12).map(&mut record).collect()
    }

    fn found(recordings: &[Recording]) -> Discovery {
        discover(recordings, &[], &DiscoverConfig { most_effects: 1, ..DiscoverConfig::default() }).expect("a finding").discovery
    }

    #[test]
    fn a_stick_band_in_closed_form_is_named_with_its_travel() {
        let (band_mm, travel_mm) = (0.5, 0.35);
        let discovery = found(&stick_band(band_mm, travel_mm));
        assert_eq!(discovery.verdict, Verdict::Named, "{:?}", discovery.effects);
        assert_eq!(discovery.effects[0].name, "stick-slip");
        let parameters: &BTreeMap<String, f64> = &discovery.effects[0].parameters;
        let found_mm = parameters["travel_mm"];
        assert!((found_mm / travel_mm - 1.0).abs() < 0.05, "{found_mm} instead of {travel_mm}; {parameters:?}");
        assert!(discovery.gap_closed > 0.5, "{}", discovery.gap_closed);
    }

    #[test]
    fn without_a_band_the_same_rig_has_no_jumps() {
        let discovery = found(&stick_band(0.0, 0.0));
        assert_eq!(discovery.verdict, Verdict::None, "{:?}", discovery.effects);
    }

    #[test]
    fn what_jumps_in_either_virtual_rig_is_named() {
        let cases = [
            (Generator::Physics, "stick-slip", 531),
            (Generator::Physics, "valve-dead-band", 530),
            (Generator::Rival, "stick-slip", 530),
            (Generator::Rival, "valve-dead-band", 530),
        ];
        for (generator, effect, seed) in cases {
            let case =
                rig::hide(&CaseConfig { effects: vec![effect.to_owned()], seed, generator, ..CaseConfig::default() }).expect("a case");
            let discovery = found(&case.recordings);
            let name = discovery.effects.first().map(|effect| effect.name.as_str());
            assert_eq!(name, Some(effect), "{generator:?}: {discovery:?}");
            assert_ne!(discovery.verdict, Verdict::Unknown, "{generator:?}, {effect}: {discovery:?}");
        }
    }
}
