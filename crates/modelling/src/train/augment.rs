//! Synthetic training recordings: where an identified physics model explains the recordings, it can answer excitations that were not
//! recorded.
//!
//! A network learns only what its recordings visit: trained on decaying sines it has never seen an amplitude grow. When a
//! Prandtl-Ishlinskii model identified from the *training* recordings alone predicts the *validation* recordings almost without error,
//! it is used to simulate richer excitations of the same range, rate and input noise. Where it does not, as on most real rigs, nothing
//! is added. The report counts what was added; validation is always on real recordings.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::tracks::{Purpose, stream};
use crate::identify::{self, FitConfig, PhysicsModel};
use recording::Recording;

/// The ways to get from one level to the next.
#[derive(Clone, Copy)]
enum Ease {
    Linear,
    Cosine,
}

/// What synthetic inputs have in common with the recorded ones.
struct Character {
    low: f64,
    high: f64,
    /// Rates of the recorded inputs between which synthetic ones lie, in input units per sample.
    slow: f64,
    fast: f64,
    /// Half width of the uniform noise on the input.
    noise: f64,
    /// Where recordings start.
    starts: Vec<f64>,
    samples: usize,
}

/// Simulated recordings, as many as `count`; none when no physics model predicts the validation recordings to within `limit` of the
/// output's range.
#[must_use]
pub fn synthetic(recordings: &[Recording], parts: &[Vec<bool>], count: usize, limit: f64, seed: u64) -> Vec<Recording> {
    let whole = |training: bool| -> Vec<Recording> {
        let matching = recordings.iter().zip(parts).filter(|(_, part)| part.iter().all(|&part| part == training));
        matching.map(|(recording, _)| recording.clone()).collect()
    };
    let (training, validation) = (whole(true), whole(false));
    // The excitations are of one input.
    let several = recordings.iter().any(|recording| !recording.more_inputs.is_empty());
    if count == 0 || several || training.is_empty() || validation.is_empty() {
        return Vec::new();
    }
    // What cannot be identified cannot be simulated either; the network is then trained on what was recorded.
    let Ok(fit) = identify::fit(&training, &FitConfig::default()) else { return Vec::new() };
    if !explains(&fit.model, &validation, limit) {
        return Vec::new();
    }
    let character = Character::of(&training);
    (0..count)
        .filter_map(|index| {
            let mut random = stream(seed, Purpose::Synthetic, index as u64);
            let input = character.excitation(&mut random);
            let output = fit.model.simulate(&input);
            let first = &training[0];
            let time_s = (0..input.len()).map(|sample| sample as f64 * first.sample_period_s).collect();
            let path = format!("synthetic_{:03}", index + 1);
            Recording::new(path.as_ref(), first.input_signal.clone(), first.output_signal.clone(), time_s, input, output).ok()
        })
        .collect()
}

fn explains(model: &PhysicsModel, validation: &[Recording], limit: f64) -> bool {
    let (mut squares, mut samples) = (0.0, 0.0);
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for recording in validation {
        let (rmse, ..) = model.errors(recording);
        squares += rmse * rmse * recording.len() as f64;
        samples += recording.len() as f64;
        (low, high) = recording.output.iter().fold((low, high), |(low, high), &value| (low.min(value), high.max(value)));
    }
    (squares / samples).sqrt() < limit * (high - low)
}

