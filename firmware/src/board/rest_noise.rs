//! Noise of the measured channels at rest: root mean square about the mean over a second, while the rig is vented.
//!
//! The tick sums whole codes; the background takes the root. Nothing acts on the result, it is for whoever wires the rig: mains hum, a bad
//! ground and a sensor near its end show here first.

use micromath::F32Ext;

use crate::drivers::RawSample;

/// Samples of a window, as a power of two: about a second.
const WINDOW_LOG2: u32 = 10;
const WINDOW: u32 = 1 << WINDOW_LOG2;
/// Fraction bits of a mean square.
const FRACTION_BITS: u32 = 8;

/// Sums of one channel, of codes less the first one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Sums {
    first: u16,
    sum: i64,
    squares: i64,
}

impl Sums {
    fn add(&mut self, code: u16) {
        let difference = i64::from(code) - i64::from(self.first);
        // 1024 squares of 16 bits: far from 63.
        self.sum += difference;
        self.squares += difference * difference;
    }

    /// Mean square about the mean, in codes squared with [`FRACTION_BITS`].
    fn mean_square(&self) -> u32 {
        // n * sum of squares - square of the sum is n^2 times the variance, and never negative.
        let scaled = (self.squares << WINDOW_LOG2) - self.sum * self.sum;
        u32::try_from(scaled >> (2 * WINDOW_LOG2 - FRACTION_BITS)).unwrap_or(u32::MAX)
    }
}

/// The window so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RestNoise {
    laser: Sums,
    pressure: Sums,
    samples: u32,
}

impl RestNoise {
    /// Takes in a sample. At the end of a window at rest: the mean squares of laser and pressure, for [`root_mean_square`].
    ///
    /// # Deadline
    /// No loops.
    pub fn step(&mut self, sample: RawSample, is_at_rest: bool) -> Option<[u32; 2]> {
        if !is_at_rest || sample == RawSample::MISSING {
            self.samples = 0;
            return None;
        }
        if self.samples == 0 {
            self.laser = Sums { first: sample.laser_code, ..Sums::default() };
            self.pressure = Sums { first: sample.pressure_code, ..Sums::default() };
        }
        self.laser.add(sample.laser_code);
        self.pressure.add(sample.pressure_code);
        self.samples += 1;
        if self.samples < WINDOW {
            return None;
        }
        self.samples = 0;
        Some([self.laser.mean_square(), self.pressure.mean_square()])
    }
}

/// The root of a mean square of [`RestNoise::step`], in codes; true to 0.2 %.
pub fn root_mean_square(mean_square: u32) -> f32 {
    if mean_square == 0 {
        return 0.0;
    }
    // 32 bits in a float of 24: no more than 6e-8 off. The fraction's weight is 2^-8.
    let square =
        (crate::number::to_f32(i32::try_from(mean_square >> 1).unwrap_or(i32::MAX)) * 2.0 + f32::from(mean_square & 1 == 1)) / 256.0;
    // Within 6 %; one of Heron's steps makes 0.2 % of it.
    let near = F32Ext::sqrt(square);
    0.5 * (near + square / near)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::vec::Vec;

    use super::*;
    use crate::parity::Noise;

    fn measured(codes: impl Fn(u32) -> (u16, u16)) -> Vec<[f64; 2]> {
        let mut noise = RestNoise::default();
        let windows = (0..3 * WINDOW).filter_map(|tick| {
            let (laser_code, pressure_code) = codes(tick);
            noise.step(RawSample { laser_code, pressure_code }, true)
        });
        windows.map(|squares| squares.map(|square| f64::from(root_mean_square(square)))).collect()
    }

    fn expected(codes: impl Fn(u32) -> u16, window: u32) -> f64 {
        let all: Vec<f64> = (window * WINDOW..(window + 1) * WINDOW).map(|tick| f64::from(codes(tick))).collect();
        let mean = all.iter().sum::<f64>() / f64::from(WINDOW);
        (all.iter().map(|code| (code - mean).powi(2)).sum::<f64>() / f64::from(WINDOW)).sqrt()
    }

    #[test]
    fn hum_and_noise_are_measured_within_a_percent_of_what_they_are() {
        let mut chance = Noise::new(11);
        let table: Vec<f64> = (0..3 * WINDOW).map(|_| f64::from(chance.symmetric())).collect();
        for (hum, noise) in [(0.0, 4.0), (40.0, 4.0), (2000.0, 100.0), (0.0, 0.0)] {
            let laser = |tick: u32| {
                let phase = std::f64::consts::TAU * 0.05 * f64::from(tick);
                (4000.0 + hum * phase.sin() + noise * table[tick as usize]).round() as u16
            };
            let pressure = |tick: u32| 1700 + (tick % 2) as u16 * 3;
            let windows = measured(|tick| (laser(tick), pressure(tick)));
            assert_eq!(windows.len(), 3);
            for (window, [of_laser, of_pressure]) in (0..).zip(windows) {
                let truth = expected(laser, window);
                // A mean square has eight bits behind the point, and the root is true to 0.2 %.
                assert!((of_laser - truth).abs() <= 0.005 * truth + 0.07 * f64::from(truth < 1.0), "{of_laser} for {truth}");
                assert!((of_pressure - 1.5).abs() < 0.005, "{of_pressure}");
            }
        }
    }

    #[test]
    fn the_root_is_true_to_a_quarter_of_a_percent_over_the_whole_range() {
        for square in (0..32).flat_map(|bit| [1u32 << bit, (1u32 << bit).wrapping_mul(3) / 2, u32::MAX >> bit]) {
            let truth = (f64::from(square) / 256.0).sqrt();
            assert!((f64::from(root_mean_square(square)) - truth).abs() <= 0.0025 * truth, "{square}");
        }
    }

    #[test]
    fn only_a_whole_window_at_rest_counts() {
        let mut noise = RestNoise::default();
        let sample = RawSample { laser_code: 100, pressure_code: 100 };
        for (missing, at_rest) in [(false, false), (true, true)] {
            for _ in 0..WINDOW - 1 {
                assert_eq!(noise.step(sample, true), None);
            }
            assert_eq!(noise.step(if missing { RawSample::MISSING } else { sample }, at_rest), None);
        }
        // Far from the codes before: they must not be in it.
        let other = RawSample { laser_code: 8000, pressure_code: 50 };
        let found: Vec<_> = (0..WINDOW).filter_map(|_| noise.step(other, true)).collect();
        assert_eq!(found, [[0, 0]]);
    }
}
