//! Data sets: the paper's to the letter, a rich one for models that must not forget, and one excitation of each kind for the lab.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::config::{ExcitationConfig, Segment};
use super::signal::{Anchor, Signal};

/// Frequencies of the paper's training set in Hz.
pub const PAPER_FREQUENCIES_HZ: [f64; 4] = [0.2, 0.4, 0.6, 0.8];
/// Decay constants of the paper's training set in 1/s.
pub const PAPER_DECAYS_PER_S: [f64; 6] = [0.01, 0.02, 0.05, 0.1, 0.15, 0.2];
/// Duration of the paper's recordings in s: 1000 samples of 0.02 s.
pub const PAPER_DURATION_S: f64 = 20.0;

/// Where test frequencies are drawn from, in Hz: between the training frequencies, well away from each.
const UNSEEN_FREQUENCIES_HZ: [(f64, f64); 3] = [(0.25, 0.35), (0.45, 0.55), (0.65, 0.75)];
/// Where test decay constants are drawn from, in 1/s: between the training constants, well away from each.
const UNSEEN_DECAYS_PER_S: [(f64, f64); 4] = [(0.03, 0.04), (0.065, 0.085), (0.115, 0.135), (0.165, 0.185)];

/// Streams of the random generator.
const TEST_STREAM: u64 = 101;
const RICH_STREAM: u64 = 102;
const SEED_STREAM: u64 = 103;

/// An excitation and the name of its recording, without `.csv`.
#[derive(Clone, Debug, PartialEq)]
pub struct Named {
    /// Name of the file.
    pub name: String,
    /// What is played.
    pub excitation: ExcitationConfig,
}

/// What all excitations of a set share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetConfig {
    /// Seed of every random choice.
    pub seed: u64,
    /// A of eq. (1) in bar; signals reach up to twice as much.
    pub amplitude_bar: f64,
    /// Upper end of the uniform input noise in bar.
    pub noise_bar: f64,
    /// Sample period in s.
    pub sample_period_s: f64,
    /// Test recordings of each family.
    pub tests_per_family: usize,
}

impl Default for SetConfig {
    /// The paper's simulation: A = 1 bar, noise up to 0.1 bar, 50 samples a second.
    fn default() -> Self {
        Self { seed: 1, amplitude_bar: 1.0, noise_bar: 0.1, sample_period_s: 0.02, tests_per_family: 3 }
    }
}

impl SetConfig {
    fn random(&self, stream: u64) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(stream);
        random
    }

    fn one(&self, name: String, seed: u64, noise_bar: f64, duration_s: f64, signal: Signal) -> Named {
        self.row(name, seed, noise_bar, vec![Segment { duration_s, signal }])
    }

    fn row(&self, name: String, seed: u64, noise_bar: f64, segments: Vec<Segment>) -> Named {
        Named { name, excitation: ExcitationConfig { sample_period_s: self.sample_period_s, noise_bar, seed, segments } }
    }
}

/// Independent seeds for the excitations of a set; below 2^53 so that any TOML or JSON reader keeps them.
fn seeds(config: &SetConfig, set: u64) -> impl FnMut() -> u64 {
    let mut random = config.random(SEED_STREAM + 1000 * set);
    move || random.random::<u64>() >> 11
}

/// The paper's training set: eq. (1) with the 24 combinations of frequency and decay.
#[must_use]
pub fn paper_training(config: &SetConfig) -> Vec<Named> {
    let mut seed = seeds(config, 1);
    let mut set = Vec::new();
    for frequency_hz in PAPER_FREQUENCIES_HZ {
        for decay_per_s in PAPER_DECAYS_PER_S {
            let name = format!("sine_{:02}_f{frequency_hz}_tau{decay_per_s}", set.len() + 1);
            let signal = Signal::DescendingSine { amplitude_bar: config.amplitude_bar, frequency_hz, decay_per_s, offset_bar: 0.0 };
            set.push(config.one(name, seed(), config.noise_bar, PAPER_DURATION_S, signal));
        }
    }
    set
}

