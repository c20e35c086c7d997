//! Seeing a valve's jumps in the measured output: an observer of a pressure that holds while the error is inside a band.
//!
//! The valve opens when the error between command and pressure passes its band, the pressure follows through it with a time constant, and it
//! closes when little error is left: the law of the simulated form ([`super::effects::valve_dead_band`]), whose pressure hangs on everything
//! before. Here each history knows at which pressure it holds; what is measured while it holds mends that, and an opening that comes
//! earlier or later than foretold makes a history of its own, so an error of the law does not add up from one jump to the next.
//! The terms are those of [`super::jumps`]; the *stick position* is the pressure.

use crate::chain::columns::Bank;
use crate::observers::law::{Expected, MODEL_ERROR_S, OUTLIER_DENSITY, PRUNING_THRESHOLD, Seen, SlipLaw, chance, density, inflation};

/// Histories of the valve that are followed side by side.
const MOST_HYPOTHESES: usize = 6;

/// One history of the valve: the pressure that it holds, with a filter for the level of the output there and the model error of the quasi-static response.
#[derive(Clone, Copy, Debug, Default)]
struct Hypothesis {
    weight: f64,
    /// Pressure, in the units of the command.
    stick_position: f64,
    open: bool,
    /// Level of the output, without noise.
    level: f64,
    model_error: f64,
    /// Variances of level, model error and stick position, and the covariances of the level with model error and stick position.
    level_variance: f64,
    model_error_variance: f64,
    stick_position_variance: f64,
    with_model_error: f64,
    with_stick_position: f64,
}

/// Share of the way within a sample by which the moment of an opening is uncertain.
const MOMENT: f64 = 0.2;

impl Hypothesis {
    /// Lets the pressure follow a command that goes from `from` to `to` within `left_s`, until it closes.
    fn follow(&mut self, law: &SlipLaw, from: f64, to: f64, left_s: f64) {
        let valve = law.valve();
        let (pressure, open, keeps) = valve.pass(self.stick_position, from, to, left_s);
        (self.stick_position, self.open) = (pressure, open);
        self.stick_position_variance *= keeps * keeps;
        if !self.open {
            self.stick_position_variance = (law.scatter * valve.closing).powi(2);
        }
    }

    /// The level that a pressure which has just moved makes: what the muscle makes of it, or where something else makes the quasi-static response, too, the quasi-static response
    /// and how far the error from the pressure that it is made by is from the middle of the band.
    fn land(
        &mut self,
        law: &SlipLaw,
        muscle: Option<&mut Muscle>,
        (quasi_static, followed): (f64, f64),
        gain: f64,
        direction: f64,
        moved: f64,
    ) {
        let made = match muscle {
            Some(muscle) => muscle.at(self.stick_position),
            None => quasi_static + gain * (direction * law.overshoot * law.break_away - (followed - self.stick_position)),
        };
        self.level = made + self.model_error;
        // One that has closed again did so where its law says, whenever it opened.
        let scatter = self.stick_position_variance + if self.open { (MOMENT * moved).powi(2) } else { 0.0 };
        self.stick_position_variance = scatter;
        self.with_stick_position = gain * scatter;
        self.with_model_error = self.model_error_variance;
        self.level_variance = self.model_error_variance + gain * gain * (scatter + (law.scatter * law.break_away).powi(2));
    }

    /// Takes in a measured sample; the likelihood of it.
    fn learn(&mut self, measured: f64, noise: f64) -> f64 {
        let whole = self.level_variance + noise * noise;
        let error = measured - self.level;
        let ours = density(error, whole);
        let trust = ours / (ours + OUTLIER_DENSITY);
        let [of_level, of_model_error, of_stick_position] =
            [self.level_variance, self.with_model_error, self.with_stick_position].map(|part| part / whole * trust);
        self.level += of_level * error;
        self.model_error += of_model_error * error;
        self.stick_position += of_stick_position * error;
        self.model_error_variance -= of_model_error * self.with_model_error;
        self.stick_position_variance -= of_stick_position * self.with_stick_position;
        self.with_model_error *= 1.0 - of_level;
        self.with_stick_position *= 1.0 - of_level;
        self.level_variance *= 1.0 - of_level;
        let unsure = inflation(trust, error);
        self.level_variance += unsure;
        self.model_error_variance += unsure;
        self.with_model_error += unsure;
        ours + OUTLIER_DENSITY
    }
}

