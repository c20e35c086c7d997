//! Rows of equal readings: a sensor that has stopped reading, or a line that was cut.
//!
//! Two kinds of log-likelihood. A sensor with noise does not read the same value three times in a row, so such a row needs no model to be wrong.
//! Where readings do repeat (a sensor that reads in steps, a simulation without noise), a row is wrong only when it disagrees with a model.

use std::ops::Range;

use crate::data::session::{Run, Session};
use crate::data::worked::worked_with;

/// Fewest equal readings in a row of a sensor with noise that has stopped reading.
const FEWEST: usize = 3;

/// Longest row that chance is asked about: where chance makes longer ones, the sensor reads in steps.
const MOST: usize = 6;

/// How many rows by chance are too many in a session.
const BY_CHANCE: f64 = 0.01;

/// Largest share of a session in such rows: more often than that a sensor does not stop, something holds what it reads.
const OFTEN: f64 = 0.1;

/// Least noise of a sensor over its steps, and over the output's span, at which readings do not repeat.
const NOISE_OVER_STEP: f64 = 2.0;

const LEAST_NOISE: f64 = 3e-4;

/// Largest motion of the input that counts as rest, spans.
const REST: f64 = 1e-4;

/// Fewest equal readings in a row that disagree with a model.
const FEWEST_OFF: usize = 4;

/// Largest share of a recording in such rows: a sensor that often repeats itself reads something that holds.
const SELDOM: f64 = 0.05;

/// Rows of at least two equal values.
fn rows(values: &[f64]) -> Vec<Range<usize>> {
    let mut rows = Vec::new();
    let mut start = 0;
    for sample in 1..=values.len() {
        if sample == values.len() || values[sample] != values[start] {
            if sample - start > 1 {
                rows.push(start..sample);
            }
            start = sample;
        }
    }
    rows
}

/// Standard deviation of white noise from sixth differences: a motion without noise, kinks and all, leaves next to nothing of them.
fn noise_without_motion(values: &[f64]) -> f64 {
    const BINOMIALS: [f64; 7] = [1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0];
    let difference = |window: &[f64]| window.iter().zip(BINOMIALS).map(|(value, factor)| value * factor).sum::<f64>().abs();
    let mut sizes: Vec<f64> = values.windows(7).map(difference).collect();
    if sizes.is_empty() {
        return 0.0;
    }
    let middle = sizes.len() / 2;
    // The squares of the binomials add up to 924; the median of a normal deviate's size is 0.6745.
    *sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745 / 924.0_f64.sqrt()
}

/// Fewest equal readings in a row that chance does not make anywhere in the session; nothing where readings repeat by themselves.
///
/// Pairs of equal readings tell how often the sensor repeats itself by chance: a sensor that stops for a while makes no pairs.
fn too_many_equal(session: &Session) -> Option<usize> {
    let mut noises: Vec<f64> = session.worked().map(|run| noise_without_motion(&worked_with(run, &run.output))).collect();
    noises.sort_by(f64::total_cmp);
    if noises[noises.len() / 2] < LEAST_NOISE.max(NOISE_OVER_STEP * session.output_step) {
        return None;
    }
    let (mut samples, mut pairs, mut in_rows) = (0, 0, 0);
    for run in session.worked() {
        let shown = worked_with(run, &run.output);
        samples += shown.len();
        for row in rows(&shown) {
            if row.len() == 2 { pairs += 1 } else { in_rows += row.len() }
        }
    }
    let again = f64::from(pairs) / samples as f64;
    let fewest = (FEWEST..=MOST).find(|&length| samples as f64 * again.powi(length as i32 - 1) < BY_CHANCE)?;
    (in_rows as f64 <= OFTEN * samples as f64).then_some(fewest)
}

