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

use super::catalogue::{Columns, Habit, Parameter, Quantity};
use super::columns::Bank;
use super::effects::lag;
use super::operators::{self, Begin, Lead};
use super::session::Run;
use super::{tip_jumps, valve_jumps};

/// Density, per span of the output, of a sample that no law explains: one in a hundred anywhere in the range.
pub(super) const WILD: f64 = 0.01;
/// Weight of a history below which it is given up: it could not come back within two samples.
pub(super) const LOST: f64 = 1e-9;
/// Time over which the pull's error wanders, s.
pub(super) const WANDER_S: f64 = 0.6;

/// What a seat is compared with to break away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drive {
    /// The pull of the model: a tip that sticks.
    Pull,
    /// The command: a valve with a dead band.
    Command,
}

/// A law of holding and jumping, normalised; lengths in those of the drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JumpLaw {
    /// What it breaks away by.
    pub drive: Drive,
    /// Distance of drive and seat at which it breaks away.
    pub break_away: f64,
    /// How far beyond the drive it lands, in break-away distances; a tip may land short of it. Of a valve: where in its band the pull stands, for weights that were
    /// fitted without it have taken the mean error for hysteresis; zero for weights of the muscle alone, which is led by the pressure.
    pub landing: f64,
    /// Speed of the pull, per s, from which a tip slides: it follows the pull until that has become a good deal slower.
    pub sliding_speed: f64,
    /// Share of the pull's way by which a tip that holds gives way: bristles and seals yield before they slide (Dahl, 1968).
    pub yielding: f64,
    /// By how much a tip's leap grows with the speed of the pull, s: friction takes time to fall and to build up.
    pub leap_per_speed_s: f64,
    /// How much a tip's break-away distance falls with the speed of the pull, at the sliding speed: static friction takes time to build up
    /// (Johannes, Green and Brockley, 1973; Richardson and Nolle, 1976).
    pub fall: f64,
    /// How far behind the pull a tip slides, in break-away distances.
    pub behind: f64,
    /// How long a tip's leap takes, s.
    pub leap_s: f64,
    /// Where a tip sits when a recording begins, from the pull, in spans of the output.
    pub begins: f64,
    /// Error, in break-away distances, at which an open valve closes.
    pub closing: f64,
    /// Time constant with which the pressure follows through an open valve, s.
    pub flow_s: f64,
    /// Scatter of break-away and landing, in break-away distances.
    pub scatter: f64,
    /// Standard deviation of the pull's wander, in spans of the output.
    pub wander: f64,
    /// Time constant with which a tip follows while it moves, and the pressure of a valve that is never shut, s; the pull has it already.
    pub lag_s: f64,
}

const fn linear(name: &'static str, quantity: Quantity, high: f64) -> Parameter {
    Parameter { name, quantity, low: 0.0, high, logarithmic: false }
}

const fn distance(quantity: Quantity) -> Parameter {
    Parameter { name: "break_away", quantity, low: 1e-3, high: 0.5, logarithmic: true }
}

const LANDING: Parameter = linear("landing", Quantity::Ratio, 1.0);
const LANDING_OF_A_TIP: Parameter = Parameter { low: LEAST_LANDING_OF_A_TIP, ..LANDING };
const SCATTER: Parameter = linear("scatter", Quantity::Ratio, 1.0);
const WANDER: Parameter = linear("pull_wander", Quantity::Output, 0.5);
const FOLLOWING: Parameter = linear("lag", Quantity::Time, 0.3);
const NOISY: Parameter = linear("noise", Quantity::Output, 0.5);

/// Parameters of a form whose seat is that of a tip.
pub const OF_A_TIP: &[Parameter] = &[
    distance(Quantity::Output),
    LANDING_OF_A_TIP,
    Parameter { name: "sliding_speed", quantity: Quantity::OutputRate, low: 1e-2, high: NEVER, logarithmic: true },
    SCATTER,
    WANDER,
    FOLLOWING,
    NOISY,
    linear("yielding", Quantity::Ratio, MOST_YIELDING),
    Parameter { low: -MOST_LEAP_PER_SPEED_S, ..linear("leap_per_speed", Quantity::Time, MOST_LEAP_PER_SPEED_S) },
    linear("fall_with_rate", Quantity::Ratio, MOST_FALL),
    Parameter { low: -MOST_BEHIND, ..linear("slides_behind", Quantity::Ratio, MOST_BEHIND) },
    linear("leap_time", Quantity::Time, MOST_LEAP_S),
    Parameter { low: -0.5, ..linear("seat_at_first", Quantity::Output, 0.5) },
];

