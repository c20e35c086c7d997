//! The operators with a clock or a differential equation, against closed forms and fine references.

use hysteresis::{
    BoucWen, BoucWenConfig, DeadTime, Error, Hold, KelvinVoigt, KelvinVoigtConfig, Lag, LagConfig, LogCreep, LogCreepConfig, Operator,
};

#[test]
fn a_kelvin_voigt_chain_answers_a_step_by_its_closed_form() {
    let (instant, compliances, times_s, period_s) = (0.5, [0.1, 0.07, 0.05], [0.05, 1.3, 40.0], 0.02);
    let config = KelvinVoigtConfig {
        instant_compliance: instant,
        compliances: &compliances,
        retardation_times_s: &times_s,
        sample_period_s: period_s,
        hold: Hold::Newest,
    };
    let chain = KelvinVoigt::<f64, 4>::new(&config).unwrap();
    let mut state = chain.state_at(0.0);
    for step in 1..=50_000u32 {
        let time_s = period_s * f64::from(step);
        let exact: f64 = instant + compliances.iter().zip(times_s).map(|(j, tau)| -j * (-time_s / tau).exp_m1()).sum::<f64>();
        assert!((chain.step(&mut state, 2.0) - 2.0 * exact).abs() < 1e-13, "at {time_s} s");
    }
    // Fully crept, it is in the equilibrium that a fresh start assumes.
    assert!((chain.step(&mut chain.start(), 2.0) - chain.step(&mut state, 2.0)).abs() < 1e-9);
}

#[test]
fn a_kelvin_voigt_chain_in_single_precision_does_not_lose_slow_creep() {
    // One hour of a constant load at 1 kHz and a time constant of an hour: coefficients near 3e-7.
    let config = KelvinVoigtConfig {
        instant_compliance: 0.0f32,
        compliances: &[1.0],
        retardation_times_s: &[3600.0],
        sample_period_s: 1e-3,
        hold: Hold::Newest,
    };
    let chain = KelvinVoigt::<f32, 1>::new(&config).unwrap();
    let (mut state, mut output) = (chain.state_at(0.0), 0.0);
    for _ in 0..3_600_000 {
        output = chain.step(&mut state, 1.0);
    }
    let exact = 1.0 - (-1.0f64).exp();
    // Increments of 1e-7 to 3e-7 are rounded to multiples of 3e-8 or 6e-8; measured: 2e-4. A chain that lost them would stand far below.
    println!("single precision after an hour: {output}, exact {exact}");
    assert!((f64::from(output) - exact).abs() < 1e-3);
}

/// Largest deviation of `N` elements' step response from the law, between 5 shortest and 1/20 of the longest time, as a part of the creep
/// a decade.
fn deviation_from_the_law<const N: usize>() -> f64 {
    let config =
        LogCreepConfig { creep_per_decade: 0.05, shortest_time_s: 0.1, longest_time_s: 1e5, sample_period_s: 0.01, hold: Hold::Newest };
    let creep = LogCreep::<f64, N>::new(&config).unwrap();
    let mut state = creep.state_at(0.0);
    (1..=500_000u32).fold(0.0, |worst, step| {
        let time_s = 0.01 * f64::from(step);
        let law = 1.0 + 0.05 * (time_s / 0.1).log10();
        let deviation = (creep.step(&mut state, 1.0) - law).abs() / 0.05;
        if time_s < 0.5 { worst } else { worst.max(deviation) }
    })
}

#[test]
fn log_creep_moves_by_the_same_amount_every_decade() {
    // Six decades. What the module's documentation promises.
    let (one_a_decade, two_a_decade) = (deviation_from_the_law::<6>(), deviation_from_the_law::<12>());
    println!("deviation with one element a decade {one_a_decade:.4}, with two {two_a_decade:.4}");
    assert!(one_a_decade < 0.035 && two_a_decade < 0.015);
}

#[test]
fn log_creep_ends_with_the_laws_value_at_the_longest_time() {
    let config =
        LogCreepConfig { creep_per_decade: 0.1, shortest_time_s: 0.1, longest_time_s: 10.0, sample_period_s: 1.0, hold: Hold::Linear };
    let creep = LogCreep::<f64, 4>::new(&config).unwrap();
    let mut state = creep.state_at(0.0);
    let mut signal = [3.0; 2000];
    creep.process_in_place(&mut state, &mut signal);
    assert!((signal[1999] - 3.0 * 1.2).abs() < 1e-12);
}

