//! Seeing a tip's jumps in the measured output: what the observer follows from sample to sample (the terms are those of [`super::jumps`]).
//!
//! A history holds at a level until the quasi-static response has gone too far from it, or slides with it. What holds breaks away by the distance that
//! the quasi-static response has reached *since it holds*: a stick position that has held out a distance holds it out again, so a slow quasi-static response is no more dangerous than a
//! fast one over the same way. A tip slips from where it sat, by a travel that hardly scatters, and the very moment of a slip tells where it
//! sat and what the quasi-static response is wrong by: the distance lies between the one that was held out and the one that was not. A slip takes its time,
//! and a sample may see the tip on its way. The faster it is pulled the more slips a sample holds, until it slides; it goes on sliding at
//! speeds at which it would not begin to. Behind a step of the quasi-static response, which holds more slips than anyone counts and stops at once, it is
//! somewhere about the quasi-static response.
//!
//! What the slips tell of the quasi-static response, and what sliding tells, is what the quasi-static response's weights can be fitted to ([`PseudoMeasurement`]).

use crate::observers::law::{
    Expected, MODEL_ERROR_S, OUTLIER_DENSITY, PRUNING_THRESHOLD, PseudoMeasurement, Seen, SlipLaw, chance, density, inflation,
};

/// Histories of stick positions that are followed side by side.
const MOST_HYPOTHESES: usize = 4;

/// Slips of a tip within one sample that are counted one by one.
const SLIPS: usize = 3;

/// Deviations of the break-away distance below which nothing breaks away: a chance of one in a thousand million.
const CANNOT: f64 = -12.0;

/// Chance of one more slip within a sample below which none is looked for.
const NO_SLIP: f64 = 1e-3;

/// Speed at which what slides sticks, in sliding speeds: Stribeck's curve is steep between the two, and either motion keeps itself up there.
const STICKS_AT: f64 = 0.4;

/// Width of the transitions between slips and sliding, in sliding speeds.
const TRANSITION: f64 = 0.15;

/// Time within which a light tip stops, s: it runs on so far when the quasi-static response does, by no more than friction can hold.
const STOPS_S: f64 = 1e-3;

/// Scatter of a tip that slides, in that of its slips.
const SLIDING_SCATTER: f64 = 0.3;

/// Least way of the quasi-static response within which something breaks away.
const LEAST_STEP: f64 = 1e-6;

/// Points and reach, in deviations, by which moments of a normal deviate between bounds are summed.
const POINTS: usize = 16;

const REACH: f64 = 5.0;

/// Mean and variance of a normal deviate with this standard deviation that is known to lie between `low` and `high`.
fn between(low: f64, high: f64, deviation: f64) -> (f64, f64) {
    let (low, high) = (low / deviation, high / deviation);
    // Where it is likeliest, and as far from there as counts: in a tail the density falls the faster the farther out that is.
    let top = 0.0_f64.max(low).min(high);
    let reach = REACH / (1.0 + top.abs());
    let from = low.max(top - if top > 0.0 { 0.0 } else { reach });
    let to = high.min(top + if top < 0.0 { 0.0 } else { reach });
    let (mut sum, mut first, mut second) = (0.0, 0.0, 0.0);
    for point in 0..POINTS {
        let at = from + (to - from) * (point as f64 + 0.5) / POINTS as f64;
        let weight = (0.5 * (top * top - at * at)).exp();
        sum += weight;
        first += weight * at;
        second += weight * at * at;
    }
    let mean = first / sum;
    (mean * deviation, (second / sum - mean * mean).max(0.0) * deviation * deviation)
}

/// One history of stick positions: a filter for the level that it holds at and the model error of the quasi-static response.
#[derive(Clone, Copy, Debug)]
struct Hypothesis {
    weight: f64,
    level: f64,
    level_variance: f64,
    model_error: f64,
    model_error_variance: f64,
    covariance: f64,
    /// Direction in which it slides, or zero.
    moving: f64,
    /// Range of the quasi-static response since it holds.
    lowest: f64,
    highest: f64,
    /// Travel of the last slip, with its sign; how long ago it began, s, and the standard deviation of that.
    travel: f64,
    since_s: f64,
    since_deviation_s: f64,
    /// What of it is still to come, and the variance of that.
    to_come: f64,
    to_come_variance: f64,
    /// What the last slip told of the quasi-static response, and the one before it.
    pseudo_measurements: [Option<PseudoMeasurement>; 2],
}