/// The muscle behind a valve, as one history has it.
#[derive(Clone, Debug)]
struct Muscle {
    constant: f64,
    /// Thresholds, weights and states.
    operators: Vec<[f64; 3]>,
}

impl Muscle {
    /// The muscle when a recording begins at this pressure.
    fn new(bank: &Bank, law: &SlipLaw, pressure: f64) -> Self {
        let weighty = bank.operators.iter().filter(|(_, weight)| *weight != 0.0);
        let mean_error = law.overshoot * law.break_away;
        let operators = weighty.map(|&(threshold, weight)| [(threshold - mean_error).max(0.0), weight, 0.0]).collect();
        let mut muscle = Self { constant: bank.constant, operators };
        for &turn in bank.history.iter().chain([&pressure]) {
            muscle.at(turn);
        }
        muscle
    }

    /// What it makes of a pressure.
    fn at(&mut self, pressure: f64) -> f64 {
        let of = |[threshold, weight, state]: &mut [f64; 3]| {
            *state = state.max(pressure - *threshold).min(pressure + *threshold);
            *weight * *state
        };
        self.constant + self.operators.iter_mut().map(of).sum::<f64>()
    }
}

/// Chance that a valve opens while its error goes from so many deviations beyond its band to so many, when it has not opened before; one that
/// stays far beyond opens soon.
fn opens(before: f64, now: f64) -> f64 {
    let grown = chance(now) - chance(before);
    (grown / (1.0 - chance(before)).max(1e-6)).clamp(0.0, 1.0).max(chance(now - 3.0))
}

