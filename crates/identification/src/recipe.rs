//! A recipe: the few discrete settings from which a [`Structure`] is made, small enough to search and to remember.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::{Basis, Column, Lag, OutputPath, Scaling, Series, Signs, Structure, Widening};

/// Which columns are repeated behind a spectrum of lags.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Spectrum {
    /// None.
    #[default]
    None,
    /// The scaled inputs: linear creep and linear dynamics.
    Input,
    /// All polynomials and products: creep and dynamics behind the static curve.
    Curve,
    /// Those and a few play operators: creep of the hysteretic part too.
    Plays,
}

/// What physics says of the signs of weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Bound {
    /// Nothing: weights of either sign. Fits what was seen, and may go anywhere beyond it.
    Free,
    /// The output follows each input monotonically, and lags behind it: play operators, ramps and creep of one sign.
    Play,
    /// A force of friction, which leads: stop operators, that is the input less play operators.
    Stop,
}

/// The filter of the sum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum OutputKey {
    /// None.
    #[default]
    Direct,
    /// A lag, by `lag_s` of this step.
    Lag(u16),
    /// An oscillator: step of `lag_s` for its inverse angular frequency, and index into [`DAMPINGS`].
    Oscillator(u16, u8),
}

/// Damping ratios that are tried.
pub const DAMPINGS: [f64; 4] = [0.15, 0.35, 0.7, 1.0];

/// Discrete settings of a structure.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Recipe {
    /// Highest degree of the polynomial of each input; 0 is none.
    pub polynomial: u8,
    /// Products of pairs of inputs.
    pub products: bool,
    /// Segments of a curve of ramps on each input; 0 is none.
    pub ramps: u8,
    /// Play operators on each input.
    pub plays: u8,
    /// Signs of the weights.
    pub bound: Bound,
    /// One bit an input: whether the output falls when it rises.
    pub falling: u8,
    /// Dead time in quarters of a sample.
    pub dead_quarters: u16,
    /// Lag of the inputs by `lag_s`; 0 is none.
    pub lag: u16,
    /// How thresholds follow the speed: from a half range in the `lag_s` of this step on, and a step of the gain.
    pub widening: Option<(u16, i8)>,
    /// Filter of the sum.
    pub output: OutputKey,
    /// Columns behind lags.
    pub spectrum: Spectrum,
    /// Whether the inputs are repeated behind oscillators of all frequencies: linear dynamics of any order.
    pub oscillators: bool,
    /// Sigmoid columns with random gains.
    pub sigmoids: u16,
    /// Whether play operators rest at an input of zero before each recording instead of at its first sample.
    pub rest_at_zero: bool,
    /// Whether each recording has a constant of its own.
    pub own_zeros: bool,
}

impl Recipe {
    /// A straight line.
    #[must_use]
    pub fn line() -> Self {
        Self {
            polynomial: 1,
            products: false,
            ramps: 0,
            plays: 0,
            bound: Bound::Free,
            falling: 0,
            dead_quarters: 0,
            lag: 0,
            widening: None,
            output: OutputKey::Direct,
            spectrum: Spectrum::None,
            oscillators: false,
            sigmoids: 0,
            rest_at_zero: false,
            own_zeros: false,
        }
    }
}

/// What a recipe needs to know of the data; inputs only, never outputs.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// Time between samples in s.
    pub sample_period_s: f64,
    /// Scaling of each input.
    pub scalings: Vec<Scaling>,
    /// Time constants of the spectrum in s, ascending.
    pub spectrum_s: Vec<f64>,
    /// Longest recording in samples.
    pub longest: usize,
    /// Seed of random gains.
    pub seed: u64,
}

/// Time constants of the spectrum a decade.
const PER_DECADE: f64 = 1.5;
/// Longest time constant over the longest hold.
const BEYOND_HOLD: f64 = 10.0;
/// An input moves when it changes by more than this share of its range.
const STILL: f64 = 0.01;
/// Seconds of the longest recording that its slowest time constant may be, at most.
const OF_RECORDING: f64 = 1.0;

impl Surroundings {
    /// Looks at the inputs of recordings on one clock.
    #[must_use]
    pub fn of(series: &[Series], sample_period_s: f64, seed: u64) -> Self {
        let inputs = series.first().map_or(0, |one| one.inputs.len());
        let scalings: Vec<Scaling> =
            (0..inputs).map(|input| Scaling::of(series.iter().flat_map(|one| one.inputs[input].iter().copied()))).collect();
        let longest = series.iter().map(Series::len).max().unwrap_or(0);
        let hold = series.iter().map(|one| longest_hold(one, &scalings)).max().unwrap_or(0);
        let shortest_s = 2.0 * sample_period_s;
        let longest_s = (BEYOND_HOLD * hold as f64).min(OF_RECORDING * longest as f64).max(8.0) * sample_period_s;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small positive count")]
        let count = ((longest_s / shortest_s).log10() * PER_DECADE).ceil().clamp(2.0, 9.0) as usize;
        let ratio = (longest_s / shortest_s).powf(1.0 / (count - 1) as f64);
        let spectrum_s = (0..count).map(|index| shortest_s * ratio.powi(i32::try_from(index).unwrap_or(0))).collect();
        Self { sample_period_s, scalings, spectrum_s, longest, seed }
    }

