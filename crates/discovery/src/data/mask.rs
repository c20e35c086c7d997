//! Finding samples that no motion could have caused: out and back within a few samples, while the input did nothing of the kind.

use std::ops::Range;

use crate::data::bursts::{RINGS_S, bursts};
use crate::data::fast_noise::{fast_noise, median};
use crate::data::frozen;
use crate::data::session::{Run, Session};
use crate::data::worked::worked_with;

/// Longest burst of wrong samples.
const LONGEST: usize = 8;

/// What a residual is that outliers are looked for in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Residual {
    /// The output itself: only jumps out and back, rows of equal readings and bursts that scatter count.
    Output,
    /// What a model leaves.
    OfModel,
    /// What a model leaves that jumps: a jump that it expects a sample early or late is no mistake of the sensor.
    OfJumps,
}

/// Masks outliers in `residual` (all recordings); returns how many samples are masked.
///
/// A burst counts when the residual jumps out by more than seven deviations of the noise and back by as much within [`LONGEST`] samples,
/// and the output itself does the same: a model's mistake in a fast motion does not return at once.
pub fn outliers(session: &mut Session, residual: &[Vec<f64>], kind: Residual) -> usize {
    // What the readings show by themselves, whatever the model.
    let mut masked = frozen::stopped(session);
    let threshold = |run: &Run| {
        let residual = &residual[run.index];
        let noise = fast_noise(&worked_with(run, residual)).max(fast_noise(&worked_with(run, &run.output))).max(1e-9);
        // A quantised or filtered sensor has next to no fast noise: what matters is also 2 % of the range, and five deviations of what
        // the model misses everywhere.
        let mut sizes: Vec<f64> = worked_with(run, residual).into_iter().map(f64::abs).collect();
        let usual = if kind != Residual::Output { 5.0 * median(&mut sizes) / 0.6745 } else { 0.0 };
        // A reading between two steps of the sensor flickers by one.
        (7.0 * noise).max(0.02).max(usual).max(2.5 * session.output_step)
    };
    let thresholds: Vec<f64> = session.runs.iter().map(|run| if run.is_worked_with() { threshold(run) } else { 0.0 }).collect();
    let mut mask = |session: &mut Session, finder: &dyn Fn(&Session, &Run) -> Vec<Range<usize>>| {
        let found: Vec<(usize, Vec<Range<usize>>)> = session.worked().map(|run| (run.index, finder(session, run))).collect();
        if !go_with_motion(session, &found) {
            let all = found.into_iter().flat_map(|(run, bursts)| bursts.into_iter().map(move |burst| (run, burst)));
            masked += all.map(|(run, burst)| frozen::mask(&mut session.runs[run], burst)).sum::<usize>();
        }
    };
    mask(session, &|session, run| bursts(run, session.output_step));
    mask(session, &|_, run| jumps(run, &residual[run.index], thresholds[run.index]));
    if kind == Residual::OfModel {
        mask(session, &|_, run| lonely(run, &residual[run.index], thresholds[run.index]));
        for run in session.runs.iter_mut().filter(|run| run.is_worked_with()) {
            masked += frozen::off_the_model(run, &residual[run.index], thresholds[run.index]);
        }
    }
    masked
}

/// Where residual and output jump out and back.
fn jumps(run: &Run, residual: &[f64], threshold: f64) -> Vec<Range<usize>> {
    let output = &run.output;
    let samples = output.len();
    let mut found = Vec::new();
    let mut sample = 1;
    while sample < samples {
        let jump = output[sample] - output[sample - 1];
        let length = (1..=LONGEST).find(|&length| {
            let end = sample + length;
            if end >= samples || jump.abs() < threshold {
                return false;
            }
            let back = output[end] - output[end - 1];
            let level = output[end] - output[sample - 1];
            let inside = sample..end;
            let out = inside.clone().all(|at| {
                let share = (at + 1 - sample) as f64 / (length + 1) as f64;
                let line = output[sample - 1] + share * level;
                (output[at] - line) * jump.signum() > 0.6 * jump.abs()
            });
            // Next to a jump that a model expects a sample early or late it errs, not the sensor.
            let mut beside = [&residual[sample.saturating_sub(BESIDE)..sample], &residual[end..(end + BESIDE).min(samples)]].concat();
            let usual = median(&mut beside);
            let residual_out = inside.clone().all(|at| (residual[at] - usual).abs() > 0.5 * jump.abs());
            back * jump < 0.0
                && back.abs() > 0.5 * jump.abs()
                && level.abs() < 0.4 * jump.abs()
                && out
                && residual_out
                && !could_cause(run, sample.saturating_sub(BESIDE)..end + 1, jump)
        });
        if let Some(length) = length {
            found.push(sample..sample + length);
            sample += length;
        }
        sample += 1;
    }
    found
}

/// Samples on either side of a burst that tell where it left from.
const BESIDE: usize = 3;

/// Whether the input has made a stroke of that size there, all in spans.
fn could_cause(run: &Run, there: Range<usize>, size: f64) -> bool {
    let there = &run.input[there.start..there.end.min(run.input.len())];
    let (low, high) = there.iter().fold((f64::MAX, f64::MIN), |(low, high), &value| (low.min(value), high.max(value)));
    high - low >= size.abs()
}

