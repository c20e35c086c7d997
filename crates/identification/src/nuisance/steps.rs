//! Whether a step is clear in what a reference leaves of a recording.

use super::named::{Candidates, Left, Nuisances};
use super::place::STEP_BLOCKS;
use super::statistics::{LEVEL, f_beyond, line};

/// Share of what the reference leaves of a recording that a step must explain.
const STEP_CLEAR: f64 = 0.5;
/// Steps below this share of the output's range are of no interest.
const STEP_SMALL: f64 = 0.01;
/// A step is sharp: within two windows of this share of a recording it shows so much of its height, and no other place shows more than
/// such a share of that.
const STEP_WINDOW: f64 = 0.02;
const STEP_SHARP: f64 = 0.7;
const STEP_ELSEWHERE: f64 = 0.5;

/// The steps that are clear in what a reference leaves. `range` is that of the output.
pub(crate) fn decide_on_steps(candidates: &Candidates, left: &[Left], range: f64) -> Nuisances {
    let mut found = Nuisances::none(candidates);
    for one in left {
        found.steps[one.series] = candidates.steps[one.series].is_some_and(|step| height_is_clear(one, step, range));
    }
    found
}

/// Whether a step is clear in what is left of a recording.
fn height_is_clear(one: &Left, step: usize, range: f64) -> bool {
    let edge = one.samples.partition_point(|&sample| sample < step);
    let count = one.samples.len();
    let share = edge as f64 / count.max(1) as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a small count")]
    let first = (share * STEP_BLOCKS as f64).round() as usize;
    if first < 2 || first + 2 > STEP_BLOCKS || edge < STEP_BLOCKS || count - edge < STEP_BLOCKS {
        return false;
    }
    let means = |values: &[f64], blocks: usize| -> Vec<f64> {
        let block = |index: usize| &values[index * values.len() / blocks..(index + 1) * values.len() / blocks];
        (0..blocks).map(|index| block(index).iter().sum::<f64>() / block(index).len() as f64).collect()
    };
    let mut blocks = means(&one.left[..edge], first);
    blocks.extend(means(&one.left[edge..], STEP_BLOCKS - first));
    let side: Vec<f64> = (0..STEP_BLOCKS).map(|index| f64::from(u8::from(index >= first))).collect();
    let order: Vec<f64> = (0..STEP_BLOCKS).map(|index| index as f64).collect();
    let (Some((_, constant, _)), Some((coefficients, stepped, _)), Some((_, sloped, _))) =
        (line(&[], &blocks), line(&[&side], &blocks), line(&[&order], &blocks))
    else {
        return false;
    };
    let freedom = STEP_BLOCKS as f64 - 2.0;
    let chance = f_beyond((constant - stepped) / (stepped / freedom).max(f64::MIN_POSITIVE), 1.0, freedom);
    let height = coefficients[0];
    let mean = one.left.iter().sum::<f64>() / count as f64;
    let square = one.left.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count as f64;
    if !is_sharp(&one.left, edge, height) {
        return false;
    }
    // The place was chosen among many: as many as there are blocks.
    let clear = chance * (STEP_BLOCKS as f64) < LEVEL && stepped < sloped;
    clear && height.powi(2) * share * (1.0 - share) > STEP_CLEAR * square && height.abs() > STEP_SMALL * range
}

/// Whether values jump at a place, by about a height, and nowhere else: the error of a model of the input changes with the input, and
/// that more than once.
fn is_sharp(values: &[f64], edge: usize, height: f64) -> bool {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count")]
    let window = ((STEP_WINDOW * values.len() as f64) as usize).max(3);
    let mut sums = vec![0.0];
    sums.extend(values.iter().scan(0.0, |sum, value| {
        *sum += value;
        Some(*sum)
    }));
    let jump = |at: usize| ((sums[at + window] - sums[at]) - (sums[at] - sums[at - window])).abs() / window as f64;
    let places = window..=values.len().saturating_sub(window);
    if !places.contains(&edge) || jump(edge) < STEP_SHARP * height.abs() {
        return false;
    }
    let elsewhere = places.filter(|at| at.abs_diff(edge) >= window).map(jump).fold(0.0, f64::max);
    elsewhere <= STEP_ELSEWHERE * jump(edge)
}
