//! Strokes of the input: how often, and in how many ways, a session has asked the rig.

use crate::data::session::{Run, Session};
use crate::data::turning::large_turns;

/// Least motion of the input that is a stroke, and in which two strokes may differ and be one again, spans.
const LEAST_STROKE: f64 = 0.02;

/// What the longer of two strokes may take over the shorter, if they are one again.
const LONGER: f64 = 1.25;

/// One way of the input, from a turn or a rest to the next.
#[derive(Clone, Copy, Debug)]
struct Stroke {
    /// Input at its ends, normalised.
    ends: [f64; 2],
    /// Time that it is under way, s.
    seconds: f64,
}

impl Stroke {
    /// A way along a path. How long it stays at either end is no part of it.
    fn along(path: &[f64], period_s: f64) -> Self {
        let ends = [path[0], path[path.len() - 1]];
        let is_at = |end: f64| move |value: &f64| (value - end).abs() <= LEAST_STROKE;
        let begin = path.iter().rposition(is_at(ends[0])).unwrap_or(0);
        let way = path[begin..].iter().position(is_at(ends[1])).unwrap_or(0);
        Self { ends, seconds: way as f64 * period_s }
    }

    /// Whether this is another one once more.
    fn repeats(&self, other: &Self) -> bool {
        let same_ends = self.ends.iter().zip(other.ends).all(|(own, other)| (own - other).abs() <= LEAST_STROKE);
        same_ends && self.seconds.max(other.seconds) <= LONGER * self.seconds.min(other.seconds)
    }
}

/// Strokes in a recording.
fn strokes_of(run: &Run) -> Vec<Stroke> {
    let ends = run.rest.iter().map(|rest| rest.start).chain([run.input.len() - 1]);
    let begins = [0].into_iter().chain(run.rest.iter().map(|rest| rest.end - 1));
    let moving = begins.zip(ends).filter(|(begin, end)| begin < end);
    let of = |path: &[f64]| -> Vec<Stroke> {
        large_turns(path, LEAST_STROKE).windows(2).map(|pair| Stroke::along(&path[pair[0]..=pair[1]], run.period_s)).collect()
    };
    moving.flat_map(|(begin, end)| of(&run.input[begin..=end])).collect()
}

/// Number of strokes in recordings that are worked with, and how many of them are unlike all before.
#[must_use]
pub fn count(session: &Session) -> [usize; 2] {
    let all: Vec<Stroke> = session.worked().flat_map(strokes_of).collect();
    let mut unlike: Vec<&Stroke> = Vec::new();
    for stroke in &all {
        if !unlike.iter().any(|other| stroke.repeats(other)) {
            unlike.push(stroke);
        }
    }
    [all.len(), unlike.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stroke_repeats_another_with_the_same_ends_as_fast_however_long_it_waits() {
        let ramp = |from: f64, to: f64, samples: u32| (0..=samples).map(move |at| from + (to - from) * f64::from(at) / f64::from(samples));
        let along = |path: Vec<f64>| Stroke::along(&path, 0.01);
        let up = along(ramp(0.1, 0.6, 50).collect());
        assert!((up.seconds - 0.46).abs() < 0.02 && up.ends == [0.1, 0.6]);
        let waiting = [0.1; 30].into_iter().chain(ramp(0.11, 0.59, 50)).chain([0.59; 40]).collect();
        assert!(along(waiting).repeats(&up));
        for other in [ramp(0.6, 0.1, 50), ramp(0.1, 0.5, 50), ramp(0.1, 0.6, 100)] {
            assert!(!along(other.collect()).repeats(&up));
        }
        // A step takes a sample.
        assert!(along(vec![0.1, 0.1, 0.6, 0.6]).repeats(&along(vec![0.1, 0.6])));
    }
}