#[test]
fn log_creep_refuses_more_than_a_decade_an_element() {
    let config =
        LogCreepConfig { creep_per_decade: 0.1f32, shortest_time_s: 0.1, longest_time_s: 1000.0, sample_period_s: 1.0, hold: Hold::Newest };
    assert!(LogCreep::<f32, 4>::new(&config).is_ok());
    let domain = "at most one decade an element above shortest_time_s";
    assert_eq!(LogCreep::<f32, 3>::new(&config), Err(Error::OutOfDomain { parameter: "longest_time_s", domain }));
}

#[test]
fn dead_time_and_lag_in_series_are_the_delayed_exponential() {
    let dead_time = DeadTime::<f64, 8>::from_seconds(0.06, 0.02).unwrap();
    let lag = Lag::new(&LagConfig { time_constant_s: 0.2, sample_period_s: 0.02, hold: Hold::Newest }).unwrap();
    let path = (dead_time, lag);
    let mut state = path.start();
    assert_eq!(path.step(&mut state, 0.0), 0.0);
    for step in 0..500u32 {
        let since_arrival_s = 0.02 * (f64::from(step) - 2.0);
        let exact = if step < 3 { 0.0 } else { -(-since_arrival_s / 0.2).exp_m1() };
        assert!((path.step(&mut state, 1.0) - exact).abs() < 1e-14, "at {step}");
    }
}

fn bouc_wen(beta: f64, gamma: f64, exponent: f64, steps_per_length: u16) -> BoucWen<f64> {
    BoucWen::new(&BoucWenConfig { stiffness: 1.0, elastic_fraction: 0.0, amplitude: 1.0, beta, gamma, exponent, steps_per_length }).unwrap()
}

/// Largest error over one virgin curve up to `x = 3` and the way back to -3, against the closed forms that the test names.
fn worst(model: &BoucWen<f64>, up: impl Fn(f64) -> f64, down: impl Fn(f64) -> f64) -> f64 {
    let mut state = model.start();
    let mut worst = 0.0f64;
    for step in 1..=30u32 {
        let x = 0.1 * f64::from(step);
        worst = worst.max((model.step(&mut state, x) - up(x)).abs());
    }
    for step in 1..=60u32 {
        let travelled = 0.1 * f64::from(step);
        worst = worst.max((model.step(&mut state, 3.0 - travelled) - down(travelled)).abs());
    }
    worst
}

#[test]
fn bouc_wen_of_exponent_one_is_the_exponential() {
    // beta = 0.75, gamma = 0.25: loading z' = 1 - z. Unloading from z0: z' = -1 - z / 2 down to zero, then z' = -1 - z.
    let up = |x: f64| 1.0 - (-x).exp();
    let z0 = up(3.0);
    let to_zero = 2.0 * (1.0 + z0 / 2.0).ln();
    let down = |s: f64| if s < to_zero { (2.0 + z0) * (-s / 2.0).exp() - 2.0 } else { (to_zero - s).exp() - 1.0 };
    let error = worst(&bouc_wen(0.75, 0.25, 1.0, 64), up, down);
    // One step across z = 0, where the slope's derivative jumps by one half: an error of about h^2 / 8 of that step, h = 1/64.
    assert!(error < 0.5 / 8.0 / 64.0f64.powi(2), "{error}");
}

#[test]
fn bouc_wen_of_exponent_two_is_the_hyperbolic_tangent() {
    // beta = gamma = 1/2: loading z' = 1 - z^2; unloading is straight to zero and then the same curve.
    let up = |x: f64| x.tanh();
    let z0 = up(3.0);
    let down = |s: f64| if s < z0 { z0 - s } else { -(s - z0).tanh() };
    let error = worst(&bouc_wen(0.5, 0.5, 2.0, 8), up, down);
    println!("eight steps a length: error {error:.1e}");
    assert!(error < 2e-5, "{error}");
}