impl Character {
    fn of(recordings: &[Recording]) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut rates, mut bends) = (Vec::new(), Vec::new());
        for recording in recordings {
            let input = &recording.input;
            (low, high) = input.iter().fold((low, high), |(low, high), &value| (low.min(value), high.max(value)));
            // Over ten samples, so that noise does not pass for motion.
            rates.extend(input.windows(11).map(|window| (window[10] - window[0]).abs() / 10.0));
            bends.extend(input.windows(3).map(|window| (window[0] - 2.0 * window[1] + window[2]).abs()));
        }
        let quantile = |values: &mut Vec<f64>, share: f64| {
            values.sort_by(f64::total_cmp);
            let last = values.len().saturating_sub(1);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index within the vector")]
            let index = (share * last as f64) as usize;
            values.get(index).copied().unwrap_or(0.0)
        };
        let fast = quantile(&mut rates, 0.99);
        let slow = quantile(&mut rates, 0.2).max(0.02 * fast);
        // Of independent noise, second differences have sqrt(6) times its spread; half of a normal distribution lies within 0.6745 of
        // its spread, and a uniform one of half width w has the spread w / sqrt(3).
        let spread = quantile(&mut bends, 0.5) / (0.6745 * 6.0_f64.sqrt());
        Self {
            low,
            high,
            slow,
            fast,
            noise: spread * 3.0_f64.sqrt(),
            starts: recordings.iter().map(|recording| recording.input[0]).collect(),
            samples: recordings.iter().map(Recording::len).max().unwrap_or(0),
        }
    }

    /// A row of swings between levels: growing, shrinking, or anywhere; with holds.
    fn excitation(&self, random: &mut ChaCha8Rng) -> Vec<f64> {
        let range = self.high - self.low;
        let start = match random.random::<f64>() < 0.7 {
            true => self.starts[random.random_range(0..self.starts.len())],
            false => self.low + range * random.random::<f64>(),
        };
        let ease = if random.random::<f64>() < 0.6 { Ease::Cosine } else { Ease::Linear };
        let noise = if random.random::<f64>() < 0.75 { self.noise } else { 0.0 };
        let mut levels = Levels::new(self, random);
        let mut input = vec![start];
        let mut level = start;
        while input.len() < self.samples {
            let (next, duration) = levels.next(self, level, random);
            for sample in 1..=duration {
                let along = sample as f64 / duration as f64;
                let along = match ease {
                    Ease::Linear => along,
                    Ease::Cosine => 0.5 - 0.5 * (std::f64::consts::PI * along).cos(),
                };
                input.push(level + (next - level) * along);
            }
            level = next;
        }
        input.truncate(self.samples);
        for value in &mut input {
            let shake = if noise > 0.0 { random.random_range(-noise..noise) } else { 0.0 };
            *value = (*value + shake).clamp(self.low, self.high);
        }
        input
    }
}

/// Decides where the next swing goes and how long it takes.
enum Levels {
    /// Back and forth about a base with an amplitude that changes by a factor each time, at a period that drifts.
    Swing { base: f64, amplitude: f64, factor: f64, samples: f64, drift: f64, up: bool },
    /// Anywhere, at any rate, sometimes resting.
    Anywhere { holds: f64 },
}

impl Levels {
    fn new(character: &Character, random: &mut ChaCha8Rng) -> Self {
        let range = character.high - character.low;
        if random.random::<f64>() < 0.35 {
            return Self::Anywhere { holds: if random.random::<f64>() < 0.5 { 0.3 } else { 0.0 } };
        }
        let grows = random.random::<f64>() < 0.6;
        let factor = (if grows { 1.0 } else { -1.0 } * random.random_range(0.0..0.35f64)).exp();
        let largest = range * random.random_range(0.5..1.0);
        let amplitude = if grows { largest * random.random_range(0.05..0.5) } else { largest };
        let base = match random.random::<f64>() < 0.6 {
            true => character.low,
            false => character.low + (range - largest) * random.random::<f64>(),
        };
        let rate = character.slow * (character.fast / character.slow).powf(random.random_range(0.3..1.0));
        let drift = random.random_range(-0.05..0.05f64).exp();
        Self::Swing { base, amplitude, factor, samples: (largest / rate).max(2.0), drift, up: true }
    }