/// Masks every row that chance does not make while the input moves; returns how many samples are masked. At rest a sensor that has stopped
/// does no harm.
///
/// A sensor at the end of its range reads the same again and again too: rows at the highest or lowest reading of all wait for a model.
pub fn stopped(session: &mut Session) -> usize {
    let Some(fewest) = too_many_equal(session) else { return 0 };
    let span = |values: &[f64]| values.iter().fold((f64::MAX, f64::MIN), |(low, high), &value| (low.min(value), high.max(value)));
    let (lowest, highest) = session
        .worked()
        .map(|run| span(&worked_with(run, &run.output)))
        .fold((f64::MAX, f64::MIN), |all, one| (all.0.min(one.0), all.1.max(one.1)));
    let mut masked = 0;
    for run in session.runs.iter_mut().filter(|run| run.is_worked_with()) {
        for row in rows(&run.output).into_iter().filter(|row| row.len() >= fewest && is_shown(run, row)).collect::<Vec<_>>() {
            let (low, high) = span(&run.input[row.clone()]);
            let at_the_end = [lowest, highest].contains(&run.output[row.start]);
            if high - low > REST && !at_the_end {
                masked += mask(run, row);
            }
        }
    }
    masked
}

/// Whether a row of samples is worked with.
fn is_shown(run: &Run, row: &Range<usize>) -> bool {
    run.role[row.clone()].iter().all(|role| role.is_worked_with())
}

/// Masks rows that are off by more than `threshold` from the model that left `residual`.
///
/// Only where readings seldom repeat: else the sensor reads in steps, something holds the tip, or the recording has no noise. The reading that
/// is sent again goes with its repeats.
pub fn off_the_model(run: &mut Run, residual: &[f64], threshold: f64) -> usize {
    let rows: Vec<Range<usize>> = rows(&run.output).into_iter().filter(|row| row.len() >= FEWEST_OFF && is_shown(run, row)).collect();
    if rows.iter().map(Range::len).sum::<usize>() as f64 > SELDOM * run.output.len() as f64 {
        return 0;
    }
    let off = rows.into_iter().filter(|row| residual[row.clone()].iter().any(|value| value.abs() > threshold));
    off.map(|row| mask(run, row)).sum()
}

/// Masks these samples; returns how many were not masked before.
pub fn mask(run: &mut Run, samples: Range<usize>) -> usize {
    let kept = run.keep[samples.clone()].iter().filter(|keep| **keep).count();
    run.keep[samples].fill(false);
    kept
}

#[cfg(test)]
mod tests {
    use crate::data::frozen::stopped;
    use crate::data::session::Session;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use recording::{Recording, Signal};
    use std::path::Path;

    /// A sine that rests in its last quarter, read by `sensor` from true value, its number and noise.
    fn session(mut sensor: impl FnMut(usize, f64, f64) -> f64) -> Session {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let time_s: Vec<f64> = (0..1600).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 1.0 - (3.0 * time.min(24.0)).cos()).collect();
        let output = input.iter().enumerate().map(|(at, &value)| sensor(at, value, rng.random_range(-1.0..1.0))).collect();
        let recording = Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output);
        Session::new(&[recording.expect("a recording")], &[]).expect("a session")
    }

    #[test]
    fn a_noisy_sensor_that_stops_is_masked_wherever_the_input_moves() {
        let frozen = [(300, 4), (500, 25), (700, 3), (1400, 10)];
        let mut last = 0.0;
        let mut session = session(|at, value, noise| {
            if !frozen.iter().any(|&(from, length)| (from + 1..from + length).contains(&at)) {
                last = value + 0.02 * noise;
            }
            last
        });
        // The third lies in a block that is kept out.
        assert_eq!(stopped(&mut session), 4 + 25);
        assert!(session.runs[0].keep[299] && !session.runs[0].keep[300] && !session.runs[0].keep[524] && session.runs[0].keep[525]);
    }

    #[test]
    fn readings_that_repeat_by_themselves_are_kept() {
        // A sensor that reads in steps, a backlash without noise, a sensor at the end of its range, and a noisy sensor as it is.
        let mut held = 0.0_f64;
        let mut sessions = [
            session(|_, value, noise| ((value + 0.01 * noise) / 0.02).round() * 0.02),
            session(|_, value, _| {
                held = held.clamp(value - 0.05, value + 0.05);
                held
            }),
            session(|_, value, noise| (value + 0.02 * noise).min(1.8)),
            session(|_, value, noise| value + 0.02 * noise),
        ];
        for session in &mut sessions {
            assert_eq!(stopped(session), 0);
        }
    }
}
