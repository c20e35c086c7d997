//! What to record before tuning.

use std::f64::consts::PI;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::control::PERIOD_S;

/// Pressures in bar, 20 ms apart, that show a controller's needs: decaying sines at several frequencies for the loops, random levels for lag
/// and creep, a sum of sines for everything between. Two minutes in all.
#[must_use]
pub fn excitation(highest_bar: f64, seed: u64) -> Vec<Vec<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let sampled = |seconds: f64, shape: &dyn Fn(f64) -> f64| -> Vec<f64> {
        (0..(seconds / PERIOD_S).round() as usize).map(|point| shape(point as f64 * PERIOD_S).clamp(0.0, highest_bar)).collect()
    };
    let mut all = Vec::new();
    for (frequency, decay) in [(0.2, 0.05), (0.45, 0.08), (0.8, 0.1)] {
        all.push(sampled(20.0, &|time| 0.5 * highest_bar * (-decay * time).exp() * (1.0 - (2.0 * PI * frequency * time).cos())));
    }
    for dwell_s in [0.7, 2.5] {
        let levels: Vec<f64> = (0..40).map(|_| random.random_range(0.0..highest_bar)).collect();
        all.push(sampled(20.0, &|time| levels[(time / dwell_s) as usize]));
    }
    let lines: Vec<(f64, f64)> = (0..6).map(|line| (0.15 + 0.25 * f64::from(line), random.random_range(0.0..2.0 * PI))).collect();
    all.push(sampled(20.0, &|time| {
        let sum: f64 = lines.iter().map(|(frequency, phase)| (2.0 * PI * frequency * time + phase).sin()).sum();
        0.5 * highest_bar * (1.0 - (-time).exp()) + 0.15 * highest_bar * sum
    }));
    all
}