/// Nothing known, and nothing on its way.
const AT_REST: Hypothesis = Hypothesis {
    weight: 0.0,
    level: 0.0,
    level_variance: 0.0,
    model_error: 0.0,
    model_error_variance: 0.0,
    covariance: 0.0,
    moving: 0.0,
    lowest: 0.0,
    highest: 0.0,
    travel: 0.0,
    since_s: f64::INFINITY,
    since_deviation_s: 0.0,
    to_come: 0.0,
    to_come_variance: 0.0,
    pseudo_measurements: [None; 2],
};

/// One sample as histories are moved on to it.
#[derive(Clone, Copy, Debug)]
struct Motion {
    sample: usize,
    /// Quasi-static response, now and before.
    quasi_static: f64,
    before: f64,
    break_away: f64,
    scatter: f64,
    /// How far behind the quasi-static response it slides, and the standard deviation with which it follows.
    behind: f64,
    follows: f64,
    /// Chance that what breaks away slides.
    slides: f64,
    /// Chance that what slides goes on.
    goes_on: f64,
    period_s: f64,
    /// How far a tip may run on, or stay behind, for the change of the quasi-static response's speed.
    inertial_uncertainty: f64,
}

impl Motion {
    /// At this sample the quasi-static response is at `quasi_static`, was at `before` a sample ago, and went by `last_step` in that one.
    fn new(sample: usize, law: &SlipLaw, quasi_static: f64, before: f64, last_step: f64, period_s: f64) -> Self {
        let speed = (quasi_static - before).abs() / period_s / law.sliding_speed;
        let break_away = law.break_away / (1.0 + law.rate_weakening * speed);
        let scatter = law.scatter * break_away;
        let inertial_uncertainty = (STOPS_S * ((quasi_static - before) - last_step).abs() / period_s).min(2.0 * law.break_away);
        let (slides, goes_on) = (chance((speed - 1.0) / TRANSITION), chance((speed - STICKS_AT) / TRANSITION));
        let (behind, follows) = (law.kinetic_friction * law.break_away, SLIDING_SCATTER * scatter);
        Self { sample, quasi_static, before, break_away, scatter, behind, follows, slides, goes_on, period_s, inertial_uncertainty }
    }

    fn step(&self) -> f64 {
        self.quasi_static - self.before
    }
}

impl Hypothesis {
    /// How far the quasi-static response is from the stick position, and the variance of that.
    fn stretch(&self, motion: &Motion) -> (f64, f64) {
        (
            motion.quasi_static + self.model_error - self.level,
            (self.level_variance + self.model_error_variance - 2.0 * self.covariance).max(0.0),
        )
    }

    /// The largest distance that it has held out, the quasi-static response being at this one.
    fn largest_load(&self, stretch: f64, motion: &Motion) -> f64 {
        if stretch > 0.0 { stretch - (motion.quasi_static - self.highest) } else { -stretch - (self.lowest - motion.quasi_static) }
    }

    /// Chance that it breaks away now by this stretch, after it has held out where the quasi-static response has been since it holds.
    fn breaks_away(&self, (stretch, variance): (f64, f64), motion: &Motion) -> f64 {
        let spread = (motion.scatter * motion.scatter + variance).sqrt().max(1e-9);
        let deviations = (stretch.abs() - motion.break_away) / spread;
        if deviations < CANNOT {
            return 0.0;
        }
        let before = chance((self.largest_load(stretch, motion) - motion.break_away) / spread);
        let now = chance(deviations);
        ((now - before) / (1.0 - before).max(1e-12)).max(0.0)
    }

    /// The same one sliding.
    fn sliding(&self, weight: f64, motion: &Motion) -> Self {
        Self {
            weight,
            level: motion.quasi_static + self.model_error - motion.step().signum() * motion.behind,
            level_variance: self.model_error_variance
                + motion.follows * motion.follows
                + motion.inertial_uncertainty * motion.inertial_uncertainty,
            covariance: self.model_error_variance,
            moving: motion.step().signum(),
            ..self.arrived()
        }
    }

    /// The same one with nothing of its slip to come.
    const fn arrived(&self) -> Self {
        Self { since_s: f64::INFINITY, to_come: 0.0, to_come_variance: 0.0, ..*self }
    }

