//! Bursts of wrong readings that scatter up and down from sample to sample, found whole.
//!
//! A reading inside a burst that happens to lie near the truth cannot be told from a right one, and does not have to be: it goes with its
//! neighbours. What moves by jumps (a sticking tip, a valve, a step of the input) jumps one way and stays, and what rings goes to and fro
//! slowly against the sample period and after something that set it off.

use std::ops::Range;

use crate::data::fast_noise::fast_noise;
use crate::data::session::Run;

/// Second difference of the output that no motion makes, over the deviation of its noise (whose own second differences scatter by 2.4 of it).
const OVER_NOISE: f64 = 10.0;

/// The same over the output's span, for a sensor with next to no fast noise.
const OVER_SPAN: f64 = 0.03;

/// Most samples inside a burst that lie on a line with their neighbours.
const INCONSPICUOUS: usize = 3;

/// Shortest and longest burst, samples with what surrounds it.
const SHORTEST: usize = 4;

const LONGEST: usize = 31;

/// Fewest turns between large steps of the output: out and back makes one, two spikes make three.
const TURNS: usize = 3;

/// How long a step of the input may set something ringing, s.
pub const RINGS_S: f64 = 1.0;

/// Where they are. `step` is that of a sensor that reads in steps.
pub fn bursts(run: &Run, step: f64) -> Vec<Range<usize>> {
    let output = &run.output;
    // A reading between two steps of the sensor flickers by one.
    let rough = (OVER_NOISE * fast_noise(output)).max(OVER_SPAN).max(2.5 * step);
    let marks: Vec<usize> =
        (1..output.len().saturating_sub(1)).filter(|&at| (output[at - 1] - 2.0 * output[at] + output[at + 1]).abs() > rough).collect();
    let groups: Vec<(usize, usize)> =
        marks.chunk_by(|one, next| next - one <= INCONSPICUOUS + 1).map(|group| (group[0], group[group.len() - 1])).collect();
    let before = (RINGS_S / run.period_s).ceil() as usize;
    let mut found = Vec::new();
    for (first, last) in groups {
        if !(SHORTEST..=LONGEST).contains(&(last - first + 1)) {
            continue;
        }
        let steps: Vec<f64> =
            run.output[first..=last].windows(2).map(|pair| pair[1] - pair[0]).filter(|step| step.abs() > 0.5 * rough).collect();
        let turns = steps.windows(2).filter(|pair| pair[0] * pair[1] < 0.0).count();
        let mut sizes: Vec<f64> = steps.iter().map(|step| step.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let usual = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
        let input = &run.input[first.saturating_sub(before)..=last];
        let caused = input.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        if turns >= TURNS && caused < 0.5 * usual {
            found.push(first..last + 1);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use crate::data::bursts::bursts;
    use crate::data::session::Session;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use recording::{Recording, Signal};
    use std::path::Path;

    /// How many samples of a sensor with half a percent of noise are masked, and whether 400 to 411 are among them.
    fn masked(input: impl Fn(f64) -> f64, wrong: impl Fn(usize, f64, f64) -> f64) -> (usize, bool) {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| input(*time)).collect();
        let draw = |rng: &mut ChaCha8Rng| rng.random_range(-1.0..1.0);
        let output =
            input.iter().enumerate().map(|(at, value)| value + 0.02 * draw(&mut rng) + wrong(at, *value, draw(&mut rng))).collect();
        let recording = Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let found = bursts(&session.runs[0], 0.0);
        (found.iter().map(|burst| burst.len()).sum(), (400..412).all(|at| found.iter().any(|burst| burst.contains(&at))))
    }

    fn sine(time: f64) -> f64 {
        1.0 - (4.0 * time).cos()
    }

    #[test]
    fn a_burst_is_masked_whole() {
        let (masked, whole) = masked(sine, |at, _, draw| if (400..412).contains(&at) { 0.6 * draw } else { 0.0 });
        assert!(whole && masked <= 16, "{masked}");
    }

    #[test]
    fn what_jumps_one_way_or_rings_after_a_step_is_kept() {
        // A tip that slips to where it is pulled as often as five samples.
        assert_eq!(masked(sine, |_, value, _| (value / 0.3).round() * 0.3 - value).0, 0);
        // A step of the output that stays.
        assert_eq!(masked(sine, |at, _, _| if at > 400 { 0.5 } else { 0.0 }).0, 0);
        // A resonance at ten hertz behind a step of the input.
        let step = |time: f64| if time < 8.0 { 0.0 } else { 2.0 };
        let rings = |at: usize, _: f64, _: f64| {
            let time = 0.02 * at as f64 - 8.0;
            if time < 0.0 { 0.0 } else { -2.0 * (-6.0 * time).exp() * (62.8 * time).cos() }
        };
        assert_eq!(masked(step, rings).0, 0);
    }
}