    /// Level and duration in samples.
    fn next(&mut self, character: &Character, from: f64, random: &mut ChaCha8Rng) -> (f64, usize) {
        let range = character.high - character.low;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded by the recording's length")]
        let whole = |samples: f64| samples.round().clamp(1.0, character.samples as f64) as usize;
        match self {
            Self::Swing { base, amplitude, factor, samples, drift, up } => {
                let level = if *up { *base + *amplitude } else { *base };
                *up = !*up;
                *amplitude = (*amplitude * *factor).min(character.high - *base);
                *samples *= *drift;
                (level, whole(*samples))
            }
            Self::Anywhere { holds } => {
                if random.random::<f64>() < *holds {
                    return (from, whole(random.random_range(0.02..0.3) * character.samples as f64));
                }
                let level = character.low + range * random.random::<f64>();
                let rate = character.slow * (character.fast / character.slow).powf(random.random::<f64>());
                (level, whole((level - from).abs() / rate))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::Signal;

    /// Two play operators on decaying sines; `bend` adds what no play operator can do.
    fn sine(index: usize, bend: f64) -> Recording {
        let mut random = stream(77, Purpose::Visit, index as u64);
        let samples = 600;
        let frequency = 0.004 + 0.004 * index as f64;
        let mut memory = [0.0f64; 2];
        let input: Vec<f64> = (0..samples)
            .map(|sample| {
                let time = f64::from(sample);
                let sine = (std::f64::consts::TAU * frequency * time - 1.57).sin() + 1.0;
                (-0.002 * time).exp() * sine + random.random_range(0.0..0.05)
            })
            .collect();
        let output = input
            .iter()
            .map(|&input| {
                for (memory, threshold) in memory.iter_mut().zip([0.1, 0.35]) {
                    *memory = memory.clamp(input - threshold, input + threshold);
                }
                memory[0] + 0.5 * memory[1] + bend * input * input
            })
            .collect();
        let time_s = (0..samples).map(|sample| f64::from(sample) * 0.02).collect();
        let path = format!("sine_{index}.csv");
        Recording::new(path.as_ref(), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output).unwrap()
    }

    fn set(bend: f64) -> (Vec<Recording>, Vec<Vec<bool>>) {
        let recordings: Vec<Recording> = (0..6).map(|index| sine(index, bend)).collect();
        let parts = recordings.iter().enumerate().map(|(index, recording)| vec![index != 4; recording.len()]).collect();
        (recordings, parts)
    }

    #[test]
    fn synthetic_recordings_obey_the_identified_operators_within_the_recorded_range() {
        let (recordings, parts) = set(0.0);
        let made = synthetic(&recordings, &parts, 20, 0.003, 1);
        assert_eq!(made.len(), 20);
        let (low, high) =
            recordings.iter().flat_map(|recording| &recording.input).fold((9.0f64, -9.0f64), |(low, high), &v| (low.min(v), high.max(v)));
        for recording in &made {
            assert_eq!(recording.len(), 600);
            let mut memory = [0.0f64; 2];
            for (&input, &output) in recording.input.iter().zip(&recording.output) {
                assert!((low..=high).contains(&input));
                for (memory, threshold) in memory.iter_mut().zip([0.1, 0.35]) {
                    *memory = memory.clamp(input - threshold, input + threshold);
                }
                assert!((memory[0] + 0.5 * memory[1] - output).abs() < 1e-6, "{} {output}", memory[0] + 0.5 * memory[1]);
            }
        }
        // Growing envelopes, which the recorded set lacks.
        let peak = |part: &[f64]| part.iter().fold(f64::NEG_INFINITY, |peak, &value| peak.max(value));
        let growing = made.iter().filter(|recording| peak(&recording.input[..200]) < 0.7 * peak(&recording.input[400..])).count();
        assert!(growing >= 3, "{growing} of 20 grow");
        assert_eq!(made, synthetic(&recordings, &parts, 20, 0.003, 1), "equal seeds give equal recordings");
        assert_ne!(made, synthetic(&recordings, &parts, 20, 0.003, 2));
    }

    #[test]
    fn nothing_is_made_up_where_the_operators_do_not_explain_the_recordings() {
        let (recordings, parts) = set(0.3);
        assert!(synthetic(&recordings, &parts, 20, 0.003, 1).is_empty());
    }
}