/// The paper's four test families, with frequencies and decays that its training set does not have:
/// (a) descending sine, (b) descending triangle, (c) ascending sine, (d) ascending sine with altering frequency.
///
/// The ascending envelopes are the time-reversed descending ones, `A e^(-tau (T - t))`: the literal `A e^(tau t)` would reach up to 2A e^4.
#[must_use]
pub fn families(config: &SetConfig) -> Vec<Named> {
    let mut seed = seeds(config, 2);
    let mut random = config.random(TEST_STREAM);
    let amplitude_bar = config.amplitude_bar;
    let mut set = Vec::new();
    for family in ["a", "b", "c", "d"] {
        for index in 1..=config.tests_per_family {
            let frequency_hz = rounded(pick(&mut random, &UNSEEN_FREQUENCIES_HZ));
            let decay_per_s = rounded(pick(&mut random, &UNSEEN_DECAYS_PER_S));
            let name = format!("{family}_{index:02}_f{frequency_hz}_tau{decay_per_s}");
            let ascending = |frequency_end_hz| Signal::AscendingSine {
                amplitude_bar,
                frequency_hz,
                frequency_end_hz,
                growth_per_s: decay_per_s,
                anchor: Anchor::End,
            };
            let signal = match family {
                "a" => Signal::DescendingSine { amplitude_bar, frequency_hz, decay_per_s, offset_bar: 0.0 },
                "b" => Signal::DescendingTriangle { amplitude_bar, frequency_hz, decay_per_s, offset_bar: 0.0 },
                "c" => ascending(None),
                _ => {
                    // Altering means noticeably: to another of the unseen bands.
                    let others: Vec<(f64, f64)> =
                        UNSEEN_FREQUENCIES_HZ.into_iter().filter(|band| !(band.0..=band.1).contains(&frequency_hz)).collect();
                    ascending(Some(rounded(pick(&mut random, &others))))
                }
            };
            set.push(config.one(name, seed(), config.noise_bar, PAPER_DURATION_S, signal));
        }
    }
    set
}

/// A rich training set of 192 recordings (a little over an hour): all amplitudes, offsets, rising and falling envelopes, nested reversals,
/// holds of up to 25 s, rates up to those of the families, random starting histories, the virgin curve; two of three with input noise.
/// Kinds are interleaved, so that any contiguous part is a fair sample of the whole.
#[must_use]
pub fn rich_training(config: &SetConfig) -> Vec<Named> {
    let mut seed = seeds(config, 3);
    let mut random = config.random(RICH_STREAM);
    let top = 2.0 * config.amplitude_bar;
    let mut set: Vec<Named> = Vec::new();
    // All eight kinds in turn; noise goes by the round, so every kind comes with and without.
    for round in 0..ROUNDS {
        for kind in RICH_KINDS {
            let noise_bar = if round % 3 == 2 { 0.0 } else { config.noise_bar };
            let segments = rich_segments(kind, round, top, &mut random);
            let name = format!("r{:03}_{}", set.len() + 1, kind);
            set.push(config.row(name, seed(), noise_bar, segments));
        }
    }
    set
}

/// Rounds through the kinds: with fewer, what a network learns beyond the training recordings is limited by their number (measured on
/// the all-effects plant: the error on new recordings was three times that on the training ones with ten rounds).
const ROUNDS: usize = 24;

const RICH_KINDS: [&str; 8] =
    ["points", "falling-sine", "rising-sine", "falling-triangle", "minor-loops", "steps", "reversals", "long-hold"];

/// Moves between random points of the range: the general case, and the random history before others.
fn random_points(top: f64, hold_share: f64, longest_hold_s: f64, start_bar: Option<f64>, end_bar: Option<f64>) -> Signal {
    Signal::RandomPoints {
        minimum_bar: 0.0,
        maximum_bar: top,
        slowest_bar_per_s: 0.05 * top,
        fastest_bar_per_s: 1.2 * top,
        hold_share,
        longest_hold_s,
        start_bar,
        end_bar,
    }
}

