//! Seeing jumps in the measured output: an observer of something that holds, breaks away and holds again.
//!
//! When such a thing jumps hangs on a state that nobody records, and an error of a tenth of its travel in the quasi-static response moves all jumps that
//! follow. A simulation from the input alone meets few of them (`docs/concepts/discovery.md`), so they are judged by what can be met: each sample is
//! predicted from the samples before it. Two observers do that, and whether something jumps is the difference of their likelihoods.
//!
//! Terms. *Quasi-static response*: the output that the model expects where nothing sticks; its weights have taken the mean lag of what sticks for hysteresis
//! of the muscle, so distances count from the middle between break-away up and down. *Stick position*: where the thing holds. *Drive*: what a stick position is
//! compared with to break away; the quasi-static response itself for a tip that sticks, the command for a valve. *Model error*: slow error of the quasi-static response.
//!
//! The *smooth observer* knows the quasi-static response, its model error (an Ornstein-Uhlenbeck process) and white noise: a Kalman filter with one state. The
//! *jump observer* follows the few likeliest hypotheses of stick positions; each is a Kalman filter for its level and the model error, and the chance that
//! it breaks away within the next sample grows with the distance of the drive from the stick position (a hidden semi-Markov model, of which the
//! likeliest histories are kept).

use crate::chain::columns::{Bank, Columns};
use crate::chain::filters::lag;
use crate::chain::form::{Drive, OperatorLaw};
use crate::chain::operators;
use crate::chain::operators::{Begin, Lead};
use crate::data::session::Run;
use crate::observers::law::{Expected, OF_A_TIP, OUTLIER_DENSITY, PseudoMeasurement, Seen, SlipLaw, density, inflation};
use crate::observers::{stick_slip_filter, valve_filter};

/// Adds a column with what the output is expected to depart from `sum` by, for what was measured before each sample. Where nothing was
/// measured (a simulation) the column is zero: over all stick positions the mean of what sticks is the quasi-static response. Operators that are the muscle's own are led
/// by the pressure behind the valve instead of the command.
pub fn push_departure(drive: Drive, feels: bool, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
    let (law, noise) = SlipLaw::of_parameters(drive, parameters);
    if run.output.iter().all(|value| *value == 0.0) {
        if law.leads_the_muscle() {
            let mut stick_position = columns.command.clone();
            law.valve().lead(&mut stick_position, columns.command[0], run.period_s);
            lead_by_the_stick_position(&law, &stick_position, run, columns);
        }
        columns.push(false, |_| 0.0);
        return;
    }
    let follows_s = if drive == Drive::Command { law.lag_s } else { 0.0 };
    let tip = Tip::new(run, columns, sum, feels, follows_s);
    let expected = observe(&tip.seen(run, noise), &law);
    let quasi_static = lead_by_the_stick_position(&law, &expected.stick_position, run, columns).unwrap_or(tip.quasi_static);
    columns.push(false, |sample| expected.mean[sample] - quasi_static[sample]);
}

/// Leads the operators by the pressure behind a valve, where they are the muscle's own: what they make of it by their last weights.
fn lead_by_the_stick_position(law: &SlipLaw, stick_position: &[f64], run: &Run, columns: &mut Columns) -> Option<Vec<f64>> {
    let bank = columns.bank.clone().filter(|_| law.leads_the_muscle())?;
    let (thresholds, mut weights): (Vec<f64>, Vec<f64>) = bank.operators.iter().copied().unzip();
    let operator_law = OperatorLaw::default();
    let lead = Lead { begin: Begin::After(&bank.history), path: stick_position, operator_law: &operator_law, period_s: run.period_s };
    columns.lead_anew(|rows| operators::write(&thresholds, &lead, rows));
    weights.insert(0, bank.constant);
    let mut quasi_static = vec![0.0; stick_position.len()];
    columns.weigh(&weights, 0, &mut quasi_static);
    Some(quasi_static)
}

/// One recording at the tip: what the sensor's effects add by the model is off where a stick position does not feel them.
#[derive(Clone, Debug)]
pub struct Tip {
    command: Vec<f64>,
    /// The pressure that the quasi-static response is made by: the command behind a valve that is never shut.
    followed: Vec<f64>,
    /// The quasi-static response, normalised.
    pub quasi_static: Vec<f64>,
    measured: Vec<f64>,
    /// What makes the quasi-static response of that pressure, where nothing else does.
    pub bank: Option<Bank>,
}

impl Tip {
    /// The tip by a model's `columns` and its `output`, constant included, whose operators follow the command by `follows_s`.
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
            quasi_static: without(output),
            measured: without(&run.output),
            bank: columns.bank.clone(),
        }
    }

    /// What the observers see of it.
    pub fn seen<'a>(&'a self, run: &'a Run, noise: f64) -> Seen<'a> {
        Seen {
            command: &self.command,
            followed: &self.followed,
            quasi_static: &self.quasi_static,
            measured: &self.measured,
            keep: &run.keep,
            period_s: run.period_s,
            noise,
            bank: self.bank.as_ref(),
        }
    }
}

