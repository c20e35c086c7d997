//! Seeing jumps in the measured output: an observer of something that holds, breaks away and holds again.
//!
//! When such a thing jumps hangs on a state that nobody records, and an error of a tenth of its travel in the pull moves all jumps that
//! follow. A simulation from the input alone meets few of them (`docs/discovery.md`), so they are judged by what can be met: each sample is
//! predicted from the samples before it. Two observers do that, and whether something jumps is the difference of their likelihoods.
//!
//! Terms. *Pull*: the output that the model expects where nothing sticks; its weights have taken the mean lag of what sticks for hysteresis
//! of the muscle, so distances count from the middle between break-away up and down. *Seat*: where the thing holds. *Drive*: what a seat is
//! compared with to break away; the pull itself for a tip that sticks, the command for a valve. *Wander*: slow error of the pull.
//!
//! The *smooth observer* knows the pull, its wander (an Ornstein-Uhlenbeck process) and white noise: a Kalman filter with one state. The
//! *jump observer* follows the few likeliest histories of seats; each is a Kalman filter for its level and the wander, and the chance that
//! it breaks away within the next sample grows with the distance of the drive from the seat (a hidden semi-Markov model, of which the
//! likeliest histories are kept).

use crate::chain::columns::{Bank, Columns};
use crate::chain::filters::lag;
use crate::chain::form::{Drive, Habit};
use crate::chain::operators;
use crate::chain::operators::{Begin, Lead};
use crate::data::session::Run;
use crate::observers::law::{Expected, JumpLaw, OF_A_TIP, Seen, Told, WILD, density, doubt};
use crate::observers::{tip_jumps, valve_jumps};

/// Adds a column with what the output is expected to depart from `sum` by, for what was measured before each sample. Where nothing was
/// measured (a simulation) the column is zero: over all seats the mean of what sticks is the pull. Operators that are the muscle's own are led
/// by the pressure behind the valve instead of the command.
pub fn push_departure(drive: Drive, feels: bool, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
    let (law, noise) = JumpLaw::of_parameters(drive, parameters);
    if run.output.iter().all(|value| *value == 0.0) {
        if law.leads_the_muscle() {
            let seat = valve_jumps::foretold(&columns.command, &law, run.period_s);
            lead_by_the_seat(&law, &seat, run, columns);
        }
        columns.push(false, |_| 0.0);
        return;
    }
    let follows_s = if drive == Drive::Command { law.lag_s } else { 0.0 };
    let tip = Tip::new(run, columns, sum, feels, follows_s);
    let expected = observe(&tip.seen(run, noise), &law);
    let pull = lead_by_the_seat(&law, &expected.seat, run, columns).unwrap_or(tip.pull);
    columns.push(false, |sample| expected.mean[sample] - pull[sample]);
}

/// Leads the operators by the pressure behind a valve, where they are the muscle's own: what they make of it by their last weights.
fn lead_by_the_seat(law: &JumpLaw, seat: &[f64], run: &Run, columns: &mut Columns) -> Option<Vec<f64>> {
    let bank = columns.bank.clone().filter(|_| law.leads_the_muscle())?;
    let (thresholds, mut weights): (Vec<f64>, Vec<f64>) = bank.operators.iter().copied().unzip();
    let habit = Habit::default();
    let lead = Lead { begin: Begin::After(&bank.history), path: seat, habit: &habit, period_s: run.period_s };
    columns.lead_anew(|rows| operators::write(&thresholds, &lead, rows));
    weights.insert(0, bank.constant);
    let mut pull = vec![0.0; seat.len()];
    columns.weigh(&weights, 0, &mut pull);
    Some(pull)
}

/// One recording at the tip: what the sensor's effects add by the model is off where a seat does not feel them.
#[derive(Clone, Debug)]
pub struct Tip {
    command: Vec<f64>,
    /// The pressure that the pull is made by: the command behind a valve that is never shut.
    followed: Vec<f64>,
    /// The pull, normalised.
    pub pull: Vec<f64>,
    measured: Vec<f64>,
    /// What makes the pull of that pressure, where nothing else does.
    pub bank: Option<Bank>,
}

impl Tip {
    /// The tip by a model's `columns` and its `output`, constant included, whose operators follow the command by `follows_s`.
    #[must_use]
    pub fn new(run: &Run, columns: &Columns, output: &[f64], feels: bool, follows_s: f64) -> Self {
        let share = if feels { 0.0 } else { 1.0 };
        let without = |values: &[f64]| values.iter().zip(&columns.at_sensor).map(|(value, added)| value - share * added).collect();
        let mut followed = columns.command.clone();
        if follows_s > 0.0 {
            lag(&mut followed, follows_s, run.period_s);
        }
        Self {
            command: columns.command.clone(),
            followed,
            pull: without(output),
            measured: without(&run.output),
            bank: columns.bank.clone(),
        }
    }

