//! The error of a network that runs freely over the validation samples, many recordings at a time.

use super::tracks::{Track, beyond, window_features};
use crate::network::{Architecture, Mode, Sequence};

/// Free-running validation in lanes.
pub(super) struct Validation {
    sequence: Sequence,
    /// Tracks that have validation samples.
    tracks: Vec<usize>,
    window: Option<usize>,
}

/// Lanes of the validation sequence, and its steps at a time.
const VALIDATION_LANES: usize = 16;
const VALIDATION_STEPS: usize = 100;
/// In window mode every sample costs a whole window; while training, each such step of samples validates.
const WINDOW_VALIDATION_STRIDE: usize = 7;

impl Validation {
    pub(super) fn new(architecture: &Architecture, tracks: &[Track], mode: Mode) -> Self {
        let window = match mode {
            Mode::Streaming => None,
            Mode::Window { length } => Some(length),
        };
        let steps = window.unwrap_or(VALIDATION_STEPS);
        let validating = (0..tracks.len()).filter(|&index| tracks[index].training.contains(&false)).collect();
        Self { sequence: Sequence::new(architecture, VALIDATION_LANES, steps), tracks: validating, window }
    }

    /// Mean squared error of `linear + target_scale * network` on the validation samples, in normalised output.
    pub(super) fn mean_square(&mut self, parameters: &[f32], tracks: &[Track], target_scale: f32) -> f64 {
        match self.window {
            None => self.streaming(parameters, tracks, target_scale),
            Some(length) => self.windows(parameters, tracks, target_scale, length),
        }
    }

    /// Largest magnitude of each layer's hidden state over all samples, free running.
    pub(super) fn largest_hidden(&mut self, parameters: &[f32], tracks: &[Track]) -> Vec<f64> {
        let all: Vec<usize> = (0..tracks.len()).collect();
        let mut largest = vec![0.0; self.sequence.architecture().units.len()];
        self.walk(&all, parameters, tracks, |sequence, _, _| sequence.raise_to_largest_hidden(&mut largest));
        largest
    }

    fn streaming(&mut self, parameters: &[f32], tracks: &[Track], target_scale: f32) -> f64 {
        let (mut sum, mut count) = (0.0, 0u64);
        let validating = self.tracks.clone();
        self.walk(&validating, parameters, tracks, |sequence, group, start| {
            for (lane, &index) in group.iter().enumerate() {
                let track = &tracks[index];
                for sample in (start..track.len().min(start + VALIDATION_STEPS)).filter(|&sample| !track.training[sample]) {
                    let output = sequence.outputs()[(sample - start) * VALIDATION_LANES + lane];
                    let error = f64::from(track.output[sample] - track.front_end[sample] - target_scale * output);
                    let error = beyond(error, f64::from(track.slack[sample]));
                    sum += error * error;
                    count += 1;
                }
            }
        });
        sum / count.max(1) as f64
    }

    /// Runs the network freely over whole tracks, side by side; `see` gets each chunk: the sequence, the tracks in its lanes, and the
    /// sample it starts at.
    fn walk(&mut self, chosen: &[usize], parameters: &[f32], tracks: &[Track], mut see: impl FnMut(&Sequence, &[usize], usize)) {
        for group in chosen.chunks(VALIDATION_LANES) {
            (0..VALIDATION_LANES).for_each(|lane| self.sequence.reset_lane(lane));
            let longest = group.iter().map(|&index| tracks[index].len()).max().unwrap_or(0);
            for start in (0..longest).step_by(VALIDATION_STEPS) {
                let features = self.sequence.features_mut(VALIDATION_STEPS);
                let width = features.len() / (VALIDATION_STEPS * VALIDATION_LANES);
                features.fill(0.0);
                for (lane, &index) in group.iter().enumerate() {
                    let track = &tracks[index];
                    for sample in start..track.len().min(start + VALIDATION_STEPS) {
                        let row = (sample - start) * VALIDATION_LANES + lane;
                        features[row * width..][..width].copy_from_slice(&track.features[sample * width..][..width]);
                    }
                }
                self.sequence.forward(parameters);
                see(&self.sequence, group, start);
                self.sequence.carry();
            }
        }
    }

    fn windows(&mut self, parameters: &[f32], tracks: &[Track], target_scale: f32, length: usize) -> f64 {
        let mut ends = Vec::new();
        for &index in &self.tracks {
            let track = &tracks[index];
            ends.extend((0..track.len()).step_by(WINDOW_VALIDATION_STRIDE).filter(|&end| !track.training[end]).map(|end| (index, end)));
        }
        let mut sum = 0.0;
        for group in ends.chunks(VALIDATION_LANES) {
            (0..VALIDATION_LANES).for_each(|lane| self.sequence.reset_lane(lane));
            let features = self.sequence.features_mut(length);
            let width = features.len() / (length * VALIDATION_LANES);
            features.fill(0.0);
            for (lane, &(index, end)) in group.iter().enumerate() {
                for step in 0..length {
                    let source = window_features(&tracks[index], width, end, length, step);
                    features[(step * VALIDATION_LANES + lane) * width..][..width].copy_from_slice(source);
                }
            }
            let outputs = self.sequence.forward(parameters);
            for (lane, &(index, end)) in group.iter().enumerate() {
                let track = &tracks[index];
                let output = outputs[(length - 1) * VALIDATION_LANES + lane];
                let error = f64::from(track.output[end] - track.front_end[end] - target_scale * output);
                let error = beyond(error, f64::from(track.slack[end]));
                sum += error * error;
            }
        }
        sum / ends.len().max(1) as f64
    }
}
