//! Each model followed by its inverse is the identity, in both orders.

mod signals;

use hysteresis::{DeadZones, Error, ModifiedPrandtlIshlinskii, Operator, PrandtlIshlinskii, RateDependent, RateDependentConfig};
use proptest::prelude::*;
use signals::{cases, invertible, largest_difference, signal};

const CAPACITY: usize = 12;
/// What the project promises. Signals are up to 5, slopes 0.1 to 3 and there are at most 12 operators, so that rounding is expected near
/// 5 * 3 * 12 * 1e-16 / 0.1 = 2e-13 at worst.
const TOLERANCE: f64 = 1e-12;

type Model = PrandtlIshlinskii<f64, CAPACITY>;

/// A state that some history leads to, but not necessarily one from the start: random steps within the distances of the thresholds.
fn reachable(thresholds: &[f64], random: &[f64]) -> Vec<f64> {
    let (mut plays, mut last_threshold, mut play) = (Vec::new(), 0.0, 0.0);
    for (index, (threshold, random)) in thresholds.iter().zip(random).enumerate() {
        play += if index == 0 { 3.0 * random } else { random * (threshold - last_threshold) };
        last_threshold = *threshold;
        plays.push(play);
    }
    plays
}

proptest! {
    #![proptest_config(cases(2000))]

    #[test]
    fn prandtl_ishlinskii_and_its_inverse_undo_each_other((thresholds, weights) in invertible(), signal in signal()) {
        let model = Model::new(&thresholds, &weights).unwrap();
        let inverse = model.inverse().unwrap();
        let mut there_and_back = signal.clone();
        (model, inverse).process_in_place(&mut (model.start(), inverse.start()), &mut there_and_back);
        prop_assert!(largest_difference(&signal, &there_and_back) < TOLERANCE);
        let mut back_and_there = signal.clone();
        (inverse, model).process_in_place(&mut (inverse.start(), model.start()), &mut back_and_there);
        prop_assert!(largest_difference(&signal, &back_and_there) < TOLERANCE);
    }

    #[test]
    fn they_undo_each_other_from_any_state_that_a_history_leads_to(
        (thresholds, weights) in invertible(),
        random in prop::collection::vec(-1.0..1.0f64, CAPACITY),
        signal in signal(),
    ) {
        let model = Model::new(&thresholds, &weights).unwrap();
        let inverse = model.inverse().unwrap();
        let state = model.state_at(&reachable(&thresholds, &random)).unwrap();
        let inverse_state = model.inverse_state(&state);
        // The matching state must itself be one that the inverse can be in.
        prop_assert!(inverse.state_at(inverse_state.plays()).is_ok());
        let mut there_and_back = signal.clone();
        (model, inverse).process_in_place(&mut (state, inverse_state), &mut there_and_back);
        prop_assert!(largest_difference(&signal, &there_and_back) < TOLERANCE);
        let mut back_and_there = signal.clone();
        (inverse, model).process_in_place(&mut (inverse_state, state), &mut back_and_there);
        prop_assert!(largest_difference(&signal, &back_and_there) < TOLERANCE);
    }

    #[test]
    fn the_inverse_of_the_inverse_is_the_model((thresholds, weights) in invertible()) {
        let model = Model::new(&thresholds, &weights).unwrap();
        let twice = model.inverse().unwrap().inverse().unwrap();
        prop_assert!(largest_difference(model.thresholds(), twice.thresholds()) < TOLERANCE);
        // The slopes of the inverse reach 10, and a weight is a difference of two quotients by their products.
        prop_assert!(largest_difference(model.weights(), twice.weights()) < TOLERANCE);
    }

    #[test]
    fn the_modified_model_and_its_inverse_undo_each_other(
        (thresholds, weights) in invertible(),
        linear_weight in 0.1..3.0f64,
        sides in prop::collection::vec((0.01..2.0f64, 0.1..3.0f64), 6),
        signal in signal(),
    ) {
        let mut curve = Vec::new();
        for (side, sign) in sides.chunks(3).zip([-1.0, 1.0]) {
            let (mut threshold, mut slope) = (0.0, linear_weight);
            for (distance, next_slope) in side {
                threshold += distance;
                curve.push((sign * threshold, next_slope - slope));
                slope = *next_slope;
            }
        }
        curve.sort_by(|left, right| left.0.total_cmp(&right.0));
        let (dead_zones, curve_weights): (Vec<_>, Vec<_>) = curve.into_iter().unzip();
        let hysteresis = Model::new(&thresholds, &weights).unwrap();
        let curve = DeadZones::<f64, 6>::new(linear_weight, &dead_zones, &curve_weights).unwrap();
        let model = ModifiedPrandtlIshlinskii { hysteresis, curve };
        let inverse = model.inverse().unwrap();
        let mut there_and_back = signal.clone();
        (model, inverse).process_in_place(&mut (model.start(), inverse.start()), &mut there_and_back);
        // Two inversions in a row, each of which amplifies by ten at most.
        prop_assert!(largest_difference(&signal, &there_and_back) < 10.0 * TOLERANCE);
        let mut back_and_there = signal.clone();
        (inverse, model).process_in_place(&mut (inverse.start(), model.start()), &mut back_and_there);
        prop_assert!(largest_difference(&signal, &back_and_there) < 10.0 * TOLERANCE);
    }

    #[test]
    fn the_rate_dependent_inverse_undoes_the_model_when_the_dilation_condition_holds(
        (thresholds, weights) in invertible(),
        coefficient in 0.0..0.1f64,
        samples in prop::collection::vec((-5.0..5.0f64, -20.0..20.0f64), 1..200),
    ) {
        let mut coefficients = vec![coefficient; thresholds.len()];
        coefficients[0] = 0.0;
        let config =
            RateDependentConfig { thresholds: &thresholds, rate_coefficients_s: &coefficients, weights: &weights, sample_period_s: 0.02 };
        let model = RateDependent::<f64, CAPACITY>::new(&config).unwrap();
        let inverse = model.inverse().unwrap();
        let (mut state, mut inverse_state) = (model.start(), inverse.start());
        let (mut wanted_state, mut wanted_inverse_state) = (model.start(), inverse.start());
        for (sample, rate) in samples {
            let output = model.step_at_rate(&mut state, sample, rate);
            prop_assert!((inverse.step_at_rate(&mut inverse_state, output, rate) - sample).abs() < TOLERANCE);
            let input = inverse.step_at_rate(&mut wanted_inverse_state, sample, rate);
            prop_assert!((model.step_at_rate(&mut wanted_state, input, rate) - sample).abs() < TOLERANCE);
        }
    }
}