    /// What the observers see of it.
    #[must_use]
    pub fn seen<'a>(&'a self, run: &'a Run, noise: f64) -> Seen<'a> {
        Seen {
            command: &self.command,
            followed: &self.followed,
            pull: &self.pull,
            measured: &self.measured,
            keep: &run.keep,
            period_s: run.period_s,
            noise,
            bank: self.bank.as_ref(),
        }
    }
}

/// Puts what a tip tells of its pull in the place of the measured output, each sample by how sure that is. The last of the parameters, behind
/// those of a tip, is by how much farther from the seat the pull is to be than the observer takes it to be.
///
/// A pull is known where the tip leaps or slides; elsewhere it follows from its operators. Fitted to the output instead, as it is with the mean
/// error of a tip for noise, it is drawn to the seats where the tip holds, most of all about turning points.
pub fn tell_pull(feels: bool, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
    let (law, noise) = JumpLaw::of_parameters(Drive::Pull, parameters);
    let farther = parameters[OF_A_TIP.len()];
    let tip = Tip::new(run, columns, sum, feels, 0.0);
    let at_sensor = |sample: usize| run.output[sample] - tip.measured[sample];
    let mut told: Vec<(f64, f64)> = (0..run.output.len()).map(|sample| (sum[sample], UNTOLD)).collect();
    for Told { sample, direction, pull, variance } in observe(&tip.seen(run, noise), &law).told {
        let share = noise / (variance + SUREST * noise * noise).sqrt();
        told[sample] = (pull + direction * farther + at_sensor(sample), share);
    }
    columns.tell(|sample| told[sample]);
}

/// Weight of a sample at which nothing is told: the pull stays, where nothing speaks against it.
const UNTOLD: f64 = 0.01;

/// What is told most surely, in variances of the noise: laws are no better than that.
const SUREST: f64 = 0.25;

/// Logarithms of the likelihoods of a smooth output: pull, wander and noise.
#[must_use]
pub fn smooth(seen: &Seen<'_>, wander: f64, wander_s: f64) -> Vec<f64> {
    follow_smoothly(seen, wander, wander_s, |likelihood, _| likelihood)
}

/// What the observer of a smooth output expects of every sample, by the samples before it.
#[must_use]
pub fn expect_smoothly(seen: &Seen<'_>, wander: f64, wander_s: f64) -> Vec<f64> {
    follow_smoothly(seen, wander, wander_s, |_, expected| expected)
}

/// Follows a smooth output; `tell` chooses from the logarithm of the likelihood of each sample and from what was expected of it.
fn follow_smoothly(seen: &Seen<'_>, wander: f64, wander_s: f64, tell: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    let stay = (-seen.period_s / wander_s).exp();
    let kick = wander * wander * (1.0 - stay * stay);
    let (mut mean, mut variance) = (0.0, wander * wander);
    let step = |((&measured, &pull), &keep): ((&f64, &f64), &bool)| {
        mean *= stay;
        variance = stay * stay * variance + kick;
        let expected = pull + mean;
        if !keep {
            return tell(0.0, expected);
        }
        let whole = variance + seen.noise * seen.noise;
        let error = measured - pull - mean;
        let ours = density(error, whole);
        let trust = ours / (ours + WILD);
        let gain = variance / whole * trust;
        mean += gain * error;
        variance = variance * (1.0 - gain) + doubt(trust, error);
        tell((ours + WILD).ln(), expected)
    };
    seen.measured.iter().zip(seen.pull).zip(seen.keep).map(step).collect()
}

