//! The properties that make an operator a hysteresis operator: memory, its erasure, loops, and independence of time.

mod signals;

use hysteresis::{BoucWen, BoucWenConfig, Error, Operator, Play, PrandtlIshlinskii, RateDependent, RateDependentConfig, Stop};
use proptest::prelude::*;
use signals::{cases, invertible, largest_difference, signal};

type Model = PrandtlIshlinskii<f64, 12>;

/// Samples from each turning point to the next, `steps` apiece, both ends included once.
fn travel(turning_points: &[f64], steps: u32) -> Vec<f64> {
    let legs = turning_points.windows(2).flat_map(|leg| {
        (1..=steps).map(move |step| if step == steps { leg[1] } else { leg[0] + (leg[1] - leg[0]) * f64::from(step) / f64::from(steps) })
    });
    turning_points.first().copied().into_iter().chain(legs).collect()
}

fn run<O: Operator<f64>>(operator: &O, input: &[f64]) -> Vec<f64> {
    let mut output = vec![0.0; input.len()];
    operator.process(&mut operator.start(), input, &mut output).unwrap();
    output
}

/// Area that the closed curve of points (input, output) encloses, by the trapezoidal rule; positive when run clockwise.
fn area(input: &[f64], output: &[f64]) -> f64 {
    let next = (1..input.len()).chain([0]);
    next.enumerate().map(|(index, next)| (input[next] - input[index]) * (output[next] + output[index]) / -2.0).sum()
}

#[test]
fn a_play_operator_follows_a_triangle_along_a_parallelogram() {
    let (threshold, amplitude, steps) = (0.3, 1.0, 1000);
    let input = travel(&[0.0, amplitude, -amplitude, amplitude], steps);
    let output = run(&Play::new(threshold).unwrap(), &input);
    for (index, (input, output)) in input.iter().zip(&output).enumerate() {
        let exact = match index / 1000 {
            0 => (input - threshold).max(0.0),
            1 => (input + threshold).min(amplitude - threshold),
            _ => (input - threshold).max(-amplitude + threshold),
        };
        assert!((output - exact).abs() < 1e-15, "at {index}");
    }
    // Width 2 r, height 2 (A - r); the last two legs are one whole loop. The corners lie within one sample: error below 2 (2 A / steps)^2.
    let loop_area = area(&input[1001..], &output[1001..]);
    assert!(
        (loop_area.abs() - 4.0 * threshold * (amplitude - threshold)).abs() < 2.0 * (2.0 * amplitude / 1000.0f64).powi(2),
        "{loop_area}"
    );
}

#[test]
fn the_loop_area_of_a_model_is_the_weighted_sum_of_its_plays() {
    let (thresholds, weights, amplitude) = ([0.0, 0.15, 0.3, 0.45, 1.2], [0.35, 0.25, 0.2, 0.12, 0.08], 1.0f64);
    let input = travel(&[0.0, amplitude, -amplitude, amplitude], 2000);
    let output = run(&Model::new(&thresholds, &weights).unwrap(), &input);
    let expected: f64 = thresholds.iter().zip(weights).map(|(r, w)| 4.0 * w * r * (amplitude - r).max(0.0)).sum();
    assert!((area(&input[2001..], &output[2001..]).abs() - expected).abs() < 1e-5);
}

#[test]
fn a_model_gives_what_the_papers_equations_give_by_hand() {
    let model = Model::new(&[0.0, 0.25, 0.5], &[0.5, 0.25, 0.125]).unwrap();
    // Eqs. (2) and (3) written out, H: (0.125, 0, 0), (1, 0.75, 0.5), (0.25, 0.5, 0.5), (-1, -0.75, -0.5): all exact in binary.
    let outputs = run(&model, &[0.125, 1.0, 0.25, -1.0]);
    assert_eq!(outputs, [0.0625, 0.75, 0.3125, -0.75]);
}

#[test]
fn refuses_parameters_and_states_that_are_none() {
    assert_eq!(Model::new(&[0.0, 0.0], &[1.0, 1.0]), Err(Error::NotAscending { parameter: "thresholds", index: 1 }));
    assert_eq!(Model::new(&[-0.1], &[1.0]), Err(Error::OutOfDomain { parameter: "thresholds", domain: "zero or more" }));
    assert_eq!(Model::new(&[0.0], &[1.0, 1.0]), Err(Error::LengthMismatch { expected: 1, found: 2 }));
    assert_eq!(Model::new(&[0.0], &[f64::NAN]), Err(Error::NotFinite { parameter: "weights" }));
    assert_eq!(PrandtlIshlinskii::<f64, 1>::new(&[0.0, 1.0], &[1.0, 1.0]), Err(Error::TooLong { capacity: 1, found: 2 }));
    let model = Model::new(&[0.0, 0.25, 0.5], &[1.0, 1.0, 1.0]).unwrap();
    assert!(model.state_at(&[7.0, 7.25, 7.0]).is_ok());
    assert_eq!(model.state_at(&[7.0, 7.25, 7.75]), Err(Error::UnreachableState { index: 2 }));
    assert_eq!(model.state_at(&[7.0, 7.25]), Err(Error::LengthMismatch { expected: 3, found: 2 }));
    assert_eq!(model.process(&mut model.start(), &[1.0], &mut []), Err(Error::LengthMismatch { expected: 1, found: 0 }));
}