    /// Longest lag that is tried, as a step of `lag_s`.
    #[must_use]
    pub fn longest_lag(&self) -> u16 {
        (1..40).take_while(|&step| lag_s(step, 1.0) < 0.1 * self.longest as f64).last().unwrap_or(1)
    }
}

/// Samples of the longest stretch in which no input moves.
fn longest_hold(series: &Series, scalings: &[Scaling]) -> usize {
    let mut longest = 0;
    for segment in series.segments() {
        let mut start = segment.start;
        for sample in segment {
            let still =
                series.inputs.iter().zip(scalings).all(|(input, scaling)| (input[sample] - input[start]).abs() <= STILL * scaling.half);
            if !still {
                start = sample;
            }
            longest = longest.max(sample - start);
        }
    }
    longest
}

/// The time constant of a step: half octaves from half a sample on, in the unit of the period; 0 for step 0.
#[must_use]
pub fn lag_s(step: u16, sample_period_s: f64) -> f64 {
    if step == 0 { 0.0 } else { 0.5 * sample_period_s * 2.0_f64.powf(0.5 * f64::from(step - 1)) }
}

/// The gain of a step: half octaves from a fortieth on, in half ranges; of the step's sign, and 0 for step 0.
#[must_use]
pub fn gain(step: i8) -> f64 {
    if step == 0 { 0.0 } else { f64::from(step.signum()) * 0.025 * 2.0_f64.powf(0.5 * f64::from(step.unsigned_abs() - 1)) }
}

impl Recipe {
    /// The structure it stands for.
    #[must_use]
    pub fn structure(&self, around: &Surroundings) -> Structure {
        let inputs = around.scalings.len();
        let mut columns = Vec::new();
        let plain = |basis: Basis| Column { basis, lag: None };
        for input in 0..inputs {
            columns.extend((1..=usize::from(self.polynomial)).map(|degree| plain(Basis::Polynomial { input, degree })));
        }
        for input in 0..inputs {
            let edge = |index: u8| 2.0 * f64::from(index) / f64::from(self.ramps) - 1.0;
            columns.extend((0..self.ramps).map(|index| plain(Basis::Ramp { input, from: edge(index), to: edge(index + 1) })));
        }
        if self.products {
            for first in 0..inputs {
                columns.extend((first + 1..inputs).map(|second| plain(Basis::Product { first, second })));
            }
        }
        let curves = columns.len();
        let thresholds = thresholds(self.plays);
        for input in 0..inputs {
            columns.extend(thresholds.iter().map(|&threshold| plain(Basis::Play { input, threshold })));
        }
        let behind: Vec<Basis> = match self.spectrum {
            Spectrum::None => Vec::new(),
            Spectrum::Input => (0..inputs).map(|input| Basis::Polynomial { input, degree: 1 }).collect(),
            Spectrum::Curve => columns[..curves].iter().map(|column| column.basis.clone()).collect(),
            Spectrum::Plays => {
                let some = LAGGED_PLAYS.iter().flat_map(|&threshold| (0..inputs).map(move |input| Basis::Play { input, threshold }));
                columns[..curves].iter().map(|column| column.basis.clone()).chain(some).collect()
            }
        };
        for basis in behind {
            for &time_constant_s in &around.spectrum_s {
                columns.push(Column { basis: basis.clone(), lag: Some(Lag { time_constant_s, order: 1 }) });
            }
        }
        if self.oscillators {
            for input in 0..inputs {
                columns.extend(oscillators(input, around).map(plain));
            }
        }
        self.add_sigmoids(around, &mut columns);
        let rest = self.rest_at_zero.then(|| around.scalings.iter().map(|scaling| scaling.apply(0.0)).collect());
        Structure {
            sample_period_s: around.sample_period_s,
            dead_time_s: f64::from(self.dead_quarters) * 0.25 * around.sample_period_s,
            lag_s: lag_s(self.lag, around.sample_period_s),
            scalings: around.scalings.clone(),
            rest,
            widening: self
                .widening
                .map(|(step, gain)| Widening { speed: 1.0 / lag_s(step, around.sample_period_s), gain: self::gain(gain) }),
            output_path: match self.output {
                OutputKey::Direct => OutputPath::Direct,
                OutputKey::Lag(step) => OutputPath::Lag { time_constant_s: lag_s(step, around.sample_period_s) },
                OutputKey::Oscillator(step, damping) => OutputPath::Oscillator {
                    frequency_hz: 1.0 / (std::f64::consts::TAU * lag_s(step, around.sample_period_s)),
                    damping: DAMPINGS[usize::from(damping).min(DAMPINGS.len() - 1)],
                },
            },
            columns,
        }
    }

