//! Tests of the stick slip filter.

use super::*;
use crate::chain::form::Drive;
use crate::tests::deviates;

const TIP: SlipLaw = SlipLaw { break_away: 0.05, overshoot: 0.6, scatter: 0.05, model_error: 0.001, ..SlipLaw::plain(Drive::QuasiStatic) };
const PERIOD_S: f64 = 0.02;

/// A tip that sits at zero, sure of it, while the quasi-static response has come to `reached`.
fn sticking(reached: f64) -> Hypothesis {
    Hypothesis { weight: 1.0, level: 0.0, level_variance: 1e-6, model_error_variance: 1e-6, highest: reached, ..AT_REST }
}

fn expected(law: &SlipLaw, quasi_static: &[f64], measured: &[f64]) -> Vec<f64> {
    let keep = vec![true; quasi_static.len()];
    observe(
        &Seen {
            command: quasi_static,
            followed: quasi_static,
            quasi_static,
            measured,
            keep: &keep,
            period_s: PERIOD_S,
            noise: 0.002,
            bank: None,
        },
        law,
    )
    .mean
}

#[test]
fn what_has_borne_a_load_bears_it_again() {
    let chance_of = |reached: f64, quasi_static: f64| {
        let motion = Motion::new(0, &TIP, quasi_static, reached, quasi_static - reached, PERIOD_S);
        let history = sticking(reached);
        history.breaks_away(history.stretch(&motion), &motion)
    };
    assert_eq!(chance_of(0.05, 0.05), 0.0, "the quasi-static response rests where the tip has borne its load");
    assert_eq!(chance_of(0.052, 0.049), 0.0, "it goes back");
    let (slow, fast) = (chance_of(0.049, 0.0495), chance_of(0.02, 0.0495));
    assert!(slow > 0.01 && fast > 2.0 * slow, "{slow} of a short way, {fast} of a long one to the same place");
    assert!(chance_of(0.02, 0.08) > 0.999);
}

#[test]
fn a_tip_slips_by_its_travel_from_where_it_sat_and_a_fast_response_takes_nothing_from_it() {
    for (speed, direction) in [(0.01, 1.0), (0.3, 1.0), (0.3, -1.0)] {
        let law = SlipLaw { sliding_speed: 0.5, ..TIP };
        let break_away = law.break_away / (1.0 + law.rate_weakening * speed / law.sliding_speed);
        let half = 0.5 * speed * PERIOD_S;
        let [before, quasi_static] = [break_away - half, break_away + half].map(|way| way * direction);
        let motion = Motion::new(0, &law, quasi_static, before, quasi_static - before, PERIOD_S);
        assert!((motion.break_away - break_away).abs() < 1e-12);
        let landed = sticking(before).slipped(direction, break_away - half, &law, &motion);
        let travel = direction * 1.6 * law.break_away;
        assert!((landed.level - travel).abs() < 1e-9, "{} instead of {travel}", landed.level);
    }
}

#[test]
fn moments_between_bounds_are_those_of_the_whole_of_a_slice_and_of_a_tail() {
    // Without bounds, over a slice that is all but a point, beyond zero (half of a normal deviate) and far in a tail.
    let close = |(mean, variance): (f64, f64), to: (f64, f64), by: f64| {
        assert!((mean - to.0).abs() < by && (variance - to.1).abs() < by, "{mean} and {variance} instead of {to:?}");
    };
    close(between(-40.0, 40.0, 2.0), (0.0, 4.0), 0.02);
    close(between(0.3, 0.301, 2.0), (0.3005, 0.0), 1e-6);
    let half = (2.0 / std::f64::consts::PI).sqrt();
    close(between(0.0, 40.0, 1.0), (half, 1.0 - half * half), 0.02);
    close(between(-40.0, 0.0, 1.0), (-half, 1.0 - half * half), 0.02);
    close(between(10.0, 40.0, 1.0), (10.0981, 0.0094), 0.01);
}

