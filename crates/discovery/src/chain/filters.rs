//! First-order lags and shifts of a signal, and the grids that a search of their parameters begins with.

use crate::chain::columns::Filter;
use crate::chain::elementary;
use crate::data::turning::between_samples;

/// Coefficients `(keep, now, before)` of a first-order lag that is exact for straight lines between samples.
#[inline(always)]
pub fn lag_coefficients(time_constant_s: f64, period_s: f64) -> (f64, f64, f64) {
    let ratio = period_s / time_constant_s.max(1e-6);
    let keep = elementary::exp(-ratio);
    let mean = (1.0 - keep) / ratio;
    (keep, 1.0 - mean, mean - keep)
}

/// A first-order lag that starts settled.
#[derive(Clone, Copy, PartialEq)]
pub struct Lag {
    keep: f64,
    now: f64,
    before: f64,
}

impl Lag {
    pub fn new(time_constant_s: f64, period_s: f64) -> Self {
        let (keep, now, before) = lag_coefficients(time_constant_s, period_s);
        Self { keep, now, before }
    }
    /// The state after a straight line from `last` to `value`.
    #[inline(always)]
    pub fn after(&self, state: f64, last: f64, value: f64) -> f64 {
        self.keep * state + self.now * value + self.before * last
    }
}

impl Filter<2> for Lag {
    fn begin(&self, first: f64) -> [f64; 2] {
        [first; 2]
    }
    #[inline(always)]
    fn step(&self, [state, last]: &mut [f64; 2], value: f64) -> f64 {
        *state = self.after(*state, *last, value);
        *last = value;
        *state
    }
}

/// Sends `signal` through a first-order lag that starts settled.
pub(crate) fn lag(signal: &mut [f64], time_constant_s: f64, period_s: f64) {
    Lag::new(time_constant_s, period_s).run(signal);
}

/// Sends a `signal` that holds from one sample to the next through a first-order lag that starts settled.
pub fn lag_of_held(signal: &mut [f64], time_constant_s: f64, period_s: f64) {
    let keep = (-period_s / time_constant_s).exp();
    let mut state = signal[0];
    let mut last = signal[0];
    for value in signal {
        state = last + keep * (state - last);
        last = *value;
        *value = state;
    }
}

/// Delays `signal` by `delay(index)` samples, which may be negative or fractional; what comes of it does not overshoot its neighbours, but
/// for turns between two samples.
///
/// Of the parabolas through three samples on either side the straighter one has more weight; where both bend alike the two make the cubic of
/// Catmull and Rom. So a ramp is a ramp up to the sample where it ends, and a corner between two samples stays one.
pub fn shift(signal: &mut [f64], scratch: &[f64], delay: impl Fn(usize) -> f64) {
    /// Bends of less than a hundredth of a percent of the span are as good as straight.
    const STRAIGHT: f64 = 1e-8;
    let last = scratch.len() - 1;
    let at = |index: isize| scratch[index.clamp(0, last as isize) as usize];
    let turns = between_samples(scratch);
    for (index, value) in signal.iter_mut().enumerate() {
        let place = index as f64 - delay(index);
        let floor = place.floor();
        let share = place - floor;
        let floor = floor as isize;
        let (a, b, c, d) = (at(floor - 1), at(floor), at(floor + 1), at(floor + 2));
        if let Ok(turn) = turns.binary_search_by_key(&(floor + 1), |turn| turn.0 as isize) {
            let onward = |last: f64, step: f64, bend: f64, share: f64| last + share * step + 0.5 * share * (share + 1.0) * bend;
            let (z, e) = (at(floor - 2), at(floor + 3));
            let (left, right) = (onward(b, b - a, b - 2.0 * a + z, share), onward(c, c - d, c - 2.0 * d + e, 1.0 - share));
            let top = turns[turn].1;
            *value = if top > b { left.min(right).clamp(b.min(c), top) } else { left.max(right).clamp(top, b.max(c)) };
            continue;
        }
        let (bend_before, bend_behind) = (a - 2.0 * b + c, b - 2.0 * c + d);
        let weight = |bend: f64| 1.0 / (STRAIGHT + bend * bend).powi(2);
        let (before, behind) = ((1.0 - share) * weight(bend_before), share * weight(bend_behind));
        let bend = (before * bend_before + behind * bend_behind) / (before + behind);
        *value = (b + share * (c - b) - 0.5 * share * (1.0 - share) * bend).clamp(b.min(c), b.max(c));
    }
}