    /// Random sigmoids of memory: inputs, some play operators, and inputs behind the spectrum. Only their outer weights are fitted (the
    /// random-feature regression of G.-B. Huang et al., Neurocomputing 70, 2006).
    fn add_sigmoids(&self, around: &Surroundings, columns: &mut Vec<Column>) {
        if self.sigmoids == 0 {
            return;
        }
        let mut seen: Vec<usize> = Vec::new();
        let mut see = |columns: &mut Vec<Column>, wanted: Column| {
            let index = columns.iter().position(|column| *column == wanted).unwrap_or_else(|| {
                columns.push(wanted);
                columns.len() - 1
            });
            seen.push(index);
        };
        for input in 0..around.scalings.len() {
            see(columns, Column { basis: Basis::Polynomial { input, degree: 1 }, lag: None });
            for threshold in LAGGED_PLAYS {
                see(columns, Column { basis: Basis::Play { input, threshold }, lag: None });
            }
            for &time_constant_s in &around.spectrum_s {
                see(columns, Column { basis: Basis::Polynomial { input, degree: 1 }, lag: Some(Lag { time_constant_s, order: 1 }) });
            }
            if self.oscillators {
                oscillators(input, around).for_each(|basis| see(columns, Column { basis, lag: None }));
            }
        }
        let mut random = ChaCha8Rng::seed_from_u64(around.seed);
        let mut uniform = |half: f64| (2.0 * random.random::<f64>() - 1.0) * half;
        for _ in 0..self.sigmoids {
            // Each looks at a few signals, so that some of them are steep in one direction.
            let few = 3.min(seen.len());
            let mut chosen: Vec<usize> = Vec::new();
            while chosen.len() < few {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index below a small count")]
                let index = ((uniform(0.5) + 0.5) * seen.len() as f64) as usize;
                let column = seen[index.min(seen.len() - 1)];
                if !chosen.contains(&column) {
                    chosen.push(column);
                }
            }
            let gains = chosen.iter().map(|_| uniform(SIGMOID_GAIN)).collect();
            columns.push(Column { basis: Basis::Sigmoid { columns: chosen, gains, bias: uniform(SIGMOID_BIAS) }, lag: None });
        }
    }

    /// The bounds on the weights of [`Self::structure`]'s columns.
    #[must_use]
    pub fn signs(&self, structure: &Structure) -> Signs {
        if self.bound == Bound::Free {
            return Signs::Free;
        }
        let sign = |column: &Column| {
            let (input, follows) = match column.basis {
                Basis::Play { input, .. } => (input, self.bound == Bound::Play),
                Basis::Polynomial { input, .. } | Basis::Ramp { input, .. } => (input, true),
                Basis::Product { .. } | Basis::Oscillator { .. } | Basis::Sigmoid { .. } => return 0,
            };
            // Creep of a force may relax it.
            if column.lag.is_some() && self.bound == Bound::Stop {
                return 0;
            }
            let falls = self.falling >> input & 1 == 1;
            if follows == falls { -1 } else { 1 }
        };
        Signs::Bound(structure.columns.iter().map(sign).collect())
    }
}

/// Oscillators with the spectrum's time constants as inverse angular frequencies: with two dampings each, about a basis of the linear
/// dynamics that these data can show (P. Heuberger, P. Van den Hof and B. Wahlberg, Modelling and Identification with Rational
/// Orthogonal Basis Functions, 2005).
fn oscillators(input: usize, around: &Surroundings) -> impl Iterator<Item = Basis> {
    around.spectrum_s.iter().flat_map(move |time_constant_s| {
        let frequency_hz = 1.0 / (std::f64::consts::TAU * time_constant_s);
        SPECTRUM_DAMPINGS
            .iter()
            .flat_map(move |&damping| [false, true].map(|rate| Basis::Oscillator { input, frequency_hz, damping, rate }))
    })
}

/// Damping ratios of the spectrum of oscillators.
const SPECTRUM_DAMPINGS: [f64; 2] = [0.2, 0.6];
/// Thresholds of the play operators that are repeated behind lags or seen by sigmoids.
const LAGGED_PLAYS: [f64; 4] = [0.06, 0.2, 0.45, 0.8];
/// Largest gain of a sigmoid.
const SIGMOID_GAIN: f64 = 3.0;
/// Largest constant of a sigmoid.
const SIGMOID_BIAS: f64 = 2.0;

/// `count` thresholds from zero to nearly half the span, denser near zero, where small loops are.
fn thresholds(count: u8) -> Vec<f64> {
    (0..count).map(|index| (f64::from(index) / f64::from(count)).powf(1.5)).collect()
}