#[test]
fn bouc_wen_converges_with_the_fourth_order() {
    // One sample to x = 0.75 on the smooth virgin curve, so that the model's own sub-steps do all the work.
    let errors = [4, 8, 16, 32].map(|steps| {
        let model = bouc_wen(0.5, 0.5, 2.0, steps);
        (model.step(&mut model.start(), 0.75) - 0.75f64.tanh()).abs()
    });
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((3.7..4.7).contains(&order), "{errors:?}");
    }
}

#[test]
fn bouc_wen_agrees_with_a_fine_integration_in_time() {
    // Independent: the equation as printed, in time, by the midpoint rule at 20,000 steps a second.
    let (beta, gamma, exponent) = (0.8, 0.3, 1.7);
    let model = bouc_wen(beta, gamma, exponent, 32);
    let mut state = model.start();
    let rate = |time: f64, z: f64| {
        let speed = 2.0 * time.cos() + 0.9 * 3.1 * (3.1 * time).cos();
        speed - beta * speed.abs() * z.abs().powf(exponent - 1.0) * z - gamma * speed * z.abs().powf(exponent)
    };
    let (step_s, mut z, mut worst) = (1.0 / 20_000.0, 0.0, 0.0f64);
    for sample in 0..4000u32 {
        for fine in 0..100u32 {
            let time = step_s * (f64::from(sample) * 100.0 + f64::from(fine));
            let middle = z + step_s / 2.0 * rate(time, z);
            z += step_s * rate(time + step_s / 2.0, middle);
        }
        let time = 0.005 * f64::from(sample + 1);
        let input = 2.0 * time.sin() + 0.9 * (3.1 * time).sin();
        worst = worst.max((model.step(&mut state, input) - z).abs());
    }
    println!("largest difference from the fine integration: {worst:.1e}");
    // Reversals between samples are cut by up to speed' * dt^2 / 8 = 11 * 25e-6 / 8.
    assert!(worst < 5e-5, "{worst}");
}

#[test]
fn bouc_wen_does_not_care_how_a_distance_is_divided() {
    let model = bouc_wen(0.8, 0.3, 1.7, 64);
    let (mut whole, mut divided) = (model.start(), model.start());
    for target in [1.4, -0.3, 0.9, -2.0, 100.0, 0.0, 1e9, 1e9 - 1.0] {
        let from = divided.input();
        for part in 1..=50u32 {
            model.step(&mut divided, from + (target - from) * f64::from(part) / 50.0);
        }
        let (left, right) = (model.step(&mut whole, target), model.step(&mut divided, target));
        // Steps of at most 1/64 and fewer: both within the method's error.
        assert!((left - right).abs() < 2e-6, "at {target}: {left} {right}");
    }
}

#[test]
fn bouc_wen_refuses_what_would_not_dissipate_or_diverge() {
    let with = |beta, gamma, exponent, steps_per_length| {
        let config = BoucWenConfig { stiffness: 1.0, elastic_fraction: 0.0, amplitude: 1.0, beta, gamma, exponent, steps_per_length };
        BoucWen::<f64>::new(&config).unwrap_err()
    };
    assert_eq!(with(0.0, 0.0, 1.0, 8), Error::OutOfDomain { parameter: "beta", domain: "above zero" });
    assert_eq!(with(1.0, -1.0, 1.0, 8), Error::OutOfDomain { parameter: "gamma", domain: "above -beta and at most beta" });
    assert_eq!(with(1.0, 1.5, 1.0, 8), Error::OutOfDomain { parameter: "gamma", domain: "above -beta and at most beta" });
    assert_eq!(with(1.0, 0.5, 0.9, 8), Error::OutOfDomain { parameter: "exponent", domain: "one or more" });
    assert_eq!(with(1.0, 0.5, 1.0, 0), Error::OutOfDomain { parameter: "steps_per_length", domain: "1 to 1000" });
    assert_eq!(with(f64::NAN, 0.5, 1.0, 8), Error::NotFinite { parameter: "beta" });
}

#[test]
fn bouc_wen_survives_a_sample_that_is_no_number() {
    let model = bouc_wen(0.5, 0.5, 1.0, 8);
    let (mut state, mut clean) = (model.start(), model.start());
    model.step(&mut state, 0.4);
    model.step(&mut clean, 0.4);
    assert!(!model.step(&mut state, f64::NAN).is_finite());
    assert_eq!(model.step(&mut state, 0.9), model.step(&mut clean, 0.9));
}