#[test]
fn a_slip_tells_no_more_than_that_the_distance_lies_between_what_was_borne_and_what_was_not() {
    // The quasi-static response went from 0.04 to 0.06 within the sample: where in it the tip broke away is not known, so nothing about the model error is.
    let motion = Motion::new(0, &TIP, 0.06, 0.04, 0.02, PERIOD_S);
    let held = sticking(0.04);
    let landed = held.slipped(1.0, 0.04, &TIP, &motion);
    assert!(landed.model_error.abs() < 1e-4 && (landed.model_error_variance / held.model_error_variance - 1.0).abs() < 0.05, "{landed:?}");
    assert!((landed.level - 0.08).abs() < 1e-3, "{}", landed.level);
}

#[test]
fn a_tip_with_presliding_creeps_after_the_response_while_it_sticks_and_slips_by_more_or_less_with_speed() {
    let law = SlipLaw { presliding: 0.1, ..TIP };
    let quasi_static: Vec<f64> = (0..200).map(|sample| 1.5e-4 * f64::from(sample)).collect();
    let measured: Vec<f64> = quasi_static.iter().map(|quasi_static| 0.1 * quasi_static).collect();
    let found = expected(&law, &quasi_static, &measured);
    assert!((found[199] - measured[199]).abs() < 2e-4, "{} instead of {}", found[199], measured[199]);
    let stiff = expected(&TIP, &quasi_static, &measured)[199];
    assert!(stiff < measured[199] - 4e-4, "{stiff} without presliding");
    let law = SlipLaw { slip_per_speed_s: -0.01, ..TIP };
    let motion = Motion::new(0, &law, 0.051, 0.049, 0.002, PERIOD_S);
    let landed = sticking(0.049).slipped(1.0, 0.049, &law, &motion);
    assert!((landed.level - (0.08 - 0.01 * 0.002 / PERIOD_S)).abs() < 1e-3, "{}", landed.level);
}

#[test]
fn a_slip_is_seen_on_its_way_and_arrives() {
    let law = SlipLaw { slip_s: 0.02, ..TIP };
    // It breaks away half a sample ago: half of a slip that takes a whole one.
    let motion = Motion::new(0, &law, 0.051, 0.049, 0.002, PERIOD_S);
    let landed = sticking(0.049).slipped(1.0, 0.049, &law, &motion);
    assert!((landed.to_come / 0.04 - 1.0).abs() < 0.1, "{} of a travel of 0.08 to come", landed.to_come);
    assert!(landed.to_come_variance > 0.0, "where in the sample it broke away is not known");
    let later = Hypothesis { since_s: landed.since_s + PERIOD_S, ..landed }.on_its_way(law.slip_s, PERIOD_S);
    assert_eq!((later.to_come, later.seen()), (0.0, landed.level));
    let at_once = sticking(0.049).slipped(1.0, 0.049, &TIP, &motion);
    assert_eq!((at_once.to_come, at_once.seen()), (0.0, at_once.level));
    // What it lands at is the same.
    assert!((landed.level - at_once.level).abs() < 1e-12);
}