#[test]
fn a_nan_sample_holds_the_output_and_costs_no_memory() {
    let model = Model::new(&[0.0, 0.25, 0.5], &[0.5, 0.25, 0.125]).unwrap();
    let outputs = run(&model, &[0.125, 1.0, f64::NAN, 0.25, f64::NAN, -1.0]);
    assert_eq!(outputs, [0.0625, 0.75, 0.75, 0.3125, 0.3125, -0.75]);
}

#[test]
fn rate_dependent_loops_open_with_speed_and_close_to_the_static_ones_at_rest() {
    let (thresholds, weights) = ([0.0, 0.2], [0.5, 0.5]);
    let config =
        RateDependentConfig { thresholds: &thresholds, rate_coefficients_s: &[0.0, 0.1], weights: &weights, sample_period_s: 0.01 };
    let model = RateDependent::<f64, 2>::new(&config).unwrap();
    for speed in [0.01, 0.5, 2.0] {
        // A triangle of amplitude 1 has 1/speed seconds a quarter; the threshold is 0.2 + 0.1 speed all along but at the first sample.
        let input = travel(&[0.0, 1.0, 0.0, -1.0, 0.0, 1.0], (1.0f64 / speed / 0.01).round() as u32);
        let one_loop = input.len() / 5 + 1..;
        let loop_area = area(&input[one_loop.clone()], &run(&model, &input)[one_loop]).abs();
        let r: f64 = 0.2 + 0.1 * speed;
        // Corners within one sample, speed * 0.01 long.
        assert!((loop_area - 4.0 * 0.5 * r * (1.0 - r)).abs() < 4.0 * speed * 0.01, "{speed}: {loop_area}");
    }
    // All coefficients zero: the static model to the bit.
    let config = RateDependentConfig { rate_coefficients_s: &[0.0, 0.0], ..config };
    let input = travel(&[0.0, 1.0, -0.7, 0.3], 37);
    let still = RateDependent::<f64, 2>::new(&config).unwrap();
    assert_eq!(run(&still, &input), run(&Model::new(&thresholds, &weights).unwrap(), &input));
}

/// The definition of the stop operator by its own recursion, as an independent reference.
fn stop_by_recursion(threshold: f64, input: &[f64]) -> Vec<f64> {
    let (mut output, mut last) = (0.0f64, 0.0);
    input
        .iter()
        .map(|input| {
            output = (output + input - last).clamp(-threshold, threshold);
            last = *input;
            output
        })
        .collect()
}