/// Deviations from which on a mean rank is no chance.
const NO_CHANCE: f64 = 3.0;

/// Whether bursts prefer the moments when the input moves, or has moved just before, so that something may still ring: a sensor errs at any time, and a
/// model lacks something where the rig moves. By the mean rank of the input's steps about each burst among those of all samples (Wilcoxon 1945).
fn go_with_motion(session: &Session, bursts: &[(usize, Vec<Range<usize>>)]) -> bool {
    if bursts.iter().all(|(_, of_run)| of_run.is_empty()) {
        return false;
    }
    [0.0, RINGS_S].into_iter().any(|before_s| {
        let steps = |run: &Run, at: usize| {
            let before = AROUND + (before_s / run.period_s) as usize;
            let around = &run.input[at.saturating_sub(before)..(at + AROUND + 1).min(run.input.len())];
            around.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max)
        };
        let mut all: Vec<f64> = session.worked().flat_map(|run| (0..run.input.len()).step_by(AROUND).map(|at| steps(run, at))).collect();
        all.sort_by(f64::total_cmp);
        let rank = |value: f64| {
            let below = all.partition_point(|other| *other < value);
            let up_to = all.partition_point(|other| *other <= value);
            0.5 * (below + up_to) as f64 / all.len() as f64
        };
        let of = |(run, bursts): &(usize, Vec<Range<usize>>)| -> Vec<f64> {
            bursts.iter().map(|burst| rank(steps(&session.runs[*run], burst.start))).collect()
        };
        let ranks: Vec<f64> = bursts.iter().flat_map(of).collect();
        // Ranks over their number are even between 0 and 1: their variance is a twelfth.
        let deviation = (12.0 * ranks.len() as f64).sqrt().recip();
        ranks.iter().sum::<f64>() > (0.5 + NO_CHANCE * deviation) * ranks.len() as f64
    })
}

/// Samples on either side that a burst is seen against.
const AROUND: usize = 9;

/// Short bursts in which residual and output both leave the level of their surroundings, while those keep still.
fn lonely(run: &Run, residual: &[f64], threshold: f64) -> Vec<Range<usize>> {
    let samples = residual.len();
    let deviation = |values: &[f64], at: usize| {
        let mut window: Vec<f64> = values[at.saturating_sub(AROUND)..(at + AROUND + 1).min(samples)].to_vec();
        values[at] - median(&mut window)
    };
    let of_residual: Vec<f64> = (0..samples).map(|at| deviation(residual, at)).collect();
    let mut wrong = Vec::new();
    for at in 0..samples {
        let size = of_residual[at];
        if size.abs() < threshold || !run.keep[at] {
            continue;
        }
        let mut near: Vec<f64> = (at.saturating_sub(AROUND)..(at + AROUND + 1).min(samples))
            .filter(|&other| other != at && run.keep[other])
            .map(|other| of_residual[other].abs())
            .collect();
        let quiet = median(&mut near) < 0.15 * size.abs();
        let output = deviation(&run.output, at);
        let is_late = could_cause(run, at.saturating_sub(1)..at + 2, size);
        if quiet && !is_late && output * size > 0.0 && output.abs() > 0.6 * size.abs() {
            wrong.push(at);
        }
    }
    // Longer stretches are motion that the model lacks, and what a recording begins with hangs on a past that nobody recorded.
    let rows = wrong.chunk_by(|one, next| *next == one + 1).map(|row| row[0]..row[row.len() - 1] + 1);
    let is_short = |row: &Range<usize>| row.len() <= LONGEST && row.start > LONGEST;
    rows.filter(|row| is_short(row) && returns(run, &of_residual, row.clone())).collect()
}

/// Whether the output is back behind the burst where it was before, but for what the input did meanwhile: what jumps and stays there is a stick position
/// that gave way, and no mistake of the sensor.
fn returns(run: &Run, of_residual: &[f64], burst: Range<usize>) -> bool {
    let (before, after) = (burst.start - 1, burst.end.min(of_residual.len() - 1));
    let size = of_residual[burst].iter().map(|value| value.abs()).fold(0.0, f64::max);
    let caused = (run.input[after] - run.input[before]).abs();
    (run.output[after] - run.output[before]).abs() < 0.5 * size + 1.5 * caused
}

#[cfg(test)]
mod tests {
    use crate::data::mask::{Residual, go_with_motion, outliers};
    use crate::data::session::Session;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use recording::{Recording, Signal};
    use std::path::Path;

