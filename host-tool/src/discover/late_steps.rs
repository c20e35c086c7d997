//! Where the output answers a step of the command at once, but late: when, between two samples, nobody has recorded.
//!
//! A command that steps between two samples did so at the one, at the other or anywhere between. The sample at which the delayed step
//! arrives may lie before it or behind it, and misses the model by anything up to the whole step. In a session of steps these few samples
//! would outweigh all that tells one effect from another. What follows a step smoothly (a lag, a mass) has no such sample.

use std::ops::Range;

use super::mask::fast_noise;
use super::session::Run;

/// Least motion of the input within one sample that is a step, spans.
const STEP: f64 = 0.03;
/// Most motion in the samples beside it, as a share of it.
const BESIDE: f64 = 0.2;
/// Within what time of the step the output may answer, s: tubes and clocks shift either way.
const WITHIN_S: f64 = 0.35;
/// Share of its change about the answer that the output makes within one sample.
const AT_ONCE: f64 = 0.5;
/// Least answer, in deviations of the noise.
const OVER_NOISE: f64 = 4.0;

/// Samples on either side of such an answer.
pub fn on_either_side(run: &Run) -> Vec<usize> {
    let steps = steps(&run.input);
    let within = (WITHIN_S / run.period_s).round() as usize;
    let noise = fast_noise(&run.output);
    let mut found = Vec::new();
    for (index, &step) in steps.iter().enumerate() {
        // Up to the answers to its neighbours.
        let first = index.checked_sub(1).map_or(0, |before| steps[before].midpoint(step)).max(step.saturating_sub(within));
        let last = steps.get(index + 1).map_or(run.input.len() - 1, |next| next.midpoint(step)).min(step + within);
        let answer = (first..last).max_by(|x, y| moved(run, *x..*x + 1).total_cmp(&moved(run, *y..*y + 1)));
        let Some(answer) = answer else { continue };
        let about = answer.saturating_sub(2)..(answer + 3).min(run.output.len() - 1);
        let size = moved(run, answer..answer + 1);
        if size > OVER_NOISE * noise && size > AT_ONCE * moved(run, about) {
            found.extend([answer, answer + 1]);
        }
    }
    found
}

/// How far the output moves from sample to sample.
fn moved(run: &Run, samples: Range<usize>) -> f64 {
    (run.output[samples.end] - run.output[samples.start]).abs()
}

/// Samples behind which the input steps.
fn steps(input: &[f64]) -> Vec<usize> {
    let sizes: Vec<f64> = input.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    let at = |sample: Option<usize>| sample.and_then(|sample| sizes.get(sample)).copied().unwrap_or(0.0);
    let is_step = |&sample: &usize| {
        let beside = at(sample.checked_sub(1)).max(at(sample.checked_add(1)));
        sizes[sample] > STEP && beside < BESIDE * sizes[sample]
    };
    (0..sizes.len()).filter(is_step).collect()
}
