//! A zero that moves although the input does not ask for it: a step or a slow drift within a recording, and offsets between recordings.
//!
//! A least-squares surface over the past of the input stands for what the input explains; within a recording play operators stand beside
//! it. A step, or a straight line in time, is added, its own part that the input explains taken off. It is named only when it takes away
//! at least half of what is left.

use hysteresis::play;

use super::{Recording, clock, history, surface};

/// Samples that a recording is judged by, at most.
const MOST_SAMPLES: usize = 1200;
/// Places at which a step is tried.
const PLACES: usize = 60;
/// Share of the remaining squares that must vanish.
const CLEAR: f64 = 0.5;
/// Share of the output's range below which a moving zero is of no interest.
const SMALL: f64 = 0.01;
/// Play operators of each input: a loop remembers larger strokes than the last, and what it remembers moves the output like a zero.
const PLAYS: usize = 8;
/// Strokes that must lie on each side of a step, and in the whole recording: a few strokes say too little of what the input explains.
const STROKES: f64 = 2.0;
const FEWEST_STROKES: f64 = 10.0;

/// A zero that moved.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Moved {
    /// All at once.
    Step {
        /// Time of the recording's clock in s.
        time_s: f64,
        /// Index of the first sample behind it.
        index: usize,
        /// By how much, in the output's unit.
        by: f64,
    },
    /// Evenly over the recording.
    Drift {
        /// By how much from start to end, in the output's unit.
        by: f64,
    },
}

/// The mean of what the input leaves unexplained, per recording.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Offsets {
    /// One for each recording, in the output's unit.
    pub offsets: Vec<f64>,
    /// Their standard deviation.
    pub spread: f64,
    /// What they change by from the first to the last recording, where a straight line explains at least half of them.
    pub drift: Option<f64>,
}

/// Whether the zero of one recording moves clearly.
#[must_use]
pub fn within(recording: &Recording) -> Option<Moved> {
    let stroke_s = recording.inputs().into_iter().filter_map(|values| history::stroke_s(recording, values)).fold(0.0, f64::max);
    let scales = history::scales(std::slice::from_ref(recording));
    let span_s = recording.time_s[recording.len() - 1] - recording.time_s[0];
    if stroke_s <= 0.0 || span_s < FEWEST_STROKES * stroke_s {
        return None;
    }
    let stride = recording.len().div_ceil(MOST_SAMPLES);
    let kept: Vec<usize> = (0..recording.len()).step_by(stride).collect();
    let pasts = history::points(recording, &scales, stroke_s);
    let mut basis = Basis::new(&kept.iter().map(|&index| pasts[index].as_slice()).collect::<Vec<_>>());
    for values in recording.inputs() {
        let lowest = values.iter().copied().fold(f64::INFINITY, f64::min);
        let half = 0.5 * clock::range(values);
        for threshold in (0..PLAYS).map(|number| half * (number as f64 + 0.5) / PLAYS as f64) {
            // It may have come to the first value from rest, or from anywhere.
            for mut state in [values[0], lowest] {
                let path = values.iter().map(|&value| {
                    state = play::step(threshold, value, state);
                    state
                });
                let path: Vec<f64> = path.collect();
                basis.add(kept.iter().map(|&index| path[index]).collect());
            }
        }
    }
    let left = basis.residual(kept.iter().map(|&index| recording.output[index]).collect());
    let total: f64 = left.iter().map(|value| value * value).sum();
    // What a column takes away of the squares, and by how much it moves the output.
    let gain = |column: Vec<f64>| {
        let own = basis.residual(column);
        let size: f64 = own.iter().map(|value| value * value).sum();
        let product: f64 = own.iter().zip(&left).map(|(own, left)| own * left).sum();
        if size > 1e-9 * kept.len() as f64 { (product * product / size / total, product / size) } else { (0.0, 0.0) }
    };
    let place = |index: usize| (recording.time_s[index] - recording.time_s[0]) / span_s;
    let (drift_share, drift) = gain(kept.iter().map(|&index| place(index)).collect());
    let margin = STROKES * stroke_s / span_s;
    let mut best = (0.0, 0.0, 0);
    for number in 0..PLACES {
        let at = margin + (1.0 - 2.0 * margin) * (number as f64 + 0.5) / PLACES as f64;
        let (share, by) = gain(kept.iter().map(|&index| f64::from(u8::from(place(index) >= at))).collect());
        if share > best.0 {
            best = (share, by, recording.time_s.partition_point(|&time_s| (time_s - recording.time_s[0]) / span_s < at));
        }
    }
    let matters = |by: f64| by.abs() > SMALL * clock::range(&recording.output);
    if total <= 0.0 || drift_share.max(best.0) < CLEAR {
        return None;
    }
    if best.0 >= drift_share {
        let (_, by, index) = best;
        matters(by).then(|| Moved::Step { time_s: recording.time_s[index], index, by })
    } else {
        matters(drift).then_some(Moved::Drift { by: drift })
    }
}