    /// The same one with what is to come of a slip that takes so long and began no later than `latest_s` ago: half a swing on a spring.
    fn on_its_way(self, slip_s: f64, latest_s: f64) -> Self {
        if self.since_s >= slip_s {
            return self.arrived();
        }
        // A normal deviate in three points (Gauss and Hermite).
        let reach = 3.0_f64.sqrt() * self.since_deviation_s;
        let (mut mean, mut square) = (0.0, 0.0);
        for (weight, off) in [(2.0 / 3.0, 0.0), (1.0 / 6.0, reach), (1.0 / 6.0, -reach)] {
            let since_s = (self.since_s + off).clamp(latest_s, slip_s);
            let left = 0.5 + 0.5 * (std::f64::consts::PI * since_s / slip_s).cos();
            mean += weight * left;
            square += weight * left * left;
        }
        let to_come_variance = (square - mean * mean).max(0.0) * self.travel * self.travel;
        Self { to_come: mean * self.travel, to_come_variance, ..self }
    }

    /// Where it is seen: on the way to its level, if it slips.
    fn seen(&self) -> f64 {
        self.level - self.to_come
    }

    /// The same one after a slip of the tip.
    ///
    /// It bore a load of `largest_load`, and no longer the one that the quasi-static response has reached: the distance by which it breaks away lies between
    /// the two. That is a measurement of level, model error and distance together, as good as the sample is short; the tip then lands so far from
    /// where it sat.
    fn slipped(&self, direction: f64, largest_load: f64, law: &SlipLaw, motion: &Motion) -> Self {
        let (stretch, variance) = self.stretch(motion);
        let stretch = stretch * direction;
        let of_distance = motion.scatter * motion.scatter;
        let whole = (variance + of_distance).max(1e-18);
        let largest_load = largest_load.min(stretch - LEAST_STEP);
        // The error of the stretch less that of the distance.
        let (error, left) = between(motion.break_away - stretch, motion.break_away - largest_load, whole.sqrt());
        let (gain, sure) = (error / whole, (1.0 - left / whole) / whole);
        let with_level = direction * (self.covariance - self.level_variance);
        let with_model_error = direction * (self.model_error_variance - self.covariance);
        let distance = motion.break_away - of_distance * gain;
        // Slip overshoot is the level and the distance after the measurement; the variances are those of their sum. What a fast quasi-static response breaks away
        // by less it lands farther beyond: the travel stays, but for what its law says.
        let travel = (1.0 + law.overshoot) * law.break_away + law.slip_per_speed_s * motion.step().abs() / motion.period_s;
        let beyond = travel - motion.break_away;
        let with_overshoot = with_level - direction * of_distance;
        let per_way_s = motion.period_s / motion.step().abs().max(LEAST_STEP);
        let pseudo_measurements = PseudoMeasurement {
            sample: motion.sample,
            direction,
            // Where in the sample it broke away is not known.
            quasi_static: self.level + direction * (motion.break_away + 0.5 * (stretch - largest_load)),
            variance: self.level_variance + of_distance + (stretch - largest_load).powi(2) / 12.0,
        };
        let landed = Self {
            level: self.level + with_level * gain + direction * (distance + beyond),
            level_variance: self.level_variance + of_distance - with_overshoot * with_overshoot * sure,
            model_error: self.model_error + with_model_error * gain,
            model_error_variance: self.model_error_variance - with_model_error * with_model_error * sure,
            covariance: self.covariance - with_model_error * with_overshoot * sure,
            moving: 0.0,
            travel: direction * travel,
            since_s: ((stretch - motion.break_away + error) * per_way_s).clamp(0.0, motion.period_s),
            since_deviation_s: left.sqrt() * per_way_s,
            pseudo_measurements: [Some(pseudo_measurements), self.pseudo_measurements[0]],
            ..*self
        };
        landed.on_its_way(law.slip_s, 0.0)
    }

    /// The same one after more slips than anyone counts: it holds somewhere about the quasi-static response.
    fn landed(&self, weight: f64, motion: &Motion) -> Self {
        let level_variance = self.model_error_variance
            + motion.break_away * motion.break_away / 3.0
            + motion.inertial_uncertainty * motion.inertial_uncertainty;
        let somewhere = Self {
            level: motion.quasi_static + self.model_error,
            level_variance,
            covariance: self.model_error_variance,
            moving: 0.0,
            ..self.arrived()
        };
        somewhere.holding(weight, motion.quasi_static)
    }

    /// The same one, beginning to hold where it is while the quasi-static response is there.
    const fn holding(self, weight: f64, quasi_static: f64) -> Self {
        Self { weight, lowest: quasi_static, highest: quasi_static, ..self }
    }