/// More than this share of the pull's way is no holding.
pub const MOST_YIELDING: f64 = 0.3;
/// Largest change of a leap with the speed of the pull, s: the time that a leap takes.
pub const MOST_LEAP_PER_SPEED_S: f64 = 0.05;

/// Largest fall of a tip's break-away distance with the speed of the pull.
pub const MOST_FALL: f64 = 1.5;
/// Farthest that a tip slides behind the pull, or before one that has taken the mean of that for hysteresis, in break-away distances.
pub const MOST_BEHIND: f64 = 1.0;
/// Longest leap, s.
pub const MOST_LEAP_S: f64 = 0.05;
/// Shortest leap of a tip: less than a third of what it breaks away by is hardly one.
const LEAST_LANDING_OF_A_TIP: f64 = -0.7;

/// Parameters of a form whose seat is a valve's pressure.
pub const OF_A_VALVE: &[Parameter] = &[
    distance(Quantity::Input),
    LANDING,
    linear("closing", Quantity::Ratio, 1.0),
    SCATTER,
    WANDER,
    FOLLOWING,
    NOISY,
    linear("flow_time_constant", Quantity::Time, 0.3),
];

/// Least share of its band by which the mean error of a valve may be in the weights, if it is there at all.
const LEAST_LANDING: f64 = 0.01;

/// Which of them is the lag.
pub const LAG: usize = 5;

/// A sliding speed, per s, that nothing reaches.
pub const NEVER: f64 = 1e3;

impl JumpLaw {
    /// The law from which others differ: it holds within nothing, and leaps whole.
    pub(super) const fn plain(drive: Drive) -> Self {
        Self {
            drive,
            break_away: 0.0,
            landing: 0.0,
            sliding_speed: NEVER,
            yielding: 0.0,
            leap_per_speed_s: 0.0,
            fall: 0.4,
            behind: 0.0,
            leap_s: 0.0,
            begins: 0.0,
            closing: 0.0,
            flow_s: 0.0,
            scatter: 0.0,
            wander: 0.0,
            lag_s: 0.0,
        }
    }

    /// Whether the operators are those of the muscle behind a valve, and have taken nothing of the valve for hysteresis of theirs.
    #[must_use]
    pub fn leads_the_muscle(&self) -> bool {
        self.drive == Drive::Command && self.landing == 0.0
    }

    /// The law with this break-away distance. A tip keeps its travel, which recordings show far better than where in it the pull is.
    #[must_use]
    pub fn with_break_away(&self, break_away: f64) -> Self {
        let landing = match self.drive {
            Drive::Pull => ((1.0 + self.landing) * self.break_away / break_away - 1.0).clamp(LEAST_LANDING_OF_A_TIP, 1.0),
            Drive::Command => self.landing,
        };
        Self { break_away, landing, ..*self }
    }

    /// A tip's law for a pull that is farther from the seat by this on every way: it moves as before.
    #[must_use]
    pub fn of_a_pull_farther(&self, by: f64) -> Self {
        let break_away = self.break_away + by;
        let share = self.break_away / break_away;
        let landing = (1.0 + self.landing) * share - 1.0;
        let behind = ((self.behind * self.break_away + by) / break_away).min(MOST_BEHIND);
        Self { break_away, landing, behind, scatter: self.scatter * share, fall: self.fall * share, ..*self }
    }

    /// The law with its landing moved by this: a share of a tip's travel, and of a valve's break-away distance.
    #[must_use]
    pub fn with_landing(&self, by: f64) -> Self {
        let landing = match self.drive {
            Drive::Pull => (self.landing + (1.0 + self.landing) * by).clamp(LEAST_LANDING_OF_A_TIP, 1.0),
            Drive::Command if self.leads_the_muscle() => 0.0,
            Drive::Command => (self.landing + by).clamp(LEAST_LANDING, 1.0),
        };
        Self { landing, ..*self }
    }