/// What the input leaves unexplained in each recording on average, by one surface for all; none for less than three recordings.
#[must_use]
pub fn across(recordings: &[Recording]) -> Option<Offsets> {
    if recordings.len() < 3 {
        return None;
    }
    let strokes: Vec<f64> = recordings.iter().filter_map(|recording| history::stroke_s(recording, &recording.input)).collect();
    if strokes.is_empty() {
        return None;
    }
    let (stroke_s, scales) = (clock::quantile(strokes, 0.5), history::scales(recordings));
    let stride = recordings.iter().map(Recording::len).sum::<usize>().div_ceil(4 * MOST_SAMPLES).max(1);
    let (mut pasts, mut outputs, mut owners) = (Vec::new(), Vec::new(), Vec::new());
    for (owner, recording) in recordings.iter().enumerate() {
        for (index, past) in history::points(recording, &scales, stroke_s).into_iter().enumerate().step_by(stride) {
            pasts.push(past);
            outputs.push(recording.output[index]);
            owners.push(owner);
        }
    }
    let left = surface::residuals(&pasts.iter().map(Vec::as_slice).collect::<Vec<_>>(), &outputs);
    let mean = |owner: usize| {
        let own: Vec<f64> = left.iter().zip(&owners).filter(|(_, of)| **of == owner).map(|(left, _)| *left).collect();
        own.iter().sum::<f64>() / own.len().max(1) as f64
    };
    let offsets: Vec<f64> = (0..recordings.len()).map(mean).collect();
    let rows: Vec<Vec<f64>> = (0..offsets.len()).map(|order| vec![1.0, order as f64]).collect();
    let square = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    let centre = offsets.iter().sum::<f64>() / offsets.len() as f64;
    let total = square(&offsets.iter().map(|offset| offset - centre).collect::<Vec<_>>());
    let explained = 1.0 - square(&surface::left(&rows, &offsets)) / total;
    let slope = surface::solve(&rows, &offsets)[1];
    // Five points make half a line by chance one time in six, eight one time in twenty.
    let drift = (offsets.len() >= 8 && explained >= CLEAR).then_some(slope * (offsets.len() - 1) as f64);
    Some(Offsets { spread: (total / (offsets.len() - 1) as f64).sqrt(), offsets, drift })
}

/// Orthonormal columns of a surface over the past.
struct Basis {
    columns: Vec<Vec<f64>>,
}

impl Basis {
    /// A constant, the coordinates and their squares, made orthonormal one after the other.
    fn new(points: &[&[f64]]) -> Self {
        let mut basis = Self { columns: Vec::new() };
        let size = points.first().map_or(0, |point| point.len());
        let linear = (0..size).map(|place| points.iter().map(|point| point[place]).collect::<Vec<f64>>());
        let squares = (0..size).map(|place| points.iter().map(|point| point[place] * point[place]).collect::<Vec<f64>>());
        std::iter::once(vec![1.0; points.len()]).chain(linear).chain(squares).for_each(|column| basis.add(column));
        basis
    }

    /// Adds what is new in a column.
    fn add(&mut self, column: Vec<f64>) {
        let before: f64 = column.iter().map(|value| value * value).sum();
        let left = self.residual(column);
        let after: f64 = left.iter().map(|value| value * value).sum();
        // A column that the others make up adds nothing but rounding.
        if after > 1e-8 * before {
            self.columns.push(left.iter().map(|value| value / after.sqrt()).collect());
        }
    }

    /// What the columns leave of values.
    fn residual(&self, mut values: Vec<f64>) -> Vec<f64> {
        for column in &self.columns {
            let product: f64 = column.iter().zip(&values).map(|(one, other)| one * other).sum();
            values.iter_mut().zip(column).for_each(|(value, column)| *value -= product * column);
        }
        values
    }
}