proptest! {
    #![proptest_config(cases(1000))]

    #[test]
    fn play_is_the_papers_nested_maximum_and_minimum(threshold in 0.0..2.0f64, signal in signal()) {
        let output = run(&Play::new(threshold).unwrap(), &signal);
        let mut last = 0.0f64;
        for (input, output) in signal.iter().zip(output) {
            last = f64::max(input - threshold, f64::min(input + threshold, last));
            prop_assert_eq!(output, last);
        }
    }

    #[test]
    fn stop_and_play_together_are_the_input(threshold in 0.0..2.0f64, signal in signal()) {
        let play = run(&Play::new(threshold).unwrap(), &signal);
        let stop = run(&Stop::new(threshold).unwrap(), &signal);
        for ((input, play), stop) in signal.iter().zip(play).zip(&stop) {
            // One rounding of numbers up to 7.
            prop_assert!((play + stop - input).abs() <= 1e-15);
            prop_assert!(stop.abs() <= threshold + 1e-15);
        }
        // The recursion collects a rounding of numbers up to 10 each step: 200 * 2e-15.
        prop_assert!(largest_difference(&stop, &stop_by_recursion(threshold, &signal)) < 4e-13);
    }

    #[test]
    fn an_excursion_that_returns_to_its_reversal_point_is_forgotten(
        (thresholds, weights) in invertible(),
        history in signal(),
        depth in 0.0..4.0f64,
        inner in prop::collection::vec(0.0..1.0f64, 1..20),
        future in signal(),
    ) {
        let model = Model::new(&thresholds, &weights).unwrap();
        let mut state = model.start();
        let mut ignored = history.clone();
        model.process_in_place(&mut state, &mut ignored);
        // A leg upwards to `top`, above all of the past or not; then anything between bottom and top; then back to top.
        let top = history[history.len() - 1] + depth;
        model.step(&mut state, top);
        let (mut direct, mut wandered) = (state, state);
        let bottom = top - depth;
        for position in inner {
            model.step(&mut wandered, bottom + position * depth);
        }
        let back = model.step(&mut wandered, top);
        prop_assert!((back - model.output(&state)).abs() < 1e-12);
        for input in future {
            prop_assert!((model.step(&mut direct, input) - model.step(&mut wandered, input)).abs() < 1e-12);
        }
    }

    #[test]
    fn loops_between_the_same_reversal_points_are_congruent(
        (thresholds, weights) in invertible(),
        histories in (signal(), signal()),
        low in -3.0..3.0f64,
        height in 0.0..3.0f64,
    ) {
        let model = Model::new(&thresholds, &weights).unwrap();
        let one_loop = travel(&[low, low + height, low], 20);
        let [first, second] = [histories.0, histories.1].map(|mut history| {
            let mut state = model.start();
            model.process_in_place(&mut state, &mut history);
            // Once round, so that both have left the initial branch; then the loop.
            for input in &one_loop {
                model.step(&mut state, *input);
            }
            one_loop.iter().map(|input| model.step(&mut state, *input)).collect::<Vec<_>>()
        });
        for (left, right) in first.iter().zip(&second) {
            prop_assert!((left - first[0] - (right - second[0])).abs() < 1e-12);
        }
    }

    #[test]
    fn the_speed_of_the_input_does_not_matter((thresholds, weights) in invertible(), turning_points in signal(), steps in 1..9u32) {
        let model = Model::new(&thresholds, &weights).unwrap();
        let fast = run(&model, &turning_points);
        let slow = run(&model, &travel(&turning_points, steps));
        // Where the two sample the same point they agree to the bit: a play operator knows only the extremes.
        let at_turning_points: Vec<f64> = slow.into_iter().step_by(steps as usize).collect();
        prop_assert_eq!(fast, at_turning_points);
    }

    #[test]
    fn one_sample_at_a_time_batches_and_stored_states_agree((thresholds, weights) in invertible(), signal in signal(), cut in 0.0..1.0f64) {
        let model = Model::new(&thresholds, &weights).unwrap();
        let whole = run(&model, &signal);
        let (before, after) = signal.split_at((cut * signal.len() as f64) as usize);
        let mut pieces = before.to_vec();
        let mut state = model.start();
        model.process_in_place(&mut state, &mut pieces);
        let mut restored = model.state_at(state.plays()).unwrap();
        pieces.extend(after.iter().map(|input| model.step(&mut restored, *input)));
        prop_assert_eq!(&whole, &pieces);
        model.reset(&mut restored);
        prop_assert_eq!(whole[0], model.step(&mut restored, signal[0]));
    }

    #[test]
    fn single_precision_agrees_with_double((thresholds, weights) in invertible(), signal in signal()) {
        let narrow = |values: &[f64]| values.iter().map(|value| *value as f32).collect::<Vec<_>>();
        let wide = run(&Model::new(&thresholds, &weights).unwrap(), &signal);
        let model = PrandtlIshlinskii::<f32, 12>::new(&narrow(&thresholds), &narrow(&weights)).unwrap();
        let mut output = narrow(&signal);
        model.process_in_place(&mut model.start(), &mut output);
        // Twelve weights up to 3 on plays up to 5: 12 * 3 * 5 * 2 roundings of 6e-8.
        prop_assert!(wide.iter().zip(output).all(|(wide, narrow)| (wide - f64::from(narrow)).abs() < 2.2e-5));
    }

}

proptest! {
    // Fewer: each sample may take hundreds of Runge-Kutta steps.
    #![proptest_config(cases(100))]

    #[test]
    fn the_memory_of_bouc_wen_stays_within_its_bound(
        signal in signal(),
        scale in prop_oneof![Just(0.01), Just(1.0), Just(1e6)],
        gamma in -0.9..1.0f64,
        exponent in 1.0..5.0f64,
        steps_per_length in 1..20u16,
    ) {
        let config = BoucWenConfig { stiffness: 2.0, elastic_fraction: 0.1, amplitude: 1.0, beta: 1.0, gamma, exponent, steps_per_length };
        let model = BoucWen::new(&config).unwrap();
        let mut state = model.start();
        for input in signal {
            model.step(&mut state, scale * input);
            prop_assert!(state.memory().abs() <= model.largest_memory());
        }
    }
}