/// The segments of one recording of the rich set.
fn rich_segments(kind: &str, round: usize, top: f64, random: &mut ChaCha8Rng) -> Vec<Segment> {
    let mut uniform = |low: f64, high: f64| rounded(low + (high - low) * random.random::<f64>());
    let amplitude_bar = rounded(0.5 * top * if round.is_multiple_of(2) { 1.0 } else { uniform(0.25, 0.95) });
    let frequency_hz = uniform(0.15, 0.9);
    let decay_per_s = uniform(0.0, 0.25);
    let segment = |duration_s: f64, signal: Signal| Segment { duration_s, signal };
    // Every other recording starts from rest (the virgin curve), the others from a history that ends where the signal starts.
    let after_history = |signal: Signal| match round % 2 {
        0 => vec![segment(PAPER_DURATION_S, signal)],
        _ => vec![segment(8.0, random_points(top, 0.2, 1.0, None, Some(0.0))), segment(PAPER_DURATION_S - 4.0, signal)],
    };
    match kind {
        "points" => {
            let start_bar = round.is_multiple_of(2).then_some(0.0);
            vec![segment(PAPER_DURATION_S, random_points(top, 0.25, 3.0, start_bar, None))]
        }
        "falling-sine" => after_history(Signal::DescendingSine { amplitude_bar, frequency_hz, decay_per_s, offset_bar: 0.0 }),
        "rising-sine" => after_history(Signal::AscendingSine {
            amplitude_bar,
            frequency_hz,
            frequency_end_hz: (round % 4 < 2).then(|| uniform(0.15, 0.9)),
            growth_per_s: decay_per_s,
            anchor: Anchor::End,
        }),
        "falling-triangle" => after_history(Signal::DescendingTriangle { amplitude_bar, frequency_hz, decay_per_s, offset_bar: 0.0 }),
        "minor-loops" => {
            // Small loops about an offset, after a way there that leaves a memory.
            let offset_bar = uniform(0.1, 0.7) * top;
            let amplitude_bar = rounded(0.5 * (top - offset_bar).min(top) * uniform(0.15, 0.9));
            let loops = Signal::DescendingSine { amplitude_bar, frequency_hz, decay_per_s: decay_per_s * 0.6, offset_bar };
            vec![segment(6.0, random_points(top, 0.2, 1.0, None, Some(offset_bar))), segment(PAPER_DURATION_S - 4.0, loops)]
        }
        "steps" => {
            let rise_s = uniform(0.25, 0.8);
            let signal =
                Signal::RandomSteps { minimum_bar: 0.0, maximum_bar: top, rise_s, shortest_hold_s: 0.3, longest_hold_s: uniform(1.5, 5.0) };
            vec![segment(PAPER_DURATION_S, signal)]
        }
        "reversals" => match round % 3 {
            0 => vec![segment(
                PAPER_DURATION_S,
                Signal::FirstOrderReversalCurves { minimum_bar: 0.0, maximum_bar: top * uniform(0.6, 1.0), reversals: 4 + round % 4 },
            )],
            1 => vec![segment(
                PAPER_DURATION_S,
                Signal::Multisine {
                    minimum_bar: 0.0,
                    maximum_bar: top * uniform(0.7, 1.0),
                    frequencies_hz: vec![uniform(0.05, 0.15), uniform(0.2, 0.4), uniform(0.4, 0.6), uniform(0.6, 0.8)],
                },
            )],
            _ => vec![segment(
                PAPER_DURATION_S,
                Signal::Chirp {
                    minimum_bar: top * uniform(0.0, 0.3),
                    maximum_bar: top * uniform(0.6, 1.0),
                    frequency_start_hz: uniform(0.1, 0.3),
                    frequency_end_hz: uniform(0.6, 0.9),
                },
            )],
        },
        _ => {
            let level_bar = uniform(0.0, 1.0) * top;
            vec![
                segment(8.0, random_points(top, 0.1, 1.0, None, Some(level_bar))),
                segment(uniform(10.0, 25.0), Signal::Hold { pressure_bar: level_bar }),
                segment(5.0, random_points(top, 0.2, 1.0, Some(level_bar), None)),
            ]
        }
    }
}

/// One excitation of each kind that a lab needs to see what its actuator does.
#[must_use]
pub fn lab(config: &SetConfig) -> Vec<Named> {
    let mut seed = seeds(config, 4);
    let top = 2.0 * config.amplitude_bar;
    let levels = [0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0].map(|share| share * top);
    let kinds: Vec<(&str, f64, Signal)> = vec![
        ("staircase", 90.0, Signal::Staircase { levels_bar: levels.to_vec(), ramp_s: 1.0 }),
        ("triangle", 40.0, Signal::Triangle { minimum_bar: 0.0, maximum_bar: top, frequency_hz: 0.1 }),
        ("chirp", 60.0, Signal::Chirp { minimum_bar: 0.0, maximum_bar: top, frequency_start_hz: 0.05, frequency_end_hz: 1.0 }),
        ("multisine", 60.0, Signal::Multisine { minimum_bar: 0.0, maximum_bar: top, frequencies_hz: vec![0.05, 0.15, 0.35, 0.55, 0.75] }),
        ("reversals", 60.0, Signal::FirstOrderReversalCurves { minimum_bar: 0.0, maximum_bar: top, reversals: 8 }),
        ("steps", 60.0, Signal::RandomSteps { minimum_bar: 0.0, maximum_bar: top, rise_s: 0.3, shortest_hold_s: 1.0, longest_hold_s: 5.0 }),
        ("points", 60.0, random_points(top, 0.25, 5.0, Some(0.0), None)),
        ("hold", 80.0, Signal::Points { times_s: vec![0.0, 2.0, 70.0, 72.0], pressures_bar: vec![0.0, 0.6 * top, 0.6 * top, 0.0] }),
    ];
    kinds.into_iter().map(|(name, duration_s, signal)| config.one(name.to_owned(), seed(), 0.0, duration_s, signal)).collect()
}

/// A number drawn from one of the bands.
fn pick(random: &mut ChaCha8Rng, bands: &[(f64, f64)]) -> f64 {
    let (low, high) = bands[random.random_range(0..bands.len())];
    low + (high - low) * random.random::<f64>()
}

/// Three decimals: what stands in the file is what was played.
fn rounded(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}