/// What the observer of a valve expects of every sample.
pub fn observe(seen: &Seen<'_>, law: &SlipLaw) -> Expected {
    let stay = (-seen.period_s / MODEL_ERROR_S).exp();
    let kick = law.model_error * law.model_error * (1.0 - stay * stay);
    let gains = slopes(seen);
    let first = Hypothesis {
        weight: 1.0,
        stick_position: seen.command[0],
        open: false,
        level: seen.quasi_static[0],
        model_error: 0.0,
        level_variance: (law.break_away * gains[0]).powi(2) + law.model_error * law.model_error,
        model_error_variance: law.model_error * law.model_error,
        stick_position_variance: law.break_away * law.break_away / 3.0,
        with_model_error: 0.0,
        with_stick_position: gains[0] * law.break_away * law.break_away / 3.0,
    };
    let mut hypotheses = [Hypothesis { weight: 1e-12, ..first }; MOST_HYPOTHESES];
    hypotheses[0].weight = 1.0;
    let mut muscles: Option<[Muscle; MOST_HYPOTHESES]> =
        seen.bank.map(|bank| Muscle::new(bank, law, seen.command[0])).map(|muscle| std::array::from_fn(|_| muscle.clone()));
    let scatter = law.scatter * law.break_away;
    let mut expected = Expected::default();
    let mut before = seen.command[0];
    for (sample, &gain) in gains.iter().enumerate() {
        let (quasi_static, command, followed) = (seen.quasi_static[sample], seen.command[sample], seen.followed[sample]);
        let mut leaves = [0.0; MOST_HYPOTHESES];
        for (at, history) in hypotheses.iter_mut().enumerate().filter(|(_, history)| history.weight >= PRUNING_THRESHOLD) {
            history.model_error *= stay;
            history.model_error_variance = stay * stay * history.model_error_variance + kick;
            history.with_model_error *= stay;
            if history.open {
                let was = history.stick_position;
                let direction = (before - was).signum();
                history.follow(law, before, command, seen.period_s);
                let muscle = muscles.as_mut().map(|muscles| &mut muscles[at]);
                history.land(law, muscle, (quasi_static, followed), gain, direction, 0.5 * (history.stick_position - was).abs());
            } else {
                let spread = (scatter * scatter + history.stick_position_variance.max(0.0)).sqrt().max(1e-9);
                let beyond = |command: f64| ((command - history.stick_position).abs() - law.break_away) / spread;
                leaves[at] = history.weight * opens(beyond(before), beyond(command));
            }
        }
        // All that open now have nearly the same pressure: one history for them, with the initial state of the likeliest.
        let leaving: f64 = leaves.iter().sum();
        let parent = (0..MOST_HYPOTHESES).max_by(|&x, &y| leaves[x].total_cmp(&leaves[y])).unwrap_or(0);
        let mut landed = Hypothesis { weight: leaving, open: true, ..hypotheses[parent] };
        let mut muscle = muscles.as_ref().filter(|_| leaving > PRUNING_THRESHOLD).map(|muscles| muscles[parent].clone());
        if leaving > PRUNING_THRESHOLD {
            let was = landed.stick_position;
            let (error_before, error) = (before - was, command - was);
            let direction = error.signum();
            let share = law.valve().share_until_it_opens(error_before, error);
            landed.stick_position_variance = landed.stick_position_variance.max(0.0).min(scatter * scatter);
            landed.follow(law, before + (command - before) * share, command, (1.0 - share) * seen.period_s);
            landed.land(law, muscle.as_mut(), (quasi_static, followed), gain, direction, landed.stick_position - was);
        }
        for (history, left) in hypotheses.iter_mut().zip(leaves) {
            history.weight -= left;
        }
        let weakest = (0..MOST_HYPOTHESES).min_by(|&x, &y| hypotheses[x].weight.total_cmp(&hypotheses[y].weight)).unwrap_or(0);
        hypotheses[weakest] = landed;
        if let (Some(muscles), Some(muscle)) = (&mut muscles, muscle) {
            muscles[weakest] = muscle;
        }
        before = command;
        let total: f64 = hypotheses.iter().map(|history| history.weight).sum();
        let mean = hypotheses.iter().map(|history| history.weight * history.level).sum::<f64>() / total;
        let spread = |history: &Hypothesis| history.weight * (history.level_variance + (history.level - mean).powi(2));
        expected.mean.push(mean);
        expected.stick_position.push(hypotheses.iter().map(|history| history.weight * history.stick_position).sum::<f64>() / total);
        expected.variance.push(hypotheses.iter().map(spread).sum::<f64>() / total);
        if !seen.keep[sample] {
            expected.log_likelihood.push(0.0);
            continue;
        }
        let mut likelihood = 0.0;
        for history in &mut hypotheses {
            if history.weight < PRUNING_THRESHOLD {
                history.weight = 0.0;
                continue;
            }
            history.weight *= history.learn(seen.measured[sample], seen.noise) / total;
            likelihood += history.weight;
        }
        expected.log_likelihood.push(likelihood.ln());
        for history in &mut hypotheses {
            history.weight = (history.weight / likelihood).max(1e-12);
        }
    }
    expected
}

