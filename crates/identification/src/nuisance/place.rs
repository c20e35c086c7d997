//! Where a step is most likely, in one recording by itself.

use super::statistics::range;
use crate::Series;

/// Strokes of the input that a recording must have, and each side of a step: fewer say too little of what the input explains.
const STROKES: usize = 8;
const STROKES_BESIDE: usize = 3;
/// A stroke moves an input by this share of its range in the recording.
const STROKE: f64 = 0.2;
/// Places of a step are tried between this share of a recording and one less this share.
const STEP_MARGIN: f64 = 0.15;
/// Blocks of a recording whose means tell a step.
pub(super) const STEP_BLOCKS: usize = 16;
/// Samples that a place is looked for in, at most.
const SCANNED: usize = 1200;

/// Samples at which the input that turns most often turns.
fn turns(series: &Series) -> Vec<usize> {
    let of = |values: &Vec<f64>| {
        let values = &values[series.skip.min(values.len())..];
        let (low, high) = range(values.iter().copied());
        let (mut extreme, mut rising, mut found) = (values.first().copied().unwrap_or(0.0), true, Vec::new());
        for (index, &value) in values.iter().enumerate() {
            let beyond = if rising { value - extreme } else { extreme - value };
            if beyond > 0.0 {
                extreme = value;
            } else if beyond < -STROKE * (high - low) {
                found.push(series.skip + index);
                (extreme, rising) = (value, !rising);
            }
        }
        found
    };
    series.inputs.iter().map(of).max_by_key(Vec::len).unwrap_or_default()
}

/// The most likely place of a step in one recording by itself: the maximum of the likelihood ratio of a step beside columns of the input.
pub(super) fn place(series: &Series, columns: impl Fn(&Series, &[usize]) -> Vec<Vec<f64>>) -> Option<usize> {
    let turns = turns(series);
    if turns.len() < STROKES {
        return None;
    }
    let counted = series.skip..series.len();
    let stride = counted.len().div_ceil(SCANNED).max(1);
    let kept: Vec<usize> = counted.step_by(stride).collect();
    let (count, columns) = (kept.len(), columns(series, &kept));
    if count < 4 * columns.len().max(STEP_BLOCKS) {
        return None;
    }
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let residual = |basis: &[Vec<f64>], mut values: Vec<f64>| {
        for column in basis {
            let product: f64 = column.iter().zip(&values).map(|(one, other)| one * other).sum();
            values.iter_mut().zip(column).for_each(|(value, column)| *value -= product * column);
        }
        values
    };
    let square = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    for column in std::iter::once(vec![1.0; count]).chain(columns) {
        let before = square(&column);
        let left = residual(&basis, column);
        let after = square(&left);
        // What the others nearly make up would only follow noise.
        if after > 1e-6 * before {
            basis.push(left.iter().map(|value| value / after.sqrt()).collect());
        }
    }
    let left = residual(&basis, kept.iter().map(|&sample| series.output[sample]).collect());
    // Sums from the end: those over the samples behind each place.
    let mut tails = vec![0.0; basis.len()];
    let mut tail = 0.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count")]
    let margin = (STEP_MARGIN * count as f64).ceil() as usize;
    let mut best = (0.0, None);
    for place in (0..count).rev() {
        tail += left[place];
        tails.iter_mut().zip(&basis).for_each(|(sum, column)| *sum += column[place]);
        if place < margin || place + margin > count {
            continue;
        }
        let size = (count - place) as f64 - square(&tails);
        let gain = if size > 1e-3 * (count - place) as f64 { tail * tail / size } else { 0.0 };
        if gain > best.0 {
            best = (gain, Some(kept[place]));
        }
    }
    best.1.filter(|place| (STROKES_BESIDE..=turns.len() - STROKES_BESIDE).contains(&turns.partition_point(|turn| turn < place)))
}