    /// Learns from a measured sample; what this one's likelihood becomes.
    fn learn(&mut self, measured: f64, noise: f64, total: f64) -> f64 {
        if self.weight < PRUNING_THRESHOLD {
            self.weight = 0.0;
            return 0.0;
        }
        let whole = self.level_variance + self.to_come_variance + noise * noise;
        let error = measured - self.seen();
        let ours = density(error, whole);
        self.weight *= (ours + OUTLIER_DENSITY) / total;
        let trust = ours / (ours + OUTLIER_DENSITY);
        let (of_level, of_model_error) = (self.level_variance / whole * trust, self.covariance / whole * trust);
        self.level += of_level * error;
        self.model_error += of_model_error * error;
        self.model_error_variance -= of_model_error * self.covariance;
        self.covariance *= 1.0 - of_level;
        self.level_variance *= 1.0 - of_level;
        let unsure = inflation(trust, error);
        self.level_variance += unsure;
        self.model_error_variance += unsure;
        self.covariance += unsure;
        self.weight
    }

    /// What this history, the surest of all, tells of the quasi-static response by sliding after it, or by having slipped in the last sample and been seen since;
    /// and by having held where a quasi-static response that reaches as far would have taken it along.
    fn tells(&self, measured: f64, noise: f64, motion: &Motion) -> Vec<PseudoMeasurement> {
        if self.moving != 0.0 {
            let (quasi_static, variance) = (measured + self.moving * motion.behind, noise * noise + motion.follows * motion.follows);
            return vec![PseudoMeasurement { sample: motion.sample, direction: self.moving, quasi_static, variance }];
        }
        let mut pseudo_measurements: Vec<PseudoMeasurement> = self
            .pseudo_measurements
            .into_iter()
            .flatten()
            .filter(|pseudo_measurements| pseudo_measurements.sample + 1 == motion.sample)
            .collect();
        let holds_since = self.pseudo_measurements[0].map_or(0, |pseudo_measurements| pseudo_measurements.sample + 2);
        let stretch = motion.before - self.level;
        if motion.sample > holds_since && stretch.abs() > motion.break_away {
            let direction = stretch.signum();
            let variance = self.level_variance + motion.scatter * motion.scatter;
            pseudo_measurements.push(PseudoMeasurement {
                sample: motion.sample - 1,
                direction,
                quasi_static: self.level + direction * motion.break_away,
                variance,
            });
        }
        pseudo_measurements
    }
}

/// The likeliest hypotheses of stick positions under one law.
struct Hypotheses<'a> {
    law: &'a SlipLaw,
    all: [Hypothesis; MOST_HYPOTHESES],
    /// What stays of the model error from sample to sample, and the variance of what comes to it.
    stay: f64,
    kick: f64,
}

