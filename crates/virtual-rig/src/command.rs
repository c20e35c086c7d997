//! What the virtual rig is told to do: pressure commands as functions of time, each after two seconds of rest.

use std::f64::consts::PI;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Rest at zero pressure before every command, s.
pub const REST_S: f64 = 2.0;
/// Length of every command after the rest, s.
pub const COMMAND_S: f64 = 20.0;
/// Amplitude `A` of the paper's experiment in bar; the command peaks at `2 A`.
pub const AMPLITUDE_BAR: f64 = 1.5;

/// The kind of session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Excitation {
    /// The paper's 24 decaying sines.
    Paper,
    /// Decaying sines, steps, staircases, sweeps and multisines up to 6 Hz.
    Rich,
}

/// One command over time, bar over s.
#[derive(Clone, Debug)]
pub enum Shape {
    /// Equation (1) of the paper: `A exp(-decay t) (1 - cos(2 pi f t))`; a negative decay rises.
    Sine {
        /// Half the first peak, bar.
        amplitude_bar: f64,
        /// Decay, 1/s.
        decay_per_s: f64,
        /// Frequency, Hz.
        frequency_hz: f64,
        /// Growth of the frequency, Hz/s.
        sweep_hz_per_s: f64,
    },
    /// A triangle between zero and a decaying peak.
    Triangle {
        /// First peak, bar.
        peak_bar: f64,
        /// Decay, 1/s.
        decay_per_s: f64,
        /// Frequency, Hz.
        frequency_hz: f64,
    },
    /// Levels held for equal times, joined by ramps.
    Levels {
        /// Levels, bar.
        levels_bar: Vec<f64>,
        /// Time from level to level, s.
        dwell_s: f64,
        /// Duration of the ramp to a level, s.
        ramp_s: f64,
    },
    /// A sum of sines around a mid pressure.
    Multisine {
        /// Middle, bar.
        middle_bar: f64,
        /// Amplitude in bar, frequency in Hz and phase of each line.
        lines: Vec<(f64, f64, f64)>,
    },
}

impl Shape {
    /// Pressure command in bar at `time_s` after the rest.
    #[must_use]
    pub fn at(&self, time_s: f64) -> f64 {
        if time_s <= 0.0 {
            return 0.0;
        }
        match self {
            Self::Sine { amplitude_bar, decay_per_s, frequency_hz, sweep_hz_per_s } => {
                let turns = frequency_hz * time_s + 0.5 * sweep_hz_per_s * time_s * time_s;
                amplitude_bar * (-decay_per_s * time_s).exp() * (1.0 - (2.0 * PI * turns).cos())
            }
            Self::Triangle { peak_bar, decay_per_s, frequency_hz } => {
                let turn = (frequency_hz * time_s).fract();
                peak_bar * (-decay_per_s * time_s).exp() * (1.0 - (2.0 * turn - 1.0).abs())
            }
            Self::Levels { levels_bar, dwell_s, ramp_s } => {
                let index = ((time_s / dwell_s) as usize).min(levels_bar.len() - 1);
                let before = if index == 0 { 0.0 } else { levels_bar[index - 1] };
                let within = time_s - index as f64 * dwell_s;
                before + (levels_bar[index] - before) * (within / ramp_s).min(1.0)
            }
            Self::Multisine { middle_bar, lines } => {
                let fade = (time_s / 1.0).min(1.0);
                let sum: f64 = lines.iter().map(|(size, frequency, phase)| size * (2.0 * PI * frequency * time_s + phase).sin()).sum();
                (fade * (middle_bar + sum)).clamp(0.0, 2.0 * AMPLITUDE_BAR)
            }
        }
    }
}

/// The commands of a session, in order, with a short name each.
#[must_use]
pub fn session(kind: Excitation, generator: &mut ChaCha8Rng) -> Vec<(String, Shape)> {
    let frequencies = [0.2, 0.4, 0.6, 0.8];
    let decays = [0.01, 0.02, 0.05, 0.1, 0.15, 0.2];
    let mut all: Vec<(String, Shape)> = Vec::new();
    for frequency_hz in frequencies {
        for decay_per_s in decays {
            all.push(("sine".into(), sine(frequency_hz, decay_per_s)));
        }
    }
    if kind == Excitation::Rich {
        for (index, slot) in all.iter_mut().enumerate() {
            match index % 6 {
                1 => *slot = ("steps".into(), levels(generator, 1.0, 0.02)),
                2 => *slot = ("stairs".into(), levels(generator, 2.5, 0.5)),
                3 => *slot = ("multisine".into(), multisine(generator, 6.0)),
                4 => {
                    *slot = ("chirp".into(), Shape::Sine { amplitude_bar: 1.2, decay_per_s: 0.03, frequency_hz: 0.1, sweep_hz_per_s: 0.15 })
                }
                _ => {}
            }
        }
    }
    all
}

/// Commands of other kinds than the session's, for the figures at the end.
#[must_use]
pub fn kept_out(kind: Excitation, generator: &mut ChaCha8Rng) -> Vec<(String, Shape)> {
    let mut all = vec![
        ("a".to_owned(), sine(0.3, 0.12)),
        ("b".to_owned(), Shape::Triangle { peak_bar: 2.9, decay_per_s: 0.06, frequency_hz: 0.5 }),
        ("c".to_owned(), Shape::Sine { amplitude_bar: 0.55, decay_per_s: -0.05, frequency_hz: 0.35, sweep_hz_per_s: 0.0 }),
        ("d".to_owned(), Shape::Sine { amplitude_bar: 0.5, decay_per_s: -0.05, frequency_hz: 0.2, sweep_hz_per_s: 0.025 }),
    ];
    if kind == Excitation::Rich {
        all.push(("m".to_owned(), multisine(generator, 3.0)));
        all.push(("s".to_owned(), levels(generator, 1.7, 0.2)));
    }
    all
}

fn sine(frequency_hz: f64, decay_per_s: f64) -> Shape {
    Shape::Sine { amplitude_bar: AMPLITUDE_BAR, decay_per_s, frequency_hz, sweep_hz_per_s: 0.0 }
}

fn levels(generator: &mut ChaCha8Rng, dwell_s: f64, ramp_s: f64) -> Shape {
    let count = (COMMAND_S / dwell_s) as usize;
    let levels_bar = (0..count).map(|_| generator.random_range(0.0..2.0 * AMPLITUDE_BAR)).collect();
    Shape::Levels { levels_bar, dwell_s, ramp_s }
}

fn multisine(generator: &mut ChaCha8Rng, highest_hz: f64) -> Shape {
    let count = 12;
    let lines = (0..count)
        .map(|line| {
            let share = (f64::from(line) + generator.random::<f64>()) / f64::from(count);
            let frequency = 0.1 * (highest_hz / 0.1).powf(share);
            (0.35 / (1.0 + frequency).sqrt(), frequency, generator.random_range(0.0..2.0 * PI))
        })
        .collect();
    Shape::Multisine { middle_bar: 1.4, lines }
}
