//! What a model's layers meet when it runs on data: ranges, second moments, and the envelope of the input.

use firmware::domain::NestedReversals;
use model_export::compensation::Domain;
use model_export::quantise::LayerCalibration;
use model_export::schema::Envelope;

use super::reference::{LayerSignals, Reference};
use super::work::Work;
use crate::network::TrainedModel;
use recording::Recording;

/// What calibration learns.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// One entry per layer.
    pub layers: Vec<LayerCalibration>,
    /// Range and rate of the input.
    pub envelope: Envelope,
    /// How deep its reversals were nested.
    pub domain: Domain,
}

/// Second moments are taken from every n-th step: they change little, and cost as much as the step itself.
const MOMENT_STRIDE: usize = 5;

impl Calibration {
    /// Runs the model in `f64` over the recordings, from rest at the start of each and after each gap.
    #[must_use]
    pub fn of(model: &TrainedModel, data: &[Recording]) -> Self {
        Self::worked_out(model, data, &Work::of(model, 0, &|_, _| {}))
    }

    pub(super) fn worked_out(model: &TrainedModel, data: &[Recording], work: &Work<'_>) -> Self {
        let mut gather = Gather { layers: Vec::new(), counted: 0, steps: 0 };
        for recording in data {
            let inputs = recording.inputs();
            for segment in recording.segments() {
                let mut reference = Reference::new(model);
                for sample in segment {
                    let raw: Vec<f64> = inputs.iter().map(|values| values[sample]).collect();
                    reference.step(&raw, &mut |layers| gather.step(layers));
                    work.run();
                }
            }
        }
        Self { layers: gather.finish(), envelope: envelope(model, data), domain: domain(model, data) }
    }
}

struct Gather {
    layers: Vec<LayerCalibration>,
    counted: usize,
    steps: usize,
}

impl Gather {
    fn step(&mut self, signals: &[LayerSignals]) {
        if self.layers.is_empty() {
            let empty = |layer: &LayerSignals| LayerCalibration { hidden_max: 0.0, moments: Some(vec![0.0; layer.seen.len().pow(2)]) };
            self.layers = signals.iter().map(empty).collect();
        }
        let take_moments = self.steps.is_multiple_of(MOMENT_STRIDE);
        self.steps += 1;
        self.counted += usize::from(take_moments);
        for (layer, signals) in self.layers.iter_mut().zip(signals) {
            layer.hidden_max = signals.hidden.iter().fold(layer.hidden_max, |largest, h| largest.max(h.abs()));
            if let (true, Some(moments)) = (take_moments, &mut layer.moments) {
                for (row, left) in moments.chunks_mut(signals.seen.len()).zip(&signals.seen) {
                    row.iter_mut().zip(&signals.seen).for_each(|(moment, right)| *moment += left * right);
                }
            }
        }
    }

    fn finish(mut self) -> Vec<LayerCalibration> {
        let samples = self.counted.max(1) as f64;
        for moments in self.layers.iter_mut().filter_map(|layer| layer.moments.as_mut()) {
            moments.iter_mut().for_each(|moment| *moment /= samples);
        }
        self.layers
    }
}

fn envelope(model: &TrainedModel, data: &[Recording]) -> Envelope {
    let mut rate = 0.0f64;
    for recording in data {
        for segment in recording.segments() {
            let steps = recording.input[segment].windows(2).map(|pair| (pair[1] - pair[0]).abs());
            rate = steps.fold(rate, f64::max);
        }
    }
    Envelope { minimum: model.input.minimum, maximum: model.input.maximum, maximum_rate: (rate / model.sample_period_s) as f32 }
}

/// A turn counts as a reversal from this share of the input's range on: above the noise, below any loop that matters.
const REVERSAL_SHARE: f32 = 0.05;

fn domain(model: &TrainedModel, data: &[Recording]) -> Domain {
    let reversal_depth = (REVERSAL_SHARE * (model.input.maximum - model.input.minimum)).max(f32::MIN_POSITIVE);
    let mut nested_reversals = 0;
    for recording in data {
        for segment in recording.segments() {
            let mut reversals = NestedReversals::default();
            let counts = recording.input[segment].iter().map(|input| reversals.step(*input as f32, reversal_depth));
            nested_reversals = counts.fold(nested_reversals, u8::max);
        }
    }
    Domain { nested_reversals, reversal_depth }
}

/// Recordings of at most about `samples` samples in all: everything, or recordings evenly spaced over the list, the last cut short.
pub fn choose(data: &[Recording], samples: usize) -> Vec<Recording> {
    let total: usize = data.iter().map(Recording::len).sum();
    let stride = total.div_ceil(samples.max(1)).max(1);
    let mut left = samples;
    let mut chosen = Vec::new();
    for recording in data.iter().step_by(stride) {
        if left == 0 {
            break;
        }
        let mut part = recording.clone();
        let length = part.len().min(left);
        part.time_s.truncate(length);
        part.input.truncate(length);
        part.output.truncate(length);
        part.more_inputs.iter_mut().for_each(|channel| channel.values.truncate(length));
        part.gaps.retain(|start| *start < length);
        left -= length;
        chosen.push(part);
    }
    chosen
}
