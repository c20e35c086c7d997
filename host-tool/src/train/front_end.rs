//! The front end of a new model: channels scaled to the training data, features scaled to what the network takes well.

use firmware::estimator::{FrontEnd, FrontEndState};
use model_export::schema::{self, Feature, FeatureSource};
use model_export::validate::Invalid;

use crate::network::Channel;
use crate::recording::{Recording, Signal};

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

/// Input and output channel for the training samples.
#[must_use]
pub fn channels(recordings: &[Recording], parts: &[Vec<bool>]) -> (Channel, Channel) {
    let input = channel(&recordings[0].input_signal, training(recordings, parts, |recording| &recording.input), true);
    let output = channel(&recordings[0].output_signal, training(recordings, parts, |recording| &recording.output), false);
    (input, output)
}

/// A front end that only normalises.
#[must_use]
pub fn plain(difference: bool) -> schema::FrontEnd {
    let mut front_end = schema::FrontEnd { lag_coefficient: 1.0, ..schema::FrontEnd::default() };
    let sources = [FeatureSource::Input, FeatureSource::InputDifference];
    let count = if difference { 2 } else { 1 };
    front_end.features = sources.into_iter().take(count).map(|source| Feature { source, offset: 0.0, gain: 1.0 }).collect();
    front_end
}

/// Sets every feature's offset and gain from the training samples: the range to -1 to 1, differences by their spread.
///
/// # Errors
/// When the front end is out of its domain.
pub fn scale_features(
    front_end: &mut schema::FrontEnd,
    input: &Channel,
    recordings: &[Recording],
    parts: &[Vec<bool>],
) -> Result<(), Invalid> {
    for feature in &mut front_end.features {
        (feature.offset, feature.gain) = (0.0, 1.0);
    }
    let built = FrontEnd::new(front_end, &input.as_wire())?;
    let width = built.features();
    let mut ranges = vec![(f64::INFINITY, f64::NEG_INFINITY); width];
    let mut squares = vec![0.0; width];
    let mut count = 0.0;
    let mut features = vec![0.0; width];
    for (recording, part) in recordings.iter().zip(parts) {
        for segment in recording.segments() {
            let mut state = FrontEndState::default();
            for index in segment {
                #[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
                built.step(&mut state, recording.input[index] as f32, &mut features);
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
