//! Inputs that leave the range a model was made from: nothing is known of it there.

use serde::Serialize;

use crate::identify::ChannelRange;
use recording::Recording;

/// Beyond the range by less than this share of it is no news.
const NEWS: f64 = 0.01;

/// One input of one recording that leaves the range.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Beyond {
    /// File name of the recording.
    pub recording: String,
    /// The input's column.
    pub input: String,
    /// How much of it, and how far.
    #[serde(flatten)]
    pub outside: Outside,
}

/// Values that leave a range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Outside {
    /// Share of samples beyond the range.
    pub share: f64,
    /// Farthest beyond it, in the values' unit.
    pub by: f64,
    /// The same over the width of the range.
    pub of_range: f64,
}

/// How far values leave the range from `low` to `high`; nothing when they hardly do, or it is no range.
#[must_use]
pub fn outside((low, high): (f64, f64), values: &[f64]) -> Option<Outside> {
    let width = high - low;
    let distance = |value: &f64| (value - high).max(low - value);
    let by = values.iter().map(distance).fold(0.0, f64::max);
    let count = values.iter().filter(|&value| distance(value) > 0.0).count();
    (width > 0.0 && by > NEWS * width).then(|| Outside { share: count as f64 / values.len().max(1) as f64, by, of_range: by / width })
}

/// The inputs of some recordings that leave a model's ranges, one range an input.
#[must_use]
pub fn beyond(ranges: &[ChannelRange], recordings: &[Recording]) -> Vec<Beyond> {
    let mut found = Vec::new();
    for recording in recordings {
        for (range, values) in ranges.iter().zip(recording.inputs()) {
            let Some(outside) = outside((range.minimum, range.maximum), values) else { continue };
            found.push(Beyond {
                recording: recording.path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
                input: format!("{}_{}", range.quantity, range.unit),
                outside,
            });
        }
    }
    found
}

impl Beyond {
    /// A warning, in one sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        format!(
            "{}: `{}` lies beyond the range that the model was made from in {:.1} % of the samples, by up to {:.1} % of that range; nothing \
             is known there",
            self.recording,
            self.input,
            100.0 * self.outside.share,
            100.0 * self.outside.of_range
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::Signal;

    #[test]
    fn an_input_beyond_the_range_is_told_with_share_and_distance() {
        let range = ChannelRange { quantity: "pressure".into(), unit: "bar".into(), minimum: 0.0, maximum: 2.0 };
        let recording = |top: f64| {
            let time_s: Vec<f64> = (0..100).map(|index| 0.01 * f64::from(index)).collect();
            let input: Vec<f64> = (0..100).map(|index| top * f64::from(index) / 99.0).collect();
            let output = vec![0.0; 100];
            Recording::new("one.csv".as_ref(), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output)
                .expect("a recording")
        };
        assert_eq!(beyond(std::slice::from_ref(&range), &[recording(2.0)]), []);
        let found = beyond(&[range], &[recording(2.0), recording(3.0)]);
        let [Beyond { outside: one, .. }] = &found[..] else { panic!("{found:?}") };
        assert!((one.by - 1.0).abs() < 1e-12 && (one.share - 1.0 / 3.0).abs() < 0.01 && (one.of_range - 0.5).abs() < 1e-12, "{one:?}");
    }
}
