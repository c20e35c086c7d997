//! Where the output answers a step of the command at once, but late: when, between two samples, nobody has recorded.
//!
//! A command that steps between two samples did so at the one, at the other or anywhere between. The sample at which the delayed step
//! arrives may lie before it or behind it, and misses the model by anything up to the whole step. In a session of steps these few samples
//! would outweigh all that tells one effect from another. What follows a step smoothly (a lag, a mass) has no such sample, and where every
//! answer comes in the sample of its step nothing is late.

use std::ops::Range;

use crate::data::fast_noise::fast_noise;
use crate::data::session::Run;
use crate::data::worked::worked_with;

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

/// Largest share of the answers that may come in another sample than their step where nothing is late: noise looks like one at times.
const BY_CHANCE: f64 = 0.1;

/// An answer of the output to a step of the command.
struct Answer {
    run: usize,
    /// The sample behind which the output moves at once.
    behind: usize,
    /// Whether the command steps behind another sample.
    late: bool,
}

/// Samples on either side of the answers of each run; none where all answers come at once.
pub fn on_either_side(runs: &[Run]) -> Vec<(usize, usize)> {
    let answers: Vec<Answer> = runs.iter().enumerate().flat_map(|(index, run)| answers(index, run)).collect();
    let late = answers.iter().filter(|answer| answer.late).count();
    if late as f64 <= BY_CHANCE * answers.len() as f64 {
        return Vec::new();
    }
    answers.iter().flat_map(|answer| [(answer.run, answer.behind), (answer.run, answer.behind + 1)]).collect()
}

/// The answers in one run.
fn answers(index: usize, run: &Run) -> Vec<Answer> {
    let steps = steps(&run.input);
    let within = (WITHIN_S / run.period_s).round() as usize;
    let noise = fast_noise(&worked_with(run, &run.output));
    let mut found = Vec::new();
    for (place, &step) in steps.iter().enumerate() {
        // Up to the answers to its neighbours.
        let first = place.checked_sub(1).map_or(0, |before| steps[before].midpoint(step)).max(step.saturating_sub(within));
        let last = steps.get(place + 1).map_or(run.input.len() - 1, |next| next.midpoint(step)).min(step + within);
        if !run.keep[first..=last].iter().all(|keep| *keep) {
            continue;
        }
        let Some(behind) = (first..last).max_by(|x, y| moved(run, *x..*x + 1).total_cmp(&moved(run, *y..*y + 1))) else { continue };
        let about = behind.saturating_sub(2)..(behind + 3).min(run.output.len() - 1);
        let size = moved(run, behind..behind + 1);
        if size > OVER_NOISE * noise && size > AT_ONCE * moved(run, about) {
            found.push(Answer { run: index, behind, late: behind != step });
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

#[cfg(test)]
mod tests {
    use crate::data::session::{Role, Session};
    use crate::tests::deviates;
    use recording::{Recording, Signal};
    use std::path::Path;

    /// Samples of a session of steps every 1.25 s that nothing is done with, if the output answers so much later and with that lag.
    fn unused(late_s: f64, lag_s: f64) -> Vec<usize> {
        let mut noise = deviates(0x9E37_79B9_7F4A_7C15);
        let levels: Vec<f64> = (0..20).map(|_| 1.0 + 0.5 * noise()).collect();
        let level = |time_s: f64| if time_s < 1.0 { 0.0 } else { levels[((time_s - 1.0) / 1.25) as usize] };
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time_s| level(*time_s)).collect();
        // In steps of a millisecond.
        let mut state = 0.0;
        let mut fine = |step: i32| {
            let wanted = level((f64::from(step) * 1e-3 - late_s).max(0.0));
            state += if lag_s > 0.0 { 1e-3 / lag_s } else { 1.0 } * (wanted - state);
            state
        };
        let all: Vec<f64> = (0..20_000).map(&mut fine).collect();
        let output: Vec<f64> = all.into_iter().step_by(20).map(|value| value + 0.005 * noise()).collect();
        let recording = Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        (0..1000).filter(|&sample| run.role[sample] == Role::Nothing).collect()
    }

    #[test]
    fn where_steps_are_answered_late_and_at_once_the_samples_beside_the_answers_are_not_used() {
        let unused = unused(0.107, 0.0);
        // The first step is at 1 s, before sample 50, and its answer at 1.107 s, between samples 55 and 56.
        assert_eq!(unused[..2], [55, 56]);
        // Two blocks of the twelve are kept out: nobody looks at them.
        assert!((20..=27).contains(&unused.len()), "{unused:?}");
        // The next steps are answered 1.25 s, 62 samples and a half, later.
        assert!(unused.contains(&117) && unused.contains(&118), "{unused:?}");
    }

    #[test]
    fn where_steps_are_answered_in_their_own_sample_or_smoothly_all_samples_are_used() {
        assert_eq!(unused(0.0, 0.0), Vec::<usize>::new());
        assert_eq!(unused(0.0, 0.15), Vec::<usize>::new());
        assert_eq!(unused(0.04, 0.15), Vec::<usize>::new());
    }
}