/// Puts what a tip tells of its quasi-static response in the place of the measured output, each sample by how sure that is. The last of the parameters, behind
/// those of a tip, is by how much farther from the stick position the quasi-static response is to be than the observer takes it to be.
///
/// A quasi-static response is known where the tip slips or slides; elsewhere it follows from its operators. Fitted to the output instead, as it is with the mean
/// error of a tip for noise, it is drawn to the stick positions where the tip holds, most of all about turning points.
pub fn infer_quasi_static(feels: bool, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
    let (law, noise) = SlipLaw::of_parameters(Drive::QuasiStatic, parameters);
    let farther = parameters[OF_A_TIP.len()];
    let tip = Tip::new(run, columns, sum, feels, 0.0);
    let at_sensor = |sample: usize| run.output[sample] - tip.measured[sample];
    let mut pseudo_measurements: Vec<(f64, f64)> = (0..run.output.len()).map(|sample| (sum[sample], UNKNOWN_WEIGHT)).collect();
    for PseudoMeasurement { sample, direction, quasi_static, variance } in observe(&tip.seen(run, noise), &law).pseudo_measurements {
        let share = noise / (variance + SUREST * noise * noise).sqrt();
        pseudo_measurements[sample] = (quasi_static + direction * farther + at_sensor(sample), share);
    }
    columns.tell(|sample| pseudo_measurements[sample]);
}

/// Weight of a sample at which nothing is told: the quasi-static response stays, where nothing speaks against it.
const UNKNOWN_WEIGHT: f64 = 0.01;

/// What is told most surely, in variances of the noise: laws are no better than that.
const SUREST: f64 = 0.25;

/// Logarithms of the likelihoods of a smooth output: quasi-static response, model error and noise.
pub fn smooth(seen: &Seen<'_>, model_error: f64, model_error_s: f64) -> Vec<f64> {
    follow_smoothly(seen, model_error, model_error_s, |likelihood, _| likelihood)
}

/// What the observer of a smooth output expects of every sample, by the samples before it.
pub fn expect_smoothly(seen: &Seen<'_>, model_error: f64, model_error_s: f64) -> Vec<f64> {
    follow_smoothly(seen, model_error, model_error_s, |_, expected| expected)
}

/// Follows a smooth output; `tell` chooses from the logarithm of the likelihood of each sample and from what was expected of it.
fn follow_smoothly(seen: &Seen<'_>, model_error: f64, model_error_s: f64, tell: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    let stay = (-seen.period_s / model_error_s).exp();
    let kick = model_error * model_error * (1.0 - stay * stay);
    let (mut mean, mut variance) = (0.0, model_error * model_error);
    let step = |((&measured, &quasi_static), &keep): ((&f64, &f64), &bool)| {
        mean *= stay;
        variance = stay * stay * variance + kick;
        let expected = quasi_static + mean;
        if !keep {
            return tell(0.0, expected);
        }
        let whole = variance + seen.noise * seen.noise;
        let error = measured - quasi_static - mean;
        let ours = density(error, whole);
        let trust = ours / (ours + OUTLIER_DENSITY);
        let gain = variance / whole * trust;
        mean += gain * error;
        variance = variance * (1.0 - gain) + inflation(trust, error);
        tell((ours + OUTLIER_DENSITY).ln(), expected)
    };
    seen.measured.iter().zip(seen.quasi_static).zip(seen.keep).map(step).collect()
}