    /// The law with these parameters of a form, and the noise behind it.
    #[must_use]
    pub fn of_parameters(drive: Drive, parameters: &[f64]) -> (Self, f64) {
        let &[break_away, landing, of_kind, scatter, wander, lag_s, noise, ref others @ ..] = parameters else {
            unreachable!("forms whose seat is seen have seven parameters in common");
        };
        let other = |index: usize| others.get(index).copied().unwrap_or(0.0);
        let still = Self { break_away, landing, scatter, wander, lag_s, ..Self::plain(drive) };
        let law = match drive {
            Drive::Pull => Self {
                sliding_speed: of_kind,
                yielding: other(0),
                leap_per_speed_s: other(1),
                fall: other(2),
                behind: other(3),
                leap_s: other(4),
                begins: other(5),
                ..still
            },
            Drive::Command => Self { closing: of_kind, flow_s: other(0), ..still },
        };
        (law, noise)
    }

    /// The parameters of a form with this law.
    #[must_use]
    pub fn as_parameters(&self, noise: f64) -> Vec<f64> {
        let of = |of_kind: f64| vec![self.break_away, self.landing, of_kind, self.scatter, self.wander, self.lag_s, noise];
        match self.drive {
            Drive::Pull => {
                let of_a_tip = vec![self.yielding, self.leap_per_speed_s, self.fall, self.behind, self.leap_s, self.begins];
                [of(self.sliding_speed), of_a_tip].concat()
            }
            Drive::Command => [of(self.closing), vec![self.flow_s]].concat(),
        }
    }
}

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

/// One recording as the observers see it.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// Input, normalised.
    pub command: &'a [f64],
    /// The pressure that the pull is made by, normalised.
    pub followed: &'a [f64],
    /// Pull, normalised.
    pub pull: &'a [f64],
    /// Measured output, normalised.
    pub measured: &'a [f64],
    /// Which samples count.
    pub keep: &'a [bool],
    /// Sample period, s.
    pub period_s: f64,
    /// Standard deviation of the noise.
    pub noise: f64,
    /// What makes the pull of the pressure, where nothing else does.
    pub bank: Option<&'a Bank>,
}

/// What an observer expected of every sample before it was seen.
#[derive(Clone, Debug, Default)]
pub struct Expected {
    /// Mean.
    pub mean: Vec<f64>,
    /// Variance without the noise.
    pub variance: Vec<f64>,
    /// Logarithm of the likelihood.
    pub evidence: Vec<f64>,
    /// Mean of a valve's pressure; empty for a tip.
    pub seat: Vec<f64>,
    /// What a tip tells of its pull; empty for a valve.
    pub told: Vec<Told>,
}

/// What the moment of a leap, or sliding, tells of the pull.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    /// At this sample.
    pub sample: usize,
    /// The side of the seat on which the pull is: 1 or -1.
    pub direction: f64,
    /// The pull, normalised.
    pub pull: f64,
    /// Its variance.
    pub variance: f64,
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

/// Normal distribution function, by the logistic one (largest error 0.01).
pub(super) fn chance(deviations: f64) -> f64 {
    1.0 / (1.0 + (-1.702 * deviations).exp())
}

/// Density of a normal deviate with this error and variance.
pub(super) fn density(error: f64, variance: f64) -> f64 {
    (1.0 - WILD) * (-0.5 * error * error / variance).exp() / (2.0 * std::f64::consts::PI * variance).sqrt()
}

/// Variance by which the pull may be off where a sample with this error was trusted so far: one that no history explains is a bad reading,
/// several in a row are a pull that must be found again.
pub(super) fn doubt(trust: f64, error: f64) -> f64 {
    (1.0 - trust) * (DOUBT * error).powi(2)
}

/// Share of the error of a sample which is not believed that the pull may be off by.
const DOUBT: f64 = 0.2;

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