#[test]
fn the_dilation_condition_is_needed() {
    // The closed form with the thresholds of the moment, at a rate that comes and goes and coefficients that differ.
    let (thresholds, weights, coefficients) = ([0.0, 0.1, 0.2], [0.5, 0.3, 0.2], [0.0, 0.01, 0.05]);
    let (mut plays, mut inverse_plays) = ([0.0; 3], [0.0; 3]);
    let mut worst = 0.0f64;
    for step in 0..400 {
        let time = 0.02 * f64::from(step);
        let (input, speed) = (time.sin(), 5.0 * (3.0 * time).sin().abs());
        let now: Vec<f64> = thresholds.iter().zip(coefficients).map(|(threshold, coefficient)| threshold + coefficient * speed).collect();
        let output = hysteresis::prandtl_ishlinskii::step(&now, &weights, input, &mut plays);
        let (mut inverse_thresholds, mut inverse_weights) = ([0.0; 3], [0.0; 3]);
        hysteresis::prandtl_ishlinskii::invert(&now, &weights, &mut inverse_thresholds, &mut inverse_weights).unwrap();
        let back = hysteresis::prandtl_ishlinskii::step(&inverse_thresholds, &inverse_weights, output, &mut inverse_plays);
        worst = worst.max((back - input).abs());
    }
    assert!(worst > 1e-3, "{worst}");
    let config =
        RateDependentConfig { thresholds: &thresholds, rate_coefficients_s: &coefficients, weights: &weights, sample_period_s: 0.02 };
    let condition = "the rate coefficients of all operators with memory must be equal (dilation condition)";
    assert_eq!(RateDependent::<f64, 3>::new(&config).unwrap().inverse(), Err(Error::NotInvertible { condition, index: 2 }));
}

#[test]
fn the_closed_form_is_the_printed_one() {
    // By hand: W = 0.5, 0.75, 1; r' = 0, 0.5 * 1, 0.5 * 3 + 0.25 * 2; w' = 2, 4/3 - 2, 1 - 4/3.
    let inverse = Model::new(&[0.0, 1.0, 3.0], &[0.5, 0.25, 0.25]).unwrap().inverse().unwrap();
    assert_eq!(inverse.thresholds(), [0.0, 0.5, 2.0]);
    assert!(largest_difference(inverse.weights(), &[2.0, 4.0 / 3.0 - 2.0, 1.0 - 4.0 / 3.0]) < 1e-15);
}

#[test]
fn a_model_without_an_inverse_is_refused_by_name() {
    let inverse = |thresholds: &[f64], weights: &[f64]| Model::new(thresholds, weights).unwrap().inverse().unwrap_err();
    let slopes = "every partial sum of the weights must be above zero";
    assert_eq!(inverse(&[0.0, 1.0], &[0.0, 1.0]), Error::NotInvertible { condition: slopes, index: 0 });
    assert_eq!(inverse(&[0.0, 1.0, 2.0], &[1.0, -1.0, 1.0]), Error::NotInvertible { condition: slopes, index: 1 });
    let first = "the first threshold must be zero";
    assert_eq!(inverse(&[0.1, 1.0], &[1.0, 1.0]), Error::NotInvertible { condition: first, index: 0 });
    assert_eq!(inverse(&[], &[]), Error::NotInvertible { condition: first, index: 0 });
}

#[test]
fn single_precision_undoes_itself_to_its_own_accuracy() {
    let model = PrandtlIshlinskii::<f32, 5>::new(&[0.0, 0.15, 0.3, 0.45, 0.6], &[0.35, 0.25, 0.2, 0.12, 0.08]).unwrap();
    let both = (model, model.inverse().unwrap());
    let mut state = both.start();
    for step in 0..100_000u32 {
        let input = 1.0 + (0.013 * step as f32).sin() * (0.0007 * step as f32).cos();
        // Inputs up to 2 through slopes down to 0.35, about ten roundings: 2 * 10 * 6e-8 / 0.35.
        assert!((both.step(&mut state, input) - input).abs() < 4e-6, "at {step}");
    }
}