/// How much the quasi-static response moves with the pressure that it is made by, sample by sample; while that rests, as before.
fn slopes(seen: &Seen<'_>) -> Vec<f64> {
    const SIDE: usize = 2;
    const LEAST_STEP: f64 = 4e-3;
    let last = seen.followed.len() - 1;
    let mut slope = 1.0;
    (0..=last)
        .map(|sample| {
            let (from, to) = (sample.saturating_sub(SIDE), (sample + SIDE).min(last));
            let step = seen.followed[to] - seen.followed[from];
            if step.abs() > LEAST_STEP {
                slope = ((seen.quasi_static[to] - seen.quasi_static[from]) / step).abs().clamp(0.02, 5.0);
            }
            slope
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chain::form::Drive;
    use crate::observers::law::NEVER;

    const NOISE: f64 = 0.005;
    const LAW: SlipLaw =
        SlipLaw { break_away: 0.08, closing: 0.2, flow_s: 0.02, scatter: 0.03, model_error: 0.005, ..SlipLaw::plain(Drive::Command) };

    /// What stands in the place of noise.
    fn ripple(sample: usize) -> f64 {
        NOISE * (2.4 * sample as f64 + 0.3 * (0.7 * sample as f64).sin()).sin()
    }

    /// Strokes of 0.2 Hz, and the pressure behind a valve of [`LAW`] in fine steps; with a ripple in the place of noise.
    fn strokes() -> (Vec<f64>, Vec<f64>) {
        strokes_from(0.03)
    }

    /// The same from another pressure on.
    fn strokes_from(pressure: f64) -> (Vec<f64>, Vec<f64>) {
        strokes_by(&LAW, pressure)
    }

    /// The same by another law.
    fn strokes_by(law: &SlipLaw, mut pressure: f64) -> (Vec<f64>, Vec<f64>) {
        let command = |time_s: f64| 0.5 - 0.5 * (0.4 * std::f64::consts::PI * time_s).cos();
        let mut open = false;
        let (mut commands, mut measured) = (Vec::new(), Vec::new());
        for step in 0..1000 * 200_usize {
            let time_s = step as f64 * 1e-4;
            let error: f64 = command(time_s) - pressure;
            open = error.abs() > if open { law.closing * law.break_away } else { law.break_away };
            if open {
                pressure += (error / law.flow_s).clamp(-law.most_flow, law.most_flow) * 1e-4;
            }
            if step % 200 == 0 {
                commands.push(command(time_s));
                measured.push(pressure + ripple(step / 200));
            }
        }
        (commands, measured)
    }

    /// A recording whose quasi-static response is the command.
    fn seen<'a>(command: &'a [f64], measured: &'a [f64], keep: &'a [bool]) -> Seen<'a> {
        Seen { command, followed: command, quasi_static: command, measured, keep, period_s: 0.02, noise: NOISE, bank: None }
    }

    fn observed(law: &SlipLaw) -> (f64, f64) {
        let (command, measured) = strokes();
        let keep = vec![true; command.len()];
        let expected = observe(&seen(&command, &measured, &keep), law);
        let square = expected.mean.iter().zip(&measured).map(|(mean, measured)| (mean - measured).powi(2)).sum::<f64>();
        ((square / measured.len() as f64).sqrt(), expected.log_likelihood.iter().sum())
    }

    #[test]
    fn the_law_of_the_valve_foretells_its_pressure_and_other_laws_do_not() {
        let (miss, log_likelihood) = observed(&LAW);
        // The command is further off than the band is wide on fast parts of a stroke; what is left is little more than the ripple.
        assert!(miss < 0.012, "{miss}");
        let others = [
            SlipLaw { break_away: 0.1, ..LAW },
            SlipLaw { break_away: 0.065, ..LAW },
            SlipLaw { closing: 0.5, ..LAW },
            SlipLaw { flow_s: 0.06, ..LAW },
        ];
        for other in others {
            let (_, of_other) = observed(&other);
            assert!(log_likelihood > of_other + 30.0, "{log_likelihood} and {of_other} by {other:?}");
        }
    }

    #[test]
    fn a_valve_that_lets_through_so_much_and_no_more_is_told_by_that() {
        let law = SlipLaw { flow_s: 0.002, most_flow: 1.5, ..LAW };
        let (command, measured) = strokes_by(&law, 0.03);
        let keep = vec![true; command.len()];
        let likely = |law: &SlipLaw| observe(&seen(&command, &measured, &keep), law).log_likelihood.iter().sum::<f64>();
        let log_likelihood = likely(&law);
        let others = [NEVER, 3.0, 0.9].map(|most_flow| SlipLaw { most_flow, ..law });
        for other in others.into_iter().chain([0.01, 0.025, 0.06].map(|flow_s| SlipLaw { flow_s, ..LAW })) {
            assert!(log_likelihood > likely(&other) + 30.0, "{log_likelihood} and {} by {other:?}", likely(&other));
        }
    }

    #[test]
    fn a_pressure_that_nobody_sees_is_foretold_by_the_law() {
        let (command, measured) = strokes_from(0.0);
        let mut foretold = command.clone();
        LAW.valve().lead(&mut foretold, command[0], 0.02);
        // The first strokes: later an error of a thousandth of the band has grown.
        let miss = foretold.iter().zip(&measured).take(300).map(|(own, measured)| (own - measured).powi(2)).sum::<f64>() / 300.0;
        assert!(miss.sqrt() < 2.0 * NOISE, "{}", miss.sqrt());
    }

    #[test]
    fn the_muscle_is_led_by_the_pressure_behind_the_valve_and_not_by_the_command() {
        let (command, pressure) = strokes();
        let operators = vec![(0.0, 0.3), (0.1, 0.5), (0.25, 0.4)];
        let bank = Bank { constant: 0.02, operators, history: Vec::new() };
        let through = |path: &[f64]| -> Vec<f64> {
            let mut muscle = Muscle::new(&bank, &LAW, path[0]);
            path.iter().map(|&value| muscle.at(value)).collect()
        };
        let quiet: Vec<f64> = pressure.iter().enumerate().map(|(sample, value)| value - ripple(sample)).collect();
        let measured: Vec<f64> = through(&quiet).into_iter().enumerate().map(|(sample, value)| value + ripple(sample)).collect();
        let quasi_static = through(&command);
        let keep = vec![true; command.len()];
        let miss = |bank: Option<&Bank>| {
            let expected = observe(&Seen { quasi_static: &quasi_static, bank, ..seen(&command, &measured, &keep) }, &LAW);
            let square = expected.mean.iter().zip(&measured).map(|(mean, measured)| (mean - measured).powi(2)).sum::<f64>();
            ((square / measured.len() as f64).sqrt(), expected.stick_position)
        };
        let ((led, stick_position), (not_led, _)) = (miss(Some(&bank)), miss(None));
        assert!(led < 2.0 * NOISE && not_led > 1.3 * led, "{led} and {not_led}");
        let off = stick_position.iter().zip(&quiet).map(|(stick_position, pressure)| (stick_position - pressure).powi(2)).sum::<f64>()
            / stick_position.len() as f64;
        assert!(off.sqrt() < 0.3 * LAW.break_away, "{}", off.sqrt());
    }

    #[test]
    fn a_response_that_comes_off_by_more_than_its_model_error_is_found_again() {
        let (command, mut measured) = strokes();
        // A zero that moves by twenty deviations of the noise, and six samples that are none.
        measured[400..].iter_mut().for_each(|value| *value += 20.0 * NOISE);
        measured[200..206].iter_mut().for_each(|value| *value = 3.0);
        let keep = vec![true; command.len()];
        let expected = observe(&seen(&command, &measured, &keep), &LAW);
        let miss = |from: usize, to: usize| {
            let square = (from..to).map(|at| (expected.mean[at] - measured[at]).powi(2)).sum::<f64>();
            (square / (to - from) as f64).sqrt()
        };
        assert!(miss(0, 200) < 0.02, "{}", miss(0, 200));
        assert!(miss(430, 600) < 0.03, "{}", miss(430, 600));
        assert!(miss(260, 400) < 0.03, "{}", miss(260, 400));
    }

    #[test]
    fn a_slow_approach_opens_no_sooner_than_a_fast_one() {
        let still_closed = |steps: i32| -> f64 {
            let place = |step: i32| -3.0 + 3.5 * f64::from(step) / f64::from(steps);
            (0..steps).map(|step| 1.0 - opens(place(step), place(step + 1))).product()
        };
        let (fast, slow) = (still_closed(2), still_closed(60));
        assert!((fast / slow - 1.0).abs() < 0.1, "{fast} and {slow}");
    }
}