/// What the jump observer expects of every sample.
pub fn observe(seen: &Seen<'_>, law: &SlipLaw) -> Expected {
    match law.drive {
        Drive::QuasiStatic => stick_slip_filter::observe(seen, law),
        Drive::Command => valve_filter::observe(seen, law),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observers::law::OF_A_VALVE;

    const LAW: SlipLaw =
        SlipLaw { break_away: 0.05, overshoot: 1.0, scatter: 0.1, model_error: 0.002, ..SlipLaw::plain(Drive::QuasiStatic) };
    const NOISE: f64 = 0.005;

    /// A slow triangle as the quasi-static response, and a tip on it that holds within 0.05 and jumps by 0.1; with a ripple in the place of noise.
    fn slow_triangle() -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let quasi_static: Vec<f64> = (0..1000).map(|sample| 1.0 - (f64::from(sample % 500) / 250.0 - 1.0_f64).abs()).collect();
        let ripple = |sample: usize| NOISE * (2.4 * sample as f64 + 0.3 * (0.7 * sample as f64).sin()).sin();
        let mut place: f64 = 0.0;
        let tip = quasi_static.iter().enumerate().map(|(sample, quasi_static)| {
            if (quasi_static - place).abs() > 0.05 {
                place += 0.1 * (quasi_static - place).signum();
            }
            place + ripple(sample)
        });
        let tip = tip.collect();
        let smooth = quasi_static.iter().enumerate().map(|(sample, quasi_static)| quasi_static + ripple(sample)).collect();
        (quasi_static, tip, smooth)
    }

    fn log_likelihood(measured: &[f64], quasi_static: &[f64]) -> (f64, f64) {
        let keep = vec![true; quasi_static.len()];
        let seen = Seen {
            command: quasi_static,
            followed: quasi_static,
            quasi_static,
            measured,
            keep: &keep,
            period_s: 0.02,
            noise: NOISE,
            bank: None,
        };
        let smooth_sum = [0.002, 0.02, 0.04].map(|model_error| smooth(&seen, model_error, 0.1).iter().sum::<f64>());
        (observe(&seen, &LAW).log_likelihood.iter().sum(), smooth_sum.into_iter().fold(f64::MIN, f64::max))
    }

    #[test]
    fn stairs_speak_for_jumps_and_a_smooth_output_against_them() {
        let (quasi_static, tip, smooth_tip) = slow_triangle();
        let (jumps, smooth) = log_likelihood(&tip, &quasi_static);
        assert!(jumps > smooth + 100.0, "{jumps} {smooth}");
        let (jumps, smooth) = log_likelihood(&smooth_tip, &quasi_static);
        assert!(smooth > jumps + 100.0, "{jumps} {smooth}");
    }

    #[test]
    fn the_observer_looks_at_no_sample_before_it_has_said_what_it_expects() {
        let (quasi_static, mut tip, _) = slow_triangle();
        let keep = vec![true; quasi_static.len()];
        let of = |tip: &[f64]| {
            let seen = Seen {
                command: &quasi_static,
                followed: &quasi_static,
                quasi_static: &quasi_static,
                measured: tip,
                keep: &keep,
                period_s: 0.02,
                noise: NOISE,
                bank: None,
            };
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
    fn another_break_away_distance_leaves_a_tip_its_travel_and_a_valve_its_overshoot() {
        let tip = SlipLaw { overshoot: 0.5, ..LAW };
        let other = tip.with_break_away(0.06);
        assert!(((1.0 + other.overshoot) * other.break_away - 0.075).abs() < 1e-12, "{other:?}");
        let valve = SlipLaw { drive: Drive::Command, ..tip };
        assert_eq!(valve.with_break_away(0.06).overshoot, valve.overshoot);
    }

    #[test]
    fn a_response_that_is_farther_on_every_way_moves_the_tip_as_before() {
        // A straight way, along which the quasi-static response is farther by a constant.
        let near: Vec<f64> = (0..300).map(|sample| 0.002 * f64::from(sample)).collect();
        let far: Vec<f64> = near.iter().map(|quasi_static| quasi_static + 0.02).collect();
        let law = SlipLaw { overshoot: 0.5, sliding_speed: 0.5, kinetic_friction: 0.1, slip_s: 0.01, presliding: 0.02, ..LAW };
        let of = |quasi_static: &[f64], law: &SlipLaw| {
            let keep = vec![true; quasi_static.len()];
            let measured: Vec<f64> = near.iter().map(|near| (near / 0.075).floor() * 0.075).collect();
            let seen = Seen {
                command: quasi_static,
                followed: quasi_static,
                quasi_static,
                measured: &measured,
                keep: &keep,
                period_s: 0.02,
                noise: NOISE,
                bank: None,
            };
            observe(&seen, law).mean
        };
        let farther = SlipLaw { begins: -0.02, ..law.of_a_response_farther(0.02) };
        assert!(farther.overshoot < law.overshoot && farther.break_away > law.break_away, "{farther:?}");
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
        let tip = SlipLaw { overshoot: -0.2, sliding_speed: 0.9, presliding: 0.03, slip_per_speed_s: -0.01, lag_s: 0.004, ..LAW };
        let tip = SlipLaw { rate_weakening: 0.3, kinetic_friction: 0.4, slip_s: 0.012, begins: -0.01, ..tip };
        let valve = SlipLaw { drive: Drive::Command, closing: 0.3, flow_s: 0.02, lag_s: 0.01, ..LAW };
        for (law, form) in [(tip, OF_A_TIP), (valve, OF_A_VALVE)] {
            let parameters = law.as_parameters(NOISE);
            assert_eq!(parameters.len(), form.len());
            assert_eq!(SlipLaw::of_parameters(law.drive, &parameters), (law, NOISE));
        }
    }
}
