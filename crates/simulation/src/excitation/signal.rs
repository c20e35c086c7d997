//! The shapes of pressure over time: the paper's eq. (1) and its relatives, and what a lab needs besides.

use std::f64::consts::{FRAC_PI_2, TAU};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::path::{Path, Shape};

/// Most samples of one excitation; a typing mistake in a duration should not fill the disk.
pub const MAX_SAMPLES: usize = 5_000_000;

/// Where an ascending envelope has its nominal amplitude.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Anchor {
    /// At the end: the time-reversed descending envelope, `A e^(-growth (T - t))`.
    #[default]
    End,
    /// At the start: the literal `A e^(growth t)`, which soon asks for more than any rig gives.
    Start,
}

/// One shape of pressure over the segment's time `t`, 0 to `T`. All pressures in bar, all times in s.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
#[allow(missing_docs, reason = "the formula of each kind says what its fields are")]
pub enum Signal {
    /// `offset + A e^(-decay t) (sin(2 pi f t - pi/2) + 1)`, the paper's eq. (1) without its noise; peaks at 2A. A negative decay grows.
    DescendingSine {
        amplitude_bar: f64,
        frequency_hz: f64,
        decay_per_s: f64,
        #[serde(default)]
        offset_bar: f64,
    },
    /// As the descending sine with a triangle of the same range, phase and frequency.
    DescendingTriangle {
        amplitude_bar: f64,
        frequency_hz: f64,
        decay_per_s: f64,
        #[serde(default)]
        offset_bar: f64,
    },
    /// A growing envelope over a sine whose frequency goes linearly from `frequency_hz` to `frequency_end_hz` (the same when absent).
    AscendingSine {
        amplitude_bar: f64,
        frequency_hz: f64,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        frequency_end_hz: Option<f64>,
        growth_per_s: f64,
        #[serde(default)]
        anchor: Anchor,
    },
    /// Levels in order, each held for its equal share of the duration less the `ramp_s` that leads to it.
    Staircase { levels_bar: Vec<f64>, ramp_s: f64 },
    /// Up and down at constant rate, starting at the minimum.
    Triangle { minimum_bar: f64, maximum_bar: f64, frequency_hz: f64 },
    /// A sine between the limits, starting at the minimum, its frequency going linearly from start to end.
    Chirp { minimum_bar: f64, maximum_bar: f64, frequency_start_hz: f64, frequency_end_hz: f64 },
    /// Equal sines of random phases, scaled to fill the range.
    Multisine { minimum_bar: f64, maximum_bar: f64, frequencies_hz: Vec<f64> },
    /// First-order reversal curves: from the minimum to the maximum, then down to each of `reversals` ever deeper points and back up,
    /// all at one rate, the last down to the minimum.
    FirstOrderReversalCurves { minimum_bar: f64, maximum_bar: f64, reversals: usize },
    /// Random levels, each reached in `rise_s` and held for a random time.
    RandomSteps { minimum_bar: f64, maximum_bar: f64, rise_s: f64, shortest_hold_s: f64, longest_hold_s: f64 },
    /// Smooth moves between random points at random mean rates; after a share of the moves a hold of random length.
    RandomPoints {
        minimum_bar: f64,
        maximum_bar: f64,
        /// Slowest mean rate of a move; the peak of a smooth move is 1.875 times its mean.
        slowest_bar_per_s: f64,
        fastest_bar_per_s: f64,
        #[serde(default)]
        hold_share: f64,
        #[serde(default)]
        longest_hold_s: f64,
        /// Where it starts; a random point when absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        start_bar: Option<f64>,
        /// Where it ends; wherever it happens to be when absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        end_bar: Option<f64>,
    },
    /// Straight lines through given points, held after the last.
    Points { times_s: Vec<f64>, pressures_bar: Vec<f64> },
    /// One pressure all the time.
    Hold { pressure_bar: f64 },
}