impl Hypotheses<'_> {
    /// Takes one in for the least likely one.
    fn add(&mut self, history: Hypothesis) {
        let of = &self.all;
        let weakest = (0..MOST_HYPOTHESES).min_by(|&x, &y| of[x].weight.total_cmp(&of[y].weight)).unwrap_or(0);
        if history.weight > self.all[weakest].weight {
            self.all[weakest] = history;
        }
    }

    /// Moves all of them on to the next sample.
    fn move_on(&mut self, motion: &Motion) {
        let law = self.law;
        let mut leaves = [0.0; MOST_HYPOTHESES];
        let mut stretches = [0.0; MOST_HYPOTHESES];
        let mut largest_load = [0.0; MOST_HYPOTHESES];
        // All that slide are in the same place: one history for them, with the initial state of the likeliest.
        let (mut sliding, mut slider) = (0.0, self.all[0]);
        let mut most = 0.0;
        for (at, history) in self.all.iter_mut().enumerate().filter(|(_, history)| history.weight >= PRUNING_THRESHOLD) {
            history.model_error *= self.stay;
            history.model_error_variance = self.stay * self.stay * history.model_error_variance + self.kick;
            history.covariance *= self.stay;
            history.since_s += motion.period_s;
            *history = history.on_its_way(law.slip_s, motion.period_s);
            if history.moving != 0.0 {
                let goes_on = if history.moving * motion.step() > 0.0 { motion.goes_on * history.weight } else { 0.0 };
                sliding += goes_on;
                if goes_on > most {
                    (most, slider) = (goes_on, *history);
                }
                *history = Self::stuck(*history, goes_on, motion);
            }
            history.level += law.presliding * motion.step();
            let (stretch, variance) = history.stretch(motion);
            (stretches[at], largest_load[at]) = (stretch, history.largest_load(stretch, motion));
            leaves[at] = history.weight * history.breaks_away((stretch, variance), motion);
            history.weight -= leaves[at];
            history.lowest = history.lowest.min(motion.quasi_static);
            history.highest = history.highest.max(motion.quasi_static);
        }
        // So are all that break away.
        let leaving: f64 = leaves.iter().sum();
        let parent = (0..MOST_HYPOTHESES).max_by(|&x, &y| leaves[x].total_cmp(&leaves[y])).unwrap_or(0);
        let (mut history, direction) = (self.all[parent], stretches[parent].signum());
        let slides = leaving * motion.slides;
        if sliding + slides > PRUNING_THRESHOLD {
            let initial_state = if slides > most { &history } else { &slider };
            let slider = initial_state.sliding(sliding + slides, motion);
            self.add(slider);
        }
        let mut left = leaving - slides;
        for slip in 1..=SLIPS {
            if left < PRUNING_THRESHOLD {
                break;
            }
            // What has just landed has held out no more than where it landed.
            let before = if slip == 1 { largest_load[parent] } else { history.stretch(motion).0 * direction - motion.step().abs() };
            history = history.slipped(direction, before, law, motion);
            let (stretch, variance) = history.stretch(motion);
            let spread = (motion.scatter * motion.scatter + variance).sqrt().max(1e-9);
            let again = chance((stretch * direction - motion.break_away) / spread);
            let again = if again > NO_SLIP { again } else { 0.0 };
            self.add(history.holding(left * (1.0 - again), motion.quasi_static));
            left *= again;
        }
        if left > PRUNING_THRESHOLD {
            self.add(history.landed(left, motion));
        }
    }

    /// What slid until now without the share that goes on: it holds where it was.
    const fn stuck(history: Hypothesis, goes_on: f64, motion: &Motion) -> Hypothesis {
        let held = history.holding(history.weight - goes_on, motion.before);
        Hypothesis { moving: 0.0, level_variance: held.level_variance + motion.inertial_uncertainty * motion.inertial_uncertainty, ..held }
    }
}

/// What the observer of a tip expects of every sample.
pub fn observe(seen: &Seen<'_>, law: &SlipLaw) -> Expected {
    let stay = (-seen.period_s / MODEL_ERROR_S).exp();
    let (mut before, mut last_step) = (seen.quasi_static[0], 0.0);
    let first = Hypothesis {
        weight: 1e-12,
        level: before + law.begins,
        level_variance: law.break_away * law.break_away + law.model_error * law.model_error,
        model_error_variance: law.model_error * law.model_error,
        lowest: before,
        highest: before,
        ..AT_REST
    };
    let kick = law.model_error * law.model_error * (1.0 - stay * stay);
    let mut hypotheses = Hypotheses { law, all: [first; MOST_HYPOTHESES], stay, kick };
    hypotheses.all[0].weight = 1.0;
    let mut expected = Expected::default();
    for sample in 0..seen.measured.len() {
        let motion = Motion::new(sample, law, seen.quasi_static[sample], before, last_step, seen.period_s);
        (before, last_step) = (motion.quasi_static, motion.step());
        hypotheses.move_on(&motion);
        let all = &mut hypotheses.all;
        let total: f64 = all.iter().map(|history| history.weight).sum();
        let mean = all.iter().map(|history| history.weight * history.seen()).sum::<f64>() / total;
        let own = |history: &Hypothesis| history.level_variance + history.to_come_variance;
        let spread = |history: &Hypothesis| history.weight * (own(history) + (history.seen() - mean).powi(2));
        expected.mean.push(mean);
        expected.variance.push(all.iter().map(spread).sum::<f64>() / total);
        if !seen.keep[sample] {
            expected.log_likelihood.push(0.0);
            continue;
        }
        let likelihood: f64 = all.iter_mut().map(|history| history.learn(seen.measured[sample], seen.noise, total)).sum();
        expected.log_likelihood.push(likelihood.ln());
        for history in all.iter_mut() {
            history.weight = (history.weight / likelihood).max(1e-12);
        }
        if let Some(surest) = all.iter().max_by(|x, y| x.weight.total_cmp(&y.weight)) {
            expected.pseudo_measurements.append(&mut surest.tells(seen.measured[sample], seen.noise, &motion));
        }
    }
    expected
}

#[cfg(test)]
mod tests;
