//! The commands of a session of the composed rig.

use std::f64::consts::PI;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::command::{Excitation, Shape};

/// Length of a recording, s.
pub(super) const LENGTH_S: f64 = 20.0;
/// Rest at the start of a recording, s.
pub(super) const REST_S: f64 = 1.5;
/// Recordings to work with.
pub(super) const RECORDINGS: usize = 20;

/// The commands of a session, with a short name each.
pub(super) fn commands(kind: Excitation, span_bar: f64, generator: &mut ChaCha8Rng) -> Vec<(String, Shape)> {
    let one = |index: usize, generator: &mut ChaCha8Rng| {
        let frequency_hz = 0.12 * (9.0_f64).powf(generator.random::<f64>());
        let decay_per_s = generator.random_range(0.0..0.2);
        let sine = Shape::Sine { amplitude_bar: 0.5 * span_bar, decay_per_s, frequency_hz, sweep_hz_per_s: 0.0 };
        let levels = |generator: &mut ChaCha8Rng, dwell_s: f64, ramp_s: f64| Shape::Levels {
            levels_bar: (0..(LENGTH_S / dwell_s) as usize).map(|_| generator.random_range(0.0..span_bar)).collect(),
            dwell_s,
            ramp_s,
        };
        match (kind, index % 5) {
            (Excitation::Rich, 1) => ("steps", levels(generator, 1.6, 0.01)),
            (Excitation::Rich, 2) => ("ramps", levels(generator, 1.1, 1.1)),
            (Excitation::Rich, 3) => {
                let lines = (1..=10_u32)
                    .map(|line| {
                        let frequency = f64::from(line) * 0.37;
                        (0.28 * span_bar / f64::from(line).sqrt() / 2.0, frequency, generator.random_range(0.0..2.0 * PI))
                    })
                    .collect();
                ("multisine", Shape::Multisine { middle_bar: 0.45 * span_bar, lines })
            }
            (Excitation::Rich, 4) => (
                "triangle",
                Shape::Triangle {
                    peak_bar: span_bar * generator.random_range(0.5..1.0),
                    decay_per_s: 0.03,
                    frequency_hz: 1.5 * frequency_hz,
                },
            ),
            _ => ("sine", sine),
        }
    };
    (0..RECORDINGS + 4)
        .map(|index| {
            let (name, shape) = one(index, generator);
            (format!("{name}_{index:02}.csv"), shape)
        })
        .collect()
}