/// The `count` points of a grid with the highest scores, best first.
pub fn best_starts(grid: impl Iterator<Item = Vec<f64>>, score: impl Fn(&Vec<f64>) -> f64, count: usize) -> Vec<Vec<f64>> {
    let mut scored: Vec<(f64, Vec<f64>)> = grid.map(|point| (score(&point), point)).collect();
    scored.sort_by(|x, y| y.0.total_cmp(&x.0));
    scored.into_iter().take(count).map(|entry| entry.1).collect()
}

/// Values from `low` to `high` at equal ratios.
pub(crate) fn ladder(low: f64, high: f64, count: usize) -> Vec<f64> {
    (0..count).map(|step| low * (high / low).powf(step as f64 / (count - 1) as f64)).collect()
}

/// Every value of the first parameter with every one of the second, and so on; the last changes first.
pub(crate) fn grid(axes: &[&[f64]]) -> Vec<Vec<f64>> {
    axes.iter().fold(vec![Vec::new()], |points, axis| with(points, axis))
}

/// Every point with every value of one parameter more.
pub(crate) fn with(points: Vec<Vec<f64>>, values: &[f64]) -> Vec<Vec<f64>> {
    points.iter().flat_map(|point| values.iter().map(|value| [&point[..], &[*value]].concat())).collect()
}

#[cfg(test)]
mod tests {
    use super::{grid, lag, shift};

    #[test]
    fn a_grid_has_every_value_with_every_other_and_the_last_changes_first() {
        let points = [[1.0, 3.0, 4.0], [1.0, 3.0, 5.0], [2.0, 3.0, 4.0], [2.0, 3.0, 5.0]];
        assert_eq!(grid(&[&[1.0, 2.0], &[3.0], &[4.0, 5.0]]), points);
    }

    #[test]
    fn the_lag_is_exact_on_a_ramp() {
        // Answer of T v' = u - v to u = a t from rest: v = a (t - T + T exp(-t/T)).
        let (period_s, time_s, slope) = (0.02, 0.13, 1.7);
        let mut signal: Vec<f64> = (0..200).map(|sample| slope * f64::from(sample) * period_s).collect();
        lag(&mut signal, time_s, period_s);
        for (sample, value) in (0..200).zip(&signal) {
            let t = f64::from(sample) * period_s;
            let exact = slope * (t - time_s + time_s * (-t / time_s).exp());
            assert!((value - exact).abs() < 1e-12, "at {t} s: {value} instead of {exact}");
        }
    }

    #[test]
    fn the_shift_is_exact_on_a_parabola_and_holds_the_first_value() {
        let before: Vec<f64> = (0..100).map(|sample| (f64::from(sample) / 10.0).powi(2)).collect();
        let mut after = before.clone();
        shift(&mut after, &before, |_| 7.3);
        for sample in 10..99_u32 {
            let exact = ((f64::from(sample) - 7.3) / 10.0).powi(2);
            assert!((after[sample as usize] - exact).abs() < 1e-10, "sample {sample}");
        }
        assert_eq!(after[0], before[0]);
    }

    #[test]
    fn a_triangle_and_a_ramp_that_ends_are_shifted_exactly() {
        // Corners of the triangle lie anywhere between samples, those of the staircase on them.
        let triangle = |sample: f64| 1.0 - (2.0 * (sample / 13.37).fract() - 1.0).abs();
        let stairs = |sample: f64| (sample / 40.0).floor() + (sample / 10.0 - 4.0 * (sample / 40.0).floor()).min(1.0);
        for (name, wave) in [("triangle", &triangle as &dyn Fn(f64) -> f64), ("stairs", &stairs)] {
            let before: Vec<f64> = (0..400).map(|sample| wave(f64::from(sample))).collect();
            let mut after = before.clone();
            shift(&mut after, &before, |_| 2.3);
            let largest = (10..390).map(|sample| (after[sample] - wave(sample as f64 - 2.3)).abs()).fold(0.0, f64::max);
            assert!(largest < 1e-6, "{name}: off by {largest}");
        }
    }
}
