//! Which nuisances the data name: those that are hidden in virtual recordings of a known shape, and none where nothing is hidden.

use identification::search::Search;
use identification::{Covariate, Nuisances, Partition, Series};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Seconds between samples, samples of a recording, and the output's range, about.
const PERIOD_S: f64 = 0.05;
const SAMPLES: usize = 600;
const RANGE: f64 = 6.0;

/// What the recordings are of.
#[derive(Clone, Copy, Debug)]
enum Map {
    /// Play operators and a lag.
    Operators,
    /// The same with creep over half a recording.
    Creep,
    /// A loop whose width grows with the input, which no sum of operators has.
    Bent,
}

/// How recordings begin and go on.
#[derive(Clone, Copy, Debug)]
enum Excitation {
    /// Sums of two sines of any amplitude.
    Sines,
    /// Each about an operating point of its own, which it is at from the start.
    OperatingPoints,
}

fn standard(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

fn recording(map: Map, excitation: Excitation, noise: f64, number: usize, random: &mut ChaCha8Rng) -> Series {
    let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    let (slow_hz, fast_hz, phase) = (uniform(0.06, 0.15), uniform(0.3, 0.6), uniform(0.0, 6.0));
    let (centre, amplitude) = match excitation {
        Excitation::Sines => (1.0, uniform(0.5, 1.0)),
        Excitation::OperatingPoints => (uniform(0.3, 1.7), uniform(0.2, 0.3)),
    };
    let wave = |index: usize| {
        let angle = std::f64::consts::TAU * PERIOD_S * index as f64;
        amplitude * (0.7 * (slow_hz * angle + phase).sin() + 0.3 * (fast_hz * angle).sin())
    };
    let input: Vec<f64> = (0..SAMPLES).map(|index| centre + (index as f64 / 40.0).min(1.0) * wave(index)).collect();
    let mut plays = [input[0]; 3];
    let (mut lagged, mut crept) = (f64::NAN, 0.0);
    let mut output = Vec::new();
    for &x in &input {
        let mut sum = 0.6 * x;
        for (state, (threshold, weight)) in plays.iter_mut().zip([(0.08, 1.0), (0.2, 0.7), (0.4, 0.7)]) {
            *state = state.clamp(x - threshold, x + threshold);
            sum += weight * *state;
        }
        if matches!(map, Map::Bent) {
            sum += 0.4 * (x - plays[1]) * x + 0.2 * x * x;
        }
        lagged = if lagged.is_nan() { sum } else { lagged + 0.3 * (sum - lagged) };
        crept += (x - input[0] - crept) * PERIOD_S / (0.5 * SAMPLES as f64 * PERIOD_S);
        let creep = if matches!(map, Map::Creep) { 0.5 * crept } else { 0.0 };
        output.push(lagged + creep + noise * standard(random));
    }
    Series { name: format!("r{number}"), group: String::new(), inputs: vec![input], output, gaps: Vec::new(), skip: 0 }
}

/// What is hidden, as shares of the range.
#[derive(Clone, Copy, Debug, Default)]
struct Hidden {
    zeros: f64,
    drift: f64,
    temperature: f64,
    step: f64,
}

struct Set {
    series: Vec<Series>,
    covariates: Vec<Covariate>,
    offsets: Vec<f64>,
}

fn set(map: Map, excitation: Excitation, noise: f64, count: usize, hidden: Hidden, seed: u64) -> Set {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut series: Vec<Series> = (0..count).map(|number| recording(map, excitation, noise, number, &mut random)).collect();
    let (mut hours, mut warmth, mut offsets) = (Vec::new(), Vec::new(), Vec::new());
    for (number, one) in series.iter_mut().enumerate() {
        let warm = 22.0 + 3.0 * standard(&mut random);
        let offset = hidden.zeros * RANGE * standard(&mut random);
        let hour: Vec<f64> = (0..SAMPLES).map(|index| number as f64 * 0.5 + index as f64 * PERIOD_S / 3600.0).collect();
        for (index, output) in one.output.iter_mut().enumerate() {
            let behind = number % 3 == 1 && index >= SAMPLES / 2 + 23;
            *output += offset
                + hidden.drift * RANGE * hour[index] / (0.5 * (count - 1) as f64)
                + hidden.temperature * RANGE * (warm - 22.0) / 6.0
                + if behind { hidden.step * RANGE } else { 0.0 };
        }
        hours.push(hour);
        warmth.push(vec![warm; SAMPLES]);
        offsets.push(offset);
    }
    let covariate = |name: &str, unit: &str, values| Covariate { name: name.to_owned(), unit: unit.to_owned(), values };
    Set { series, covariates: vec![covariate("drift", "h", hours), covariate("temperature", "degC", warmth)], offsets }
}

fn decide(set: &Set) -> Nuisances {
    let partition = Partition::new(&set.series);
    let search = Search::new(&set.series, &partition, PERIOD_S, 1).with_covariates(set.covariates.clone());
    (*search.nuisances(&partition.training())).clone()
}

fn names(found: &Nuisances) -> Vec<&'static str> {
    let covariate = |index: usize| found.covariates.get(index).is_some_and(Option::is_some);
    let all = [("zeros", found.zeros), ("drift", covariate(0)), ("temperature", covariate(1)), ("step", found.steps.contains(&true))];
    all.into_iter().filter(|(_, named)| *named).map(|(name, _)| name).collect()
}

#[test]
#[ignore = "exploration"]
fn explore() {
    for map in [Map::Bent] {
        for excitation in [Excitation::OperatingPoints, Excitation::Sines] {
            for count in [4, 8, 14] {
                for hidden in [
                    Hidden::default(),
                    Hidden { zeros: 0.005, ..Hidden::default() },
                    Hidden { zeros: 0.02, ..Hidden::default() },
                    Hidden { zeros: 0.01, drift: 0.1, temperature: 0.1, step: 0.05 },
                ] {
                    let mut counts: std::collections::BTreeMap<String, usize> = std::collections::BTreeMap::new();
                    for seed in 10..18 {
                        let found = decide(&set(map, excitation, 0.02, count, hidden, seed));
                        *counts.entry(names(&found).join("+")).or_default() += 1;
                    }
                    println!("{map:?} {excitation:?} {count} {hidden:?}: {counts:?}");
                }
            }
        }
    }
}
