//! The front end of a new model: channels scaled to the training data, features scaled to what the network takes well.

use firmware::estimator::FrontEndState;
use model_export::schema::{self, Feature, FeatureSource};
use model_export::validate::Invalid;

use crate::network::{Channel, built, narrowed};
use recording::{Recording, Signal};

/// Standard deviations of a difference that a feature of 1 stands for. Differences have rare large values (steps) and a working range
/// that must not vanish beside them; what exceeds 2 is limited.
const DIFFERENCE_SPAN: f64 = 2.0;

/// The training samples of one signal.
fn training<'a>(
    recordings: &'a [Recording],
    parts: &'a [Vec<bool>],
    signal: impl Fn(&'a Recording) -> &'a [f64] + 'a,
) -> impl Iterator<Item = f64> + 'a {
    recordings
        .iter()
        .zip(parts)
        .flat_map(move |(recording, part)| signal(recording).iter().zip(part).filter(|(_, part)| **part).map(|(value, _)| *value))
}

fn channel(signal: &Signal, values: impl Iterator<Item = f64>, keep_zero: bool) -> Channel {
    let (minimum, maximum) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    let range = maximum - minimum;
    // Play operators start from zero of their input (paper eq. 2), so zero stays zero unless the data lie far from it.
    let offset = match keep_zero {
        true if minimum.abs().min(maximum.abs()) <= range || minimum * maximum <= 0.0 => 0.0,
        true => minimum,
        false => 0.5 * (minimum + maximum),
    };
    let span = (maximum - offset).abs().max((minimum - offset).abs());
    #[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
    let narrow = |value: f64| value as f32;
    Channel {
        quantity: signal.quantity.clone(),
        unit: signal.unit.clone(),
        offset: narrow(offset),
        scale: if span > 0.0 { narrow(span) } else { 1.0 },
        minimum: narrow(minimum),
        maximum: narrow(maximum),
    }
}

/// What goes into a model and what comes out.
#[derive(Clone, Debug)]
pub struct Channels {
    /// The first input.
    pub input: Channel,
    /// The other inputs.
    pub more_inputs: Vec<Channel>,
    /// The output.
    pub output: Channel,
}

impl Channels {
    /// Number of inputs.
    #[must_use]
    pub fn inputs(&self) -> usize {
        1 + self.more_inputs.len()
    }

    /// An input, counted from 0.
    #[must_use]
    pub fn input(&self, number: usize) -> &Channel {
        number.checked_sub(1).map_or(&self.input, |other| &self.more_inputs[other])
    }
}

/// The channels for the training samples.
#[must_use]
pub fn channels(recordings: &[Recording], parts: &[Vec<bool>]) -> Channels {
    let first = &recordings[0];
    let more_inputs = (0..first.more_inputs.len()).map(|index| {
        let values = training(recordings, parts, move |recording| &recording.more_inputs[index].values);
        channel(&first.more_inputs[index].signal, values, true)
    });
    Channels {
        input: channel(&first.input_signal, training(recordings, parts, |recording| &recording.input), true),
        more_inputs: more_inputs.collect(),
        output: channel(&first.output_signal, training(recordings, parts, |recording| &recording.output), false),
    }
}

/// A front end that only normalises `inputs` inputs.
#[must_use]
pub fn plain(difference: bool, inputs: usize) -> schema::FrontEnd {
    let sources = [FeatureSource::Input, FeatureSource::InputDifference];
    let count = if difference { 2 } else { 1 };
    let signals = (0..inputs).flat_map(|input| sources.into_iter().take(count).map(move |source| (source, input)));
    let mut front_end = schema::FrontEnd { lag_coefficient: 1.0, ..schema::FrontEnd::default() };
    see(&mut front_end, signals);
    front_end.more_input_weights.extend((1..inputs).map(|_| 0.0));
    front_end
}

/// Makes signals the features of a front end, each with the input that it is one of; offset and gain are set from the data afterwards.
pub(super) fn see(front_end: &mut schema::FrontEnd, signals: impl IntoIterator<Item = (FeatureSource, usize)>) {
    front_end.features.clear();
    front_end.feature_inputs.clear();
    for (source, input) in signals {
        // Whoever names them keeps to the number that fits.
        let _ = front_end.features.push(Feature { source, offset: 0.0, gain: 1.0 });
        let _ = front_end.feature_inputs.push(u8::try_from(input).unwrap_or(u8::MAX));
    }
    // Where nobody sees another input the list says nothing.
    if front_end.feature_inputs.iter().all(|&input| input == 0) {
        front_end.feature_inputs.clear();
    }
}

/// Sets every feature's offset and gain from the training samples: the range to -1 to 1, differences by their spread.
///
/// # Errors
/// When the front end is out of its domain.
pub fn scale_features(
    front_end: &mut schema::FrontEnd,
    channels: &Channels,
    recordings: &[Recording],
    parts: &[Vec<bool>],
) -> Result<(), Invalid> {
    for feature in &mut front_end.features {
        (feature.offset, feature.gain) = (0.0, 1.0);
    }
    let built = built(front_end, &channels.input, &channels.more_inputs)?;
    let width = built.features();
    let mut ranges = vec![(f64::INFINITY, f64::NEG_INFINITY); width];
    let mut squares = vec![0.0; width];
    let mut count = 0.0;
    let mut features = vec![0.0; width];
    for (recording, part) in recordings.iter().zip(parts) {
        let inputs = recording.inputs();
        for segment in recording.segments() {
            let mut state = FrontEndState::default();
            for index in segment {
                built.step(&mut state, &narrowed(&inputs, index), &mut features);
                if part[index] {
                    count += 1.0;
                    for (feature, value) in features.iter().enumerate() {
                        let value = f64::from(*value);
                        ranges[feature] = (ranges[feature].0.min(value), ranges[feature].1.max(value));
                        squares[feature] += value * value;
                    }
                }
            }
        }
    }
    for (index, feature) in front_end.features.iter_mut().enumerate() {
        let (low, high) = ranges[index];
        let (offset, span) = match feature.source {
            FeatureSource::InputDifference | FeatureSource::PathDifference => {
                (0.0, DIFFERENCE_SPAN * (squares[index] / f64::max(count, 1.0)).sqrt())
            }
            _ => (0.5 * (low + high), 0.5 * (high - low)),
        };
        // A signal that never moves in training carries nothing; a gain of one keeps it harmless.
        let gain = if span > 1e-9 { 1.0 / span } else { 1.0 };
        #[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
        {
            (feature.offset, feature.gain) = (offset as f32, gain as f32);
        }
    }
    Ok(())
}