#[test]
fn slips_tell_the_response_and_how_well_they_know_it_and_sticking_tells_of_a_response_that_is_too_far() {
    let law = SlipLaw { scatter: 0.01, model_error: 2e-4, ..TIP };
    let mut noise = deviates(0x9E37_79B9_7F4A_7C15);
    let (mut place, mut quasi_static, mut measured) = (0.0_f64, Vec::new(), Vec::new());
    for step in 0..6000 * 20 {
        let time_s = f64::from(step) * PERIOD_S / 20.0;
        let now = 0.5 - 0.5 * (0.7 * time_s).cos();
        if (now - place).abs() > law.break_away {
            place += (1.0 + law.overshoot) * law.break_away * (now - place).signum();
        }
        if step % 20 == 0 {
            quasi_static.push(now);
            measured.push(place + 0.002 * noise());
        }
    }
    let keep = vec![true; quasi_static.len()];
    let pseudo_measurements = |quasi_static: &[f64]| {
        let seen = Seen {
            command: quasi_static,
            followed: quasi_static,
            quasi_static,
            measured: &measured,
            keep: &keep,
            period_s: PERIOD_S,
            noise: 0.002,
            bank: None,
        };
        observe(&seen, &law).pseudo_measurements
    };
    let right = pseudo_measurements(&quasi_static);
    assert!(right.len() > 300, "{} slips", right.len());
    let errors: Vec<f64> = right
        .iter()
        .map(|pseudo_measurements| {
            (pseudo_measurements.quasi_static - quasi_static[pseudo_measurements.sample]) / pseudo_measurements.variance.sqrt()
        })
        .collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let spread = (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
    assert!(mean.abs() < 3.0 / (errors.len() as f64).sqrt() + 0.1, "off by {mean} deviations in the mean");
    assert!((0.7..1.3).contains(&spread), "{spread} deviations");
    // A quasi-static response that goes half a distance too far at the turns, where nothing slips: holding tells that it does not.
    let far = |value: f64| value + 0.5 * law.break_away * ((value - 0.97).max(0.0) / 0.03);
    let wrong: Vec<f64> = quasi_static.iter().map(|value| far(*value)).collect();
    let of_holds = pseudo_measurements(&wrong).into_iter().filter(|pseudo_measurements| {
        quasi_static[pseudo_measurements.sample] > 0.985 && pseudo_measurements.quasi_static < wrong[pseudo_measurements.sample]
    });
    let farther =
        of_holds.map(|pseudo_measurements| wrong[pseudo_measurements.sample] - pseudo_measurements.quasi_static).collect::<Vec<f64>>();
    assert!(farther.len() > 20, "{} of holds", farther.len());
}

#[test]
fn a_slip_that_comes_late_tells_that_the_response_is_ahead() {
    let (before, quasi_static) = (0.0595, 0.06);
    let motion = Motion::new(0, &TIP, quasi_static, before, quasi_static - before, PERIOD_S);
    let held = sticking(before);
    let landed = held.slipped(1.0, before, &TIP, &motion);
    assert!(landed.model_error < -5e-4, "{}", landed.model_error);
    assert!(landed.model_error_variance < held.model_error_variance);
    let sure = landed.level_variance * landed.model_error_variance;
    assert!(landed.covariance.powi(2) < sure, "a covariance of {} for variances with a product of {sure}", landed.covariance);
}

/// What is expected of a tip that comes from zero to `tip` while the quasi-static response steps to `to`; the step is at sample 100.
fn behind_a_step(law: &SlipLaw, to: f64, tip: f64) -> Vec<f64> {
    let stepping = |height: f64| [vec![0.0; 100], vec![height; 20]].concat();
    expected(law, &stepping(to), &stepping(tip))
}

#[test]
fn a_sample_may_hold_two_slips() {
    let found = behind_a_step(&TIP, 0.14, 0.16)[100];
    assert!((found - 0.16).abs() < 0.004, "{found} instead of two travels of 0.08");
}

#[test]
fn a_step_of_many_slips_is_followed_at_once() {
    let found = behind_a_step(&TIP, 0.9, 0.88);
    assert!((found[100] - 0.9).abs() < 1e-6, "{} at once", found[100]);
    assert!((found[101] - 0.88).abs() < 2e-3, "{} once it has been seen", found[101]);
}

#[test]
fn a_tip_that_runs_on_when_the_response_stops_is_found_at_once() {
    let found = behind_a_step(&SlipLaw { sliding_speed: 1.0, ..TIP }, 0.9, 0.94);
    assert!((found[101] - 0.94).abs() < 2e-3, "{} once it has been seen", found[101]);
}

#[test]
fn a_tip_moved_fast_slides_with_the_response_and_goes_on_when_that_slows_down() {
    let law = SlipLaw { sliding_speed: 1.0, ..TIP };
    // From rest to twice the sliding speed, then seven tenths of it.
    let speeds = [(0.0, 50), (2.0, 20), (0.7, 10)];
    let speeds = speeds.into_iter().flat_map(|(speed, samples)| std::iter::repeat_n(speed, samples));
    let quasi_static: Vec<f64> = speeds
        .scan(0.0, |place, speed| {
            *place += speed * PERIOD_S;
            Some(*place)
        })
        .collect();
    let found = expected(&law, &quasi_static, &quasi_static);
    for sample in 55..quasi_static.len() {
        assert!((found[sample] - quasi_static[sample]).abs() < 2e-3, "{} for {} at {sample}", found[sample], quasi_static[sample]);
    }
    // From rest to that speed at once it holds and slips.
    let slower: Vec<f64> = (0..60_u32).map(|sample| f64::from(sample.saturating_sub(50)) * 0.7 * PERIOD_S).collect();
    let held = vec![0.0; 60];
    assert!(expected(&law, &slower, &held)[51].abs() < 1e-3);
}
