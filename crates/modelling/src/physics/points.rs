//! Curves through points: made from a function, in the blob's form.

use model_export::schema::{self, MAX_BENDS};
use serde::{Deserialize, Serialize};

/// A curve through points, straight between them; the first and the last piece go on outside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Points {
    /// Where, ascending; two at least.
    pub from: Vec<f64>,
    /// The value there.
    pub to: Vec<f64>,
}

/// Samples of a function, between which a curve may bend.
const SAMPLES: usize = 300;

impl Points {
    /// The curve of as many pieces as a blob holds whose largest distance to `function` is the least, among those that meet it where they
    /// bend, for values from `low` to `high`.
    ///
    /// Dynamic programming over the places of the bends (Bellman, *Communications of the ACM* 4, 1961).
    #[must_use]
    pub fn near(function: impl Fn(&[f64]) -> Vec<f64>, low: f64, high: f64) -> Self {
        let from: Vec<f64> = (0..=SAMPLES).map(|sample| low + (high - low) * sample as f64 / SAMPLES as f64).collect();
        let to = function(&from);
        let chord = |first: usize, last: usize| {
            let slope = (to[last] - to[first]) / (last - first) as f64;
            (first + 1..last).map(|at| (to[at] - to[first] - slope * (at - first) as f64).abs()).fold(0.0, f64::max)
        };
        // What is nearer by less than this is not worth a piece.
        let same = 1e-9 * to.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        // The least distance up to each sample with so many pieces, and where its last piece begins.
        let mut best: Vec<Vec<(f64, usize)>> = vec![(0..=SAMPLES).map(|last| (if last == 0 { 0.0 } else { chord(0, last) }, 0)).collect()];
        for pieces in 1..=MAX_BENDS {
            let before = &best[pieces - 1];
            let of = |last: usize| {
                let mut least = before[last];
                for first in (1..last).rev() {
                    let distance = chord(first, last).max(before[first].0);
                    if distance < least.0 - same {
                        least = (distance, first);
                    }
                }
                least
            };
            best.push((0..=SAMPLES).map(of).collect());
        }
        let mut corners = vec![SAMPLES];
        let mut pieces = MAX_BENDS;
        while let Some(&last) = corners.last().filter(|&&last| last > 0) {
            let (distance, first) = best[pieces][last];
            // The same distance with fewer pieces: the last of them begins there too.
            let first = if pieces > 0 && best[pieces - 1][last].0 <= distance { best[pieces - 1][last].1 } else { first };
            corners.push(first);
            pieces = pieces.saturating_sub(1);
        }
        corners.reverse();
        Self { from: corners.iter().map(|&at| from[at]).collect(), to: corners.iter().map(|&at| to[at]).collect() }
    }

    /// Slopes of the pieces.
    pub fn slopes(&self) -> Vec<f64> {
        self.from.windows(2).zip(self.to.windows(2)).map(|(from, to)| (to[1] - to[0]) / (from[1] - from[0])).collect()
    }

    /// The value at `from`.
    #[must_use]
    pub fn at(&self, from: f64) -> f64 {
        let piece = self.from[1..self.from.len() - 1].partition_point(|corner| *corner <= from);
        let (low, high) = (self.from[piece], self.from[piece + 1]);
        self.to[piece] + (self.to[piece + 1] - self.to[piece]) * (from - low) / (high - low)
    }

    /// In the blob's form, for values divided by `from_scale` that give values divided by `to_scale`; `None` when it has more bends than the
    /// blob holds.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
    pub fn dead_zones(&self, from_scale: f64, to_scale: f64) -> Option<schema::Curve> {
        let slopes: Vec<f64> = self.slopes().iter().map(|slope| slope * from_scale / to_scale).collect();
        let first = *slopes.first()?;
        let offset = self.to[0] / to_scale - first * self.from[0] / from_scale;
        let mut curve = schema::Curve { offset: offset as f32, slope: first as f32, ..schema::Curve::default() };
        for (point, pair) in self.from.iter().skip(1).zip(slopes.windows(2)) {
            curve.bend_points.push((point / from_scale) as f32).ok()?;
            curve.bends.push((pair[1] - pair[0]) as f32).ok()?;
        }
        Some(curve)
    }

    /// What is wrong with it, if anything.
    pub(super) fn problem(&self) -> Option<&'static str> {
        let is_shaped = self.from.len() >= 2 && self.from.len() == self.to.len();
        let is_ascending = self.from.windows(2).all(|pair| pair[0] < pair[1]);
        let is_finite = self.from.iter().chain(&self.to).all(|value| value.is_finite());
        (!(is_shaped && is_ascending && is_finite)).then_some("a curve needs two or more ascending points, and a value for each")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn through(function: fn(f64) -> f64) -> impl Fn(&[f64]) -> Vec<f64> {
        move |values| values.iter().map(|value| function(*value)).collect()
    }

    #[test]
    fn a_curve_of_straight_pieces_is_met_with_as_many_and_no_more() {
        let corner = |x: f64| if x < 0.75 { 2.0 * x } else { 1.5 };
        let points = Points::near(through(corner), 0.0, 3.0);
        assert_eq!(points.from.len(), 3, "{points:?}");
        for x in [-1.0, 0.1, 0.7, 0.75, 0.8, 2.9, 5.0] {
            assert!((points.at(x) - corner(x)).abs() < 1e-12, "{x}: {}", points.at(x));
        }
        assert_eq!(Points::near(through(|x| 3.0 - x), -1.0, 1.0).from, [-1.0, 1.0]);
    }

    #[test]
    fn a_parabola_is_met_as_nearly_as_nine_chords_can() {
        // Chords of equal length are the best: off by (1 / 9)^2 / 4 at most.
        let points = Points::near(through(|x| x * x), 0.0, 1.0);
        let farthest = (0..=1000).map(|at| f64::from(at) / 1000.0).map(|x| (points.at(x) - x * x).abs()).fold(0.0, f64::max);
        assert_eq!(points.from.len(), MAX_BENDS + 2);
        assert!(farthest < 1.1 / 324.0, "{farthest}");
    }

    #[test]
    fn the_blobs_form_has_the_same_values() {
        let points = Points { from: vec![-1.0, 0.5, 2.0, 3.0], to: vec![0.25, 1.0, 0.5, 0.5] };
        let curve = points.dead_zones(2.0, 0.5).expect("few bends");
        for x in [-2.0, 0.0, 1.0, 2.5, 4.0] {
            let p = x / 2.0;
            let bends: f64 =
                curve.bend_points.iter().zip(&curve.bends).map(|(point, bend)| f64::from(*bend) * (p - f64::from(*point)).max(0.0)).sum();
            let value = f64::from(curve.offset) + f64::from(curve.slope) * p + bends;
            assert!((value * 0.5 - points.at(x)).abs() < 1e-6, "{x}: {value}");
        }
    }
}