impl Signal {
    /// The name of the kind as in the file.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::DescendingSine { .. } => "descending-sine",
            Self::DescendingTriangle { .. } => "descending-triangle",
            Self::AscendingSine { .. } => "ascending-sine",
            Self::Staircase { .. } => "staircase",
            Self::Triangle { .. } => "triangle",
            Self::Chirp { .. } => "chirp",
            Self::Multisine { .. } => "multisine",
            Self::FirstOrderReversalCurves { .. } => "first-order-reversal-curves",
            Self::RandomSteps { .. } => "random-steps",
            Self::RandomPoints { .. } => "random-points",
            Self::Points { .. } => "points",
            Self::Hold { .. } => "hold",
        }
    }

    /// The pressures at ascending `times` within the duration.
    ///
    /// # Errors
    /// A sentence on what makes no sense.
    pub(super) fn play(&self, times: &[f64], duration_s: f64, random: &mut ChaCha8Rng) -> Result<Vec<f64>, String> {
        self.check()?;
        let every = |pressure: &dyn Fn(f64) -> f64| Ok(times.iter().map(|&time| pressure(time)).collect::<Vec<_>>());
        match self {
            Self::DescendingSine { amplitude_bar, frequency_hz, decay_per_s, offset_bar } => {
                every(&|t| offset_bar + amplitude_bar * (-decay_per_s * t).exp() * ((TAU * frequency_hz * t - FRAC_PI_2).sin() + 1.0))
            }
            Self::DescendingTriangle { amplitude_bar, frequency_hz, decay_per_s, offset_bar } => {
                every(&|t| offset_bar + amplitude_bar * (-decay_per_s * t).exp() * 2.0 * triangle(frequency_hz * t))
            }
            Self::AscendingSine { amplitude_bar, frequency_hz, frequency_end_hz, growth_per_s, anchor } => {
                let anchor_s = if *anchor == Anchor::End { duration_s } else { 0.0 };
                let sweep = (frequency_end_hz.unwrap_or(*frequency_hz) - frequency_hz) / duration_s;
                every(&|t| {
                    let turns = frequency_hz * t + 0.5 * sweep * t * t;
                    amplitude_bar * (growth_per_s * (t - anchor_s)).exp() * ((TAU * turns - FRAC_PI_2).sin() + 1.0)
                })
            }
            Self::Staircase { levels_bar, ramp_s } => {
                let share_s = duration_s / levels_bar.len() as f64;
                if *ramp_s >= share_s {
                    return Err(format!("ramp_s is {ramp_s} but each level has only {share_s} s; shorten the ramp or lengthen duration_s"));
                }
                let mut path = Path::new(Shape::Straight, levels_bar[0]);
                path.hold(share_s);
                for &level_bar in &levels_bar[1..] {
                    path.go(level_bar, *ramp_s);
                    path.hold(share_s - ramp_s);
                }
                Ok(path.at(times))
            }
            Self::Triangle { minimum_bar, maximum_bar, frequency_hz } => {
                every(&|t| minimum_bar + (maximum_bar - minimum_bar) * triangle(frequency_hz * t))
            }
            Self::Chirp { minimum_bar, maximum_bar, frequency_start_hz, frequency_end_hz } => {
                let sweep = (frequency_end_hz - frequency_start_hz) / duration_s;
                every(&|t| {
                    let turns = frequency_start_hz * t + 0.5 * sweep * t * t;
                    minimum_bar + 0.5 * (maximum_bar - minimum_bar) * (1.0 - (TAU * turns).cos())
                })
            }
            Self::Multisine { minimum_bar, maximum_bar, frequencies_hz } => {
                let phases: Vec<f64> = frequencies_hz.iter().map(|_| TAU * random.random::<f64>()).collect();
                let raw = |t: f64| -> f64 { frequencies_hz.iter().zip(&phases).map(|(f, phase)| (TAU * f * t + phase).sin()).sum() };
                let raw: Vec<f64> = times.iter().map(|&time| raw(time)).collect();
                let low = raw.iter().copied().fold(f64::INFINITY, f64::min);
                let span = raw.iter().copied().fold(f64::NEG_INFINITY, f64::max) - low;
                let scale = if span > 0.0 { (maximum_bar - minimum_bar) / span } else { 0.0 };
                Ok(raw.iter().map(|value| minimum_bar + scale * (value - low)).collect())
            }
            Self::FirstOrderReversalCurves { minimum_bar, maximum_bar, reversals } => {
                few_moves(2.0 * *reversals as f64, "reversals")?;
                let span = maximum_bar - minimum_bar;
                let depth = |reversal: usize| span * reversal as f64 / *reversals as f64;
                let travel = span + (1..=*reversals).map(|reversal| 2.0 * depth(reversal)).sum::<f64>();
                let rate = travel / duration_s;
                let mut path = Path::new(Shape::Straight, *minimum_bar);
                path.go(*maximum_bar, span / rate);
                for reversal in 1..=*reversals {
                    path.go(maximum_bar - depth(reversal), depth(reversal) / rate);
                    path.go(*maximum_bar, depth(reversal) / rate);
                }
                Ok(path.at(times))
            }
            Self::RandomSteps { minimum_bar, maximum_bar, rise_s, shortest_hold_s, longest_hold_s } => {
                few_moves(duration_s / (rise_s + 0.5 * (shortest_hold_s + longest_hold_s)), "steps")?;
                let mut path = Path::new(Shape::Straight, *minimum_bar);
                while path.end().0 < duration_s {
                    path.go(between(random, *minimum_bar, *maximum_bar), *rise_s);
                    path.hold(between(random, *shortest_hold_s, *longest_hold_s));
                }
                Ok(path.at(times))
            }
            Self::RandomPoints {
                minimum_bar,
                maximum_bar,
                slowest_bar_per_s,
                fastest_bar_per_s,
                hold_share,
                longest_hold_s,
                start_bar,
                end_bar,
            } => {
                few_moves(duration_s / SHORTEST_MOVE_S, "moves")?;
                let start_bar = start_bar.unwrap_or_else(|| between(random, *minimum_bar, *maximum_bar));
                // The way to the end point takes the full range at most.
                let last_move_s = if end_bar.is_some() { (maximum_bar - minimum_bar) / fastest_bar_per_s } else { 0.0 };
                if last_move_s >= duration_s {
                    return Err(format!("the move to end_bar may take {last_move_s} s; lengthen duration_s"));
                }
                let mut path = Path::new(Shape::Smooth, start_bar);
                loop {
                    let target_bar = between(random, *minimum_bar, *maximum_bar);
                    let rate = slowest_bar_per_s * (fastest_bar_per_s / slowest_bar_per_s).powf(random.random::<f64>());
                    let move_s = ((target_bar - path.end().1).abs() / rate).max(SHORTEST_MOVE_S);
                    let hold_s = if random.random::<f64>() < *hold_share { between(random, 0.1, longest_hold_s.max(0.1)) } else { 0.0 };
                    let ends_s = path.end().0 + move_s + hold_s;
                    if end_bar.is_some() && ends_s + last_move_s > duration_s {
                        break;
                    }
                    path.go(target_bar, move_s);
                    if hold_s > 0.0 {
                        path.hold(hold_s);
                    }
                    if ends_s > duration_s {
                        break;
                    }
                }
                if let Some(end_bar) = end_bar {
                    path.go(*end_bar, duration_s - path.end().0);
                }
                Ok(path.at(times))
            }
            Self::Points { times_s, pressures_bar } => {
                let mut path = Path::new(Shape::Straight, pressures_bar[0]);
                if times_s[0] > 0.0 {
                    path.hold(times_s[0]);
                }
                for index in 1..times_s.len() {
                    path.go(pressures_bar[index], times_s[index] - times_s[index - 1]);
                }
                Ok(path.at(times))
            }
            Self::Hold { pressure_bar } => every(&|_| *pressure_bar),
        }
    }

    /// Refuses values without sense.
    fn check(&self) -> Result<(), String> {
        let finite = |name: &str, value: f64| match value.is_finite() {
            true => Ok(()),
            false => Err(format!("{name} is {value}, a finite number is wanted")),
        };
        let positive = |name: &str, value: f64| match value.is_finite() && value > 0.0 {
            true => Ok(()),
            false => Err(format!("{name} is {value}, a positive number is wanted")),
        };
        let not_negative = |name: &str, value: f64| match value.is_finite() && value >= 0.0 {
            true => Ok(()),
            false => Err(format!("{name} is {value}, zero or a positive number is wanted")),
        };
        let range = |minimum: f64, maximum: f64| match minimum.is_finite() && maximum.is_finite() && minimum < maximum {
            true => Ok(()),
            false => Err(format!("minimum_bar is {minimum} and maximum_bar is {maximum}; the minimum must be below the maximum")),
        };
        let some = |name: &str, values: &[f64]| match (values.is_empty(), values.iter().all(|value| value.is_finite())) {
            (false, true) => Ok(()),
            (true, _) => Err(format!("{name} is empty; give at least one value")),
            (false, false) => Err(format!("{name} has a value that is not finite")),
        };
        match self {
            Self::DescendingSine { amplitude_bar, frequency_hz, decay_per_s, offset_bar }
            | Self::DescendingTriangle { amplitude_bar, frequency_hz, decay_per_s, offset_bar } => {
                not_negative("amplitude_bar", *amplitude_bar)?;
                positive("frequency_hz", *frequency_hz)?;
                finite("decay_per_s", *decay_per_s)?;
                finite("offset_bar", *offset_bar)
            }
            Self::AscendingSine { amplitude_bar, frequency_hz, frequency_end_hz, growth_per_s, .. } => {
                not_negative("amplitude_bar", *amplitude_bar)?;
                positive("frequency_hz", *frequency_hz)?;
                positive("frequency_end_hz", frequency_end_hz.unwrap_or(1.0))?;
                not_negative("growth_per_s", *growth_per_s)
            }
            Self::Staircase { levels_bar, ramp_s } => {
                some("levels_bar", levels_bar)?;
                positive("ramp_s", *ramp_s)
            }
            Self::Triangle { minimum_bar, maximum_bar, frequency_hz } => {
                range(*minimum_bar, *maximum_bar)?;
                positive("frequency_hz", *frequency_hz)
            }
            Self::Chirp { minimum_bar, maximum_bar, frequency_start_hz, frequency_end_hz } => {
                range(*minimum_bar, *maximum_bar)?;
                positive("frequency_start_hz", *frequency_start_hz)?;
                positive("frequency_end_hz", *frequency_end_hz)
            }
            Self::Multisine { minimum_bar, maximum_bar, frequencies_hz } => {
                range(*minimum_bar, *maximum_bar)?;
                some("frequencies_hz", frequencies_hz)?;
                frequencies_hz.iter().try_for_each(|&frequency| positive("frequencies_hz", frequency))
            }
            Self::FirstOrderReversalCurves { minimum_bar, maximum_bar, reversals } => {
                range(*minimum_bar, *maximum_bar)?;
                positive("reversals", *reversals as f64)
            }
            Self::RandomSteps { minimum_bar, maximum_bar, rise_s, shortest_hold_s, longest_hold_s } => {
                range(*minimum_bar, *maximum_bar)?;
                positive("rise_s", *rise_s)?;
                not_negative("shortest_hold_s", *shortest_hold_s)?;
                positive("longest_hold_s", *longest_hold_s)?;
                not_negative("longest_hold_s less shortest_hold_s", longest_hold_s - shortest_hold_s)
            }
            Self::RandomPoints {
                minimum_bar,
                maximum_bar,
                slowest_bar_per_s,
                fastest_bar_per_s,
                hold_share,
                longest_hold_s,
                start_bar,
                end_bar,
            } => {
                range(*minimum_bar, *maximum_bar)?;
                positive("slowest_bar_per_s", *slowest_bar_per_s)?;
                positive("fastest_bar_per_s", *fastest_bar_per_s)?;
                not_negative("fastest_bar_per_s less slowest_bar_per_s", fastest_bar_per_s - slowest_bar_per_s)?;
                not_negative("hold_share", *hold_share)?;
                not_negative("longest_hold_s", *longest_hold_s)?;
                finite("start_bar", start_bar.unwrap_or(0.0))?;
                finite("end_bar", end_bar.unwrap_or(0.0))
            }
            Self::Points { times_s, pressures_bar } => {
                some("times_s", times_s)?;
                some("pressures_bar", pressures_bar)?;
                if times_s.len() != pressures_bar.len() {
                    return Err(format!("{} times_s and {} pressures_bar; give one pressure a time", times_s.len(), pressures_bar.len()));
                }
                not_negative("the first of times_s", times_s[0])?;
                match times_s.windows(2).find(|pair| pair[1] <= pair[0]) {
                    Some(pair) => Err(format!("times_s must increase, {} follows {}", pair[1], pair[0])),
                    None => Ok(()),
                }
            }
            Self::Hold { pressure_bar } => finite("pressure_bar", *pressure_bar),
        }
    }
}

/// No move of random points is shorter, s.
const SHORTEST_MOVE_S: f64 = 0.05;

/// Refuses a signal of more moves than an excitation has samples: nobody would see them, and they would fill the memory.
fn few_moves(count: f64, what: &str) -> Result<(), String> {
    if count <= MAX_SAMPLES as f64 {
        return Ok(());
    }
    Err(format!("would make {count:.0} {what}, at most {} are possible; take fewer or slower ones, or shorten duration_s", MAX_SAMPLES))
}

/// A triangle wave of `turns`, 0 at whole turns and 1 between.
fn triangle(turns: f64) -> f64 {
    1.0 - (2.0 * turns.rem_euclid(1.0) - 1.0).abs()
}

/// A uniform random number between two bounds.
fn between(random: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * random.random::<f64>()
}
