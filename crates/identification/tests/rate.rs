//! Thresholds that follow the speed of the input: found where another law of them is hidden, left alone where there is none.

use identification::search::{RungResult, Search};
use identification::{Partition, Rung, Series, physics_rungs};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Seconds between samples, and samples of a recording.
const PERIOD_S: f64 = 0.02;
const SAMPLES: usize = 1_000;

/// Play operators whose thresholds are `r + alpha ln(1 + speed / v0)`, each with an alpha of its own, which the rung has not, and noise of
/// 0.3 % of the range.
fn recordings(alpha: f64, seed: u64) -> Vec<Series> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let one = |number: usize| {
        let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        // A slow and a fast part: each recording has slow and fast reversals.
        let (slow_hz, fast_hz, share) = (uniform(0.05, 0.15), uniform(0.5, 2.5), uniform(0.2, 0.6));
        let (phase, swell) = (uniform(0.0, 6.0), uniform(0.03, 0.1));
        let wave = |index: usize| {
            let angle = std::f64::consts::TAU * PERIOD_S * index as f64;
            (1.0 - share) * (slow_hz * angle + phase).sin() + share * (swell * angle).sin().abs() * (fast_hz * angle).sin()
        };
        let input: Vec<f64> = (0..SAMPLES).map(wave).collect();
        let mut plays = [input[0]; 3];
        let mut output = Vec::new();
        for (index, &x) in input.iter().enumerate() {
            let speed = (x - input[index.saturating_sub(1)]).abs() / PERIOD_S;
            let wider = alpha * (1.0 + speed / 0.6).ln();
            let mut sum = 0.6 * x;
            for (state, (threshold, weight, share)) in plays.iter_mut().zip([(0.05, 1.0, 0.7), (0.15, 0.7, 1.0), (0.3, 0.7, 1.3)]) {
                let threshold = threshold + share * wider;
                *state = state.clamp(x - threshold, x + threshold);
                sum += weight * *state;
            }
            output.push(sum + 0.036 * (uniform(0.0, 1.0) - 0.5));
        }
        Series { name: format!("r{number}"), group: String::new(), inputs: vec![input], output, gaps: Vec::new(), skip: 0 }
    };
    (0..8).map(one).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The rung with fixed thresholds and the one whose thresholds may follow the speed, each judged by recordings left out.
fn judged(series: &[Series]) -> [RungResult; 2] {
    let names = ["curve", "PI", "PI + curve", "PI + dynamics", "curve + dynamics", "PI + curve + dynamics", "PI + curve + rate"];
    let rungs: Vec<Rung> = physics_rungs().into_iter().filter(|rung| names.contains(&rung.name)).collect();
    let partition = Partition::new(series);
    let found = Search::new(series, &partition, PERIOD_S, 1).nested(&rungs, 2, &|_, _| {});
    let [.., fixed, following] = &found[..] else { panic!("{} rungs", found.len()) };
    [fixed.clone(), following.clone()]
}

#[test]
fn another_law_of_rate_is_found() {
    let [fixed, following] = judged(&recordings(0.07, 31));
    let [before, after] = [&fixed, &following].map(|rung| mean(&rung.errors));
    println!("{before} with fixed thresholds, {after} with {:?}", following.model.structure.widening);
    assert!(following.model.structure.widening.is_some_and(|widening| widening.gain > 0.0), "{:?}", following.found.recipe);
    // The noise alone is 0.0104.
    assert!(after < 0.6 * before, "{before} with fixed thresholds, {after} with thresholds that follow the speed");
}

#[test]
fn where_there_is_none_nothing_is_gained_or_lost() {
    let [fixed, following] = judged(&recordings(0.0, 32));
    let [before, after] = [&fixed, &following].map(|rung| mean(&rung.errors));
    println!("{before} with fixed thresholds, {after} with {:?}", following.model.structure.widening);
    assert!((after / before - 1.0).abs() < 0.03, "{before} with fixed thresholds, {after} with thresholds that follow the speed");
}