/// What the jump observer expects of every sample.
#[must_use]
pub fn observe(seen: &Seen<'_>, law: &JumpLaw) -> Expected {
    match law.drive {
        Drive::Pull => tip_jumps::observe(seen, law),
        Drive::Command => valve_jumps::observe(seen, law),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observers::law::OF_A_VALVE;

    const LAW: JumpLaw = JumpLaw { break_away: 0.05, landing: 1.0, scatter: 0.1, wander: 0.002, ..JumpLaw::plain(Drive::Pull) };
    const NOISE: f64 = 0.005;

    /// A slow triangle as the pull, and a tip on it that holds within 0.05 and jumps by 0.1; with a ripple in the place of noise.
    fn slow_triangle() -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let pull: Vec<f64> = (0..1000).map(|sample| 1.0 - (f64::from(sample % 500) / 250.0 - 1.0_f64).abs()).collect();
        let ripple = |sample: usize| NOISE * (2.4 * sample as f64 + 0.3 * (0.7 * sample as f64).sin()).sin();
        let mut place: f64 = 0.0;
        let tip = pull.iter().enumerate().map(|(sample, pull)| {
            if (pull - place).abs() > 0.05 {
                place += 0.1 * (pull - place).signum();
            }
            place + ripple(sample)
        });
        let tip = tip.collect();
        let smooth = pull.iter().enumerate().map(|(sample, pull)| pull + ripple(sample)).collect();
        (pull, tip, smooth)
    }

    fn evidence(measured: &[f64], pull: &[f64]) -> (f64, f64) {
        let keep = vec![true; pull.len()];
        let seen = Seen { command: pull, followed: pull, pull, measured, keep: &keep, period_s: 0.02, noise: NOISE, bank: None };
        let smooth_sum = [0.002, 0.02, 0.04].map(|wander| smooth(&seen, wander, 0.1).iter().sum::<f64>());
        (observe(&seen, &LAW).evidence.iter().sum(), smooth_sum.into_iter().fold(f64::MIN, f64::max))
    }

    #[test]
    fn stairs_speak_for_jumps_and_a_smooth_output_against_them() {
        let (pull, tip, smooth_tip) = slow_triangle();
        let (jumps, smooth) = evidence(&tip, &pull);
        assert!(jumps > smooth + 100.0, "{jumps} {smooth}");
        let (jumps, smooth) = evidence(&smooth_tip, &pull);
        assert!(smooth > jumps + 100.0, "{jumps} {smooth}");
    }

    #[test]
    fn the_observer_looks_at_no_sample_before_it_has_said_what_it_expects() {
        let (pull, mut tip, _) = slow_triangle();
        let keep = vec![true; pull.len()];
        let of = |tip: &[f64]| {
            let seen =
                Seen { command: &pull, followed: &pull, pull: &pull, measured: tip, keep: &keep, period_s: 0.02, noise: NOISE, bank: None };
            observe(&seen, &LAW).mean
        };
        let before = of(&tip);
        for value in &mut tip[600..] {
            *value += 0.3;
        }
        let after = of(&tip);
        assert_eq!(before[..=600], after[..=600]);
        assert_ne!(before[601], after[601]);
    }

    #[test]
    fn another_break_away_distance_leaves_a_tip_its_travel_and_a_valve_its_landing() {
        let tip = JumpLaw { landing: 0.5, ..LAW };
        let other = tip.with_break_away(0.06);
        assert!(((1.0 + other.landing) * other.break_away - 0.075).abs() < 1e-12, "{other:?}");
        let valve = JumpLaw { drive: Drive::Command, ..tip };
        assert_eq!(valve.with_break_away(0.06).landing, valve.landing);
    }

    #[test]
    fn a_pull_that_is_farther_on_every_way_moves_the_tip_as_before() {
        // A straight way, along which the pull is farther by a constant.
        let near: Vec<f64> = (0..300).map(|sample| 0.002 * f64::from(sample)).collect();
        let far: Vec<f64> = near.iter().map(|pull| pull + 0.02).collect();
        let law = JumpLaw { landing: 0.5, sliding_speed: 0.5, behind: 0.1, leap_s: 0.01, yielding: 0.02, ..LAW };
        let of = |pull: &[f64], law: &JumpLaw| {
            let keep = vec![true; pull.len()];
            let measured: Vec<f64> = near.iter().map(|near| (near / 0.075).floor() * 0.075).collect();
            let seen =
                Seen { command: pull, followed: pull, pull, measured: &measured, keep: &keep, period_s: 0.02, noise: NOISE, bank: None };
            observe(&seen, law).mean
        };
        let farther = JumpLaw { begins: -0.02, ..law.of_a_pull_farther(0.02) };
        assert!(farther.landing < law.landing && farther.break_away > law.break_away, "{farther:?}");
        let wanted = of(&near, &law);
        for (sample, (near, far)) in wanted.iter().zip(of(&far, &farther)).enumerate().skip(30) {
            // What a distance falls by with speed is not quite the same share of a longer one.
            assert!((near - far).abs() < 6e-3, "{far} instead of {near} at {sample}");
        }
        let as_before = of(&far, &law);
        assert!(wanted.iter().zip(as_before).skip(30).any(|(near, far)| (near - far).abs() > 2e-2), "any law would do");
    }

    #[test]
    fn parameters_of_a_form_make_the_law_again() {
        let tip = JumpLaw { landing: -0.2, sliding_speed: 0.9, yielding: 0.03, leap_per_speed_s: -0.01, lag_s: 0.004, ..LAW };
        let tip = JumpLaw { fall: 0.3, behind: 0.4, leap_s: 0.012, begins: -0.01, ..tip };
        let valve = JumpLaw { drive: Drive::Command, closing: 0.3, flow_s: 0.02, lag_s: 0.01, ..LAW };
        for (law, form) in [(tip, OF_A_TIP), (valve, OF_A_VALVE)] {
            let parameters = law.as_parameters(NOISE);
            assert_eq!(parameters.len(), form.len());
            assert_eq!(JumpLaw::of_parameters(law.drive, &parameters), (law, NOISE));
        }
    }
}
