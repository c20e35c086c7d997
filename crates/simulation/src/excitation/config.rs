//! An excitation file, and its samples.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::error::ExcitationError;
use super::signal::{MAX_SAMPLES, Signal};

/// Streams of the random generator, one for each purpose.
const NOISE_STREAM: u64 = 1;
const FIRST_SEGMENT_STREAM: u64 = 16;

/// One excitation file.
///
/// ```toml
/// sample_period_s = 0.02
/// noise_bar = 0.1          # uniform, 0 to this, added to every sample; rand(0, 0.1) of eq. (1)
/// seed = 7                 # of the noise and of random signals
///
/// [[segments]]
/// duration_s = 20.0
/// signal = { kind = "descending-sine", amplitude_bar = 1.0, frequency_hz = 0.3, decay_per_s = 0.12 }
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExcitationConfig {
    /// Sample period in s.
    #[serde(default = "default_sample_period_s")]
    pub sample_period_s: f64,
    /// Upper end of the uniform noise added to every sample, in bar; 0 adds none.
    #[serde(default)]
    pub noise_bar: f64,
    /// Seed of the noise and of random signals.
    #[serde(default)]
    pub seed: u64,
    /// What is played, in order.
    pub segments: Vec<Segment>,
}

/// A signal and how long it plays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Segment {
    /// How long, in s.
    pub duration_s: f64,
    /// What.
    pub signal: Signal,
}

fn default_sample_period_s() -> f64 {
    0.02
}

/// A sampled excitation.
#[derive(Clone, Debug, PartialEq)]
pub struct Samples {
    /// Times in s, from 0.
    pub time_s: Vec<f64>,
    /// Commanded pressure in bar.
    pub pressure_bar: Vec<f64>,
}

impl ExcitationConfig {
    /// Samples the excitation without checking the limits of a rig; see [`super::Limits::check`].
    ///
    /// # Errors
    /// When a value makes no sense (not finite, negative duration, an empty list), naming the segment.
    pub fn sample(&self) -> Result<Samples, ExcitationError> {
        let value = |place: &str, problem: String| Err(ExcitationError::Value { place: place.to_owned(), problem });
        if !(self.sample_period_s.is_finite() && self.sample_period_s > 0.0) {
            return value("sample_period_s", format!("is {}, a positive time is wanted", self.sample_period_s));
        }
        if !(self.noise_bar.is_finite() && self.noise_bar >= 0.0) {
            return value("noise_bar", format!("is {}, zero or a positive pressure is wanted", self.noise_bar));
        }
        if self.segments.is_empty() {
            return value("segments", "are empty; add a [[segments]] table".to_owned());
        }
        let mut pressure_bar = Vec::new();
        for (index, segment) in self.segments.iter().enumerate() {
            let place = format!("segment {} ({})", index + 1, segment.signal.kind());
            let samples = segment.duration_s / self.sample_period_s;
            if !(segment.duration_s.is_finite() && samples >= 1.0) {
                return value(&place, format!("duration_s is {}, at least one sample period is wanted", segment.duration_s));
            }
            if pressure_bar.len() as f64 + samples > MAX_SAMPLES as f64 {
                return value(&place, format!("the excitation would have more than {MAX_SAMPLES} samples; shorten it"));
            }
            let mut random = ChaCha8Rng::seed_from_u64(self.seed);
            random.set_stream(FIRST_SEGMENT_STREAM + index as u64);
            let count = samples.round() as usize;
            let times: Vec<f64> = (0..count).map(|sample| sample_time_s(sample, self.sample_period_s)).collect();
            let played = segment.signal.play(&times, segment.duration_s, &mut random);
            pressure_bar.extend(played.map_err(|problem| ExcitationError::Value { place, problem })?);
        }
        if self.noise_bar > 0.0 {
            let mut random = ChaCha8Rng::seed_from_u64(self.seed);
            random.set_stream(NOISE_STREAM);
            pressure_bar.iter_mut().for_each(|pressure| *pressure += self.noise_bar * random.random::<f64>());
        }
        if pressure_bar.len() < 2 {
            return value("segments", "give fewer than two samples; lengthen duration_s".to_owned());
        }
        let time_s = (0..pressure_bar.len()).map(|sample| sample_time_s(sample, self.sample_period_s)).collect();
        Ok(Samples { time_s, pressure_bar })
    }
}

/// Time of a sample in s, without the rounding that makes 29 * 0.02 print as 0.5800000000000001.
fn sample_time_s(sample: usize, sample_period_s: f64) -> f64 {
    let time_s = sample as f64 * sample_period_s;
    let rounded = (time_s * 1e9).round() / 1e9;
    // Only the representation error goes: a period that is no whole number of nanoseconds stays what it is.
    if (rounded - time_s).abs() < 1e-14 * time_s.max(1.0) { rounded } else { time_s }
}