    /// A recording with noise of half a percent, whose sensor reads zero, or its last value again, for eleven samples.
    fn session(reads: impl Fn(f64) -> f64, noise: f64) -> Session {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 1.0 - (3.0 * time).cos()).collect();
        let mut output: Vec<f64> = input.iter().map(|value| value + noise * rng.random_range(-1.0..1.0)).collect();
        let last = output[399];
        output[400..411].fill(reads(last));
        let recording = Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output);
        Session::new(&[recording.expect("a recording")], &[]).expect("a session")
    }

    #[test]
    fn a_stick_position_that_gives_way_is_no_outlier_and_a_reading_that_comes_back_is_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 1.0 - (0.5 * time).cos()).collect();
        for (samples, masked) in [(400..406, 0), (400..401, 1)] {
            // The model knows of the stick position one sample late; after six samples the stick position goes back.
            let mut residual: Vec<f64> = (0..1000).map(|_| 0.005 * rng.random_range(-1.0..1.0)).collect();
            let mut output: Vec<f64> = input.iter().zip(&residual).map(|(value, noise)| value + noise).collect();
            samples.for_each(|sample| output[sample] += 0.4);
            let (time_s, input) = (time_s.clone(), input.clone());
            let recording = Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output);
            let mut session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
            residual[400] += 0.4 / session.output_scale;
            assert_eq!(outliers(&mut session, &[residual], Residual::OfModel), masked);
        }
    }

    #[test]
    fn an_answer_to_a_short_pulse_is_no_outlier_though_the_model_expects_its_ends_a_sample_off() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let pulse = |first: usize, last: usize| move |at: usize| f64::from(u8::from((first..last).contains(&at)));
        // The input's pulse is answered; without one the same reading is wrong.
        for (commanded, masked) in [(true, 0), (false, 7)] {
            let input: Vec<f64> = (0..1000).map(|at| pulse(200, 230)(at) + f64::from(u8::from(commanded)) * pulse(599, 606)(at)).collect();
            let mut draw = |_| 0.005 * rng.random_range(-1.0..1.0);
            let mut residual: Vec<f64> = (0..1000).map(&mut draw).collect();
            let output: Vec<f64> = (0..1000).map(|at| residual[at] + pulse(200, 230)(at) + 0.9 * pulse(600, 607)(at)).collect();
            if commanded {
                // Expected a sample early.
                (residual[599], residual[606]) = (-0.6, 0.4);
            } else {
                residual[600..607].iter_mut().for_each(|value| *value += 0.9);
            }
            let recording =
                Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s.clone(), input, output);
            let mut session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
            assert_eq!(outliers(&mut session, &[residual], Residual::OfModel), masked);
        }
    }

    #[test]
    fn a_sensor_that_stops_reading_is_masked_and_one_that_holds_where_it_should_is_not() {
        let left = |session: &Session| -> Vec<Vec<f64>> {
            session.runs.iter().map(|run| run.output.iter().zip(&run.input).map(|(y, u)| y - u).collect()).collect()
        };
        for (share_of_last, first, noise) in [(0.0, 400, 0.02), (1.0, 399, 0.02), (0.0, 400, 0.0), (1.0, 399, 0.0)] {
            let mut session = session(|last| share_of_last * last, noise);
            let residual = left(&session);
            assert_eq!(outliers(&mut session, &residual, Residual::OfModel), 411 - first);
            let run = &session.runs[0];
            let shown = (0..run.keep.len()).filter(|&at| run.role[at].is_worked_with());
            assert!(shown.into_iter().all(|at| run.keep[at] != (first..411).contains(&at)));
        }
        // Readings without noise that repeat themselves where the model says the same are right.
        let mut right = session(|last| last, 0.0);
        let mut residual = left(&right);
        residual[0][400..411].fill(0.0);
        assert_eq!(outliers(&mut right, &residual, Residual::OfModel), 0);
    }

    #[test]
    fn what_errs_at_any_time_is_the_sensor_and_what_errs_in_fast_motion_is_not() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        // The input of this recording is fastest half-way between its turns, every 52 samples.
        let session = session(|last| last, 0.005);
        let bursts = |at: &mut dyn FnMut() -> usize| vec![(0, (0..12).map(|_| at()).map(|at| at..at + 2).collect::<Vec<_>>())];
        let mut turn = 0;
        let mut fast = || {
            turn += 1;
            26 + 52 * turn
        };
        assert!(go_with_motion(&session, &bursts(&mut fast)));
        let often = (0..200).filter(|_| go_with_motion(&session, &bursts(&mut || rng.random_range(10..990)))).count();
        // Three deviations: one in 740 by chance.
        assert!(often <= 3, "{often} of 200");
        assert!(!go_with_motion(&session, &[]));
    }

    #[test]
    fn what_errs_half_a_second_after_steps_may_ring_and_is_not_the_sensor() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let time_s: Vec<f64> = (0..3000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| (0.25 * time).floor() % 2.0).collect();
        let output: Vec<f64> = input.iter().map(|value| value + 0.005 * rng.random_range(-1.0..1.0)).collect();
        let recording = Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let bursts = |at: &mut dyn FnMut(usize) -> usize| vec![(0, (1..13).map(&mut *at).map(|at| at..at + 2).collect::<Vec<_>>())];
        assert!(go_with_motion(&session, &bursts(&mut |step| 200 * step + 25)));
        let often = (0..200).filter(|_| go_with_motion(&session, &bursts(&mut |_| rng.random_range(10..2990)))).count();
        assert!(often <= 4, "{often} of 200");
    }
}
