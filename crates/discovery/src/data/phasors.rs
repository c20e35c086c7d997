//! Sums of a signal's values, each times a phasor, at many frequencies side by side.

use std::f64::consts::PI;

use pulp::{Arch, Simd, WithSimd};

use crate::data::session::Session;

/// Real and imaginary part of the sums of `values` times `exp(2 pi i f t)` at these frequencies, Hz; the first value is one of the time `start_s`.
pub fn transform(values: &[f64], start_s: f64, period_s: f64, frequencies_hz: &[f64]) -> [Vec<f64>; 2] {
    let count = frequencies_hz.len();
    let of = |time_s: f64| -> [Vec<f64>; 2] {
        // Whole groups for the processor, whatever comes of the last few.
        let angles = frequencies_hz.iter().map(|hz| (2.0 * PI * hz * time_s).sin_cos()).chain([(0.0, 1.0); GROUP]);
        let (sine, cosine): (Vec<f64>, Vec<f64>) = angles.take(count.next_multiple_of(GROUP)).unzip();
        [cosine, sine]
    };
    let (turn, phase) = (of(period_s), of(start_s));
    let mut sums = [vec![0.0; phase[0].len()], vec![0.0; phase[0].len()]];
    Arch::new().dispatch(Turning { values, phase: &phase, turn: &turn, sums: &mut sums });
    sums.map(|mut sums| {
        sums.truncate(count);
        sums
    })
}

/// Distance of the lines that a recording can resolve, with some overlap, Hz.
#[must_use]
pub fn spacing_hz(session: &Session) -> f64 {
    spacing_over_hz(session.runs.iter().map(|run| run.time_s.last().copied().unwrap_or(0.0)).fold(1.0, f64::max))
}

/// The same of one that takes so long, s.
#[must_use]
pub fn spacing_over_hz(length_s: f64) -> f64 {
    0.4 / length_s
}

/// Frequencies side by side: four vectors on the widest processors.
const GROUP: usize = 32;

/// Vectors of frequencies side by side.
const VECTORS: usize = 4;

/// Sums of values, each times a phasor (its real parts, then its imaginary ones) that turns from one value to the next.
struct Turning<'a> {
    values: &'a [f64],
    phase: &'a [Vec<f64>; 2],
    turn: &'a [Vec<f64>; 2],
    sums: &'a mut [Vec<f64>; 2],
}

impl WithSimd for Turning<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let lanes = VECTORS * S::F64_LANES;
        for first in (0..self.phase[0].len()).step_by(lanes) {
            let group = |of: &[f64]| -> [S::f64s; VECTORS] {
                let (vectors, _) = S::as_simd_f64s(&of[first..first + lanes]);
                std::array::from_fn(|at| vectors[at])
            };
            let ([mut re, mut im], [cosine, sine]) = (self.phase.each_ref().map(|of| group(of)), self.turn.each_ref().map(|of| group(of)));
            let mut sums = [[simd.splat_f64s(0.0); VECTORS]; 2];
            for &value in self.values {
                let value = simd.splat_f64s(value);
                for at in 0..VECTORS {
                    sums[0][at] = simd.add_f64s(sums[0][at], simd.mul_f64s(value, re[at]));
                    sums[1][at] = simd.add_f64s(sums[1][at], simd.mul_f64s(value, im[at]));
                    let turned = simd.sub_f64s(simd.mul_f64s(re[at], cosine[at]), simd.mul_f64s(im[at], sine[at]));
                    im[at] = simd.add_f64s(simd.mul_f64s(re[at], sine[at]), simd.mul_f64s(im[at], cosine[at]));
                    re[at] = turned;
                }
            }
            for (all, sums) in self.sums.iter_mut().zip(sums) {
                S::as_mut_simd_f64s(&mut all[first..first + lanes]).0.copy_from_slice(&sums);
            }
        }
    }
}
