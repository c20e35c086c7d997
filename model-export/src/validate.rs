//! What a model must satisfy before anything runs it: every number finite and bounded, every index inside its table.
//!
//! The bounds are far outside any sensible model and exist so that nothing downstream can overflow, divide by zero or index past an
//! end: with them the front end's signals stay finite in `f32` for any input.

use core::fmt;

use crate::schema::{Channel, FeatureSource, FrontEnd, MAX_DEAD_TIME_SAMPLES};

/// Largest magnitude of a weight, gain, threshold or normalised constant.
pub const MAX_PARAMETER: f32 = 1.0e6;
/// Largest magnitude of an offset or scale of a physical channel; the reciprocal is the smallest scale.
pub const MAX_CHANNEL: f32 = 1.0e12;
/// Smallest positive threshold that a stop feature may divide by.
pub const MIN_STOP_THRESHOLD: f32 = 1.0e-6;

/// A field of a model that cannot be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Invalid {
    /// The field, as in the schema.
    pub field: &'static str,
    /// Position in the field, 0 for a single value.
    pub index: usize,
    /// What the field must be.
    pub must: &'static str,
}

impl fmt::Display for Invalid {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}[{}] must be {}", self.field, self.index, self.must)
    }
}

impl core::error::Error for Invalid {}

pub(crate) fn require(condition: bool, field: &'static str, index: usize, must: &'static str) -> Result<(), Invalid> {
    if condition { Ok(()) } else { Err(Invalid { field, index, must }) }
}

pub(crate) fn bounded(values: &[f32], field: &'static str) -> Result<(), Invalid> {
    for (index, value) in values.iter().enumerate() {
        // A NaN fails the comparison and is refused with the rest.
        require(value.abs() <= MAX_PARAMETER, field, index, "finite and at most a million in magnitude")?;
    }
    Ok(())
}

impl Channel<'_> {
    /// Checks the map and the range.
    ///
    /// # Errors
    /// The first field that is not finite, not positive or not ordered.
    pub fn validate(&self) -> Result<(), Invalid> {
        let in_reach = |value: f32| value.abs() <= MAX_CHANNEL;
        require(in_reach(self.offset), "channel.offset", 0, "finite and at most 1e12 in magnitude")?;
        require(in_reach(self.scale) && self.scale >= 1.0 / MAX_CHANNEL, "channel.scale", 0, "between 1e-12 and 1e12")?;
        require(in_reach(self.minimum), "channel.minimum", 0, "finite and at most 1e12 in magnitude")?;
        require(in_reach(self.maximum), "channel.maximum", 0, "finite and at most 1e12 in magnitude")?;
        require(self.minimum <= self.maximum, "channel.minimum", 0, "at most the maximum")
    }
}

impl FrontEnd {
    /// Checks every coefficient, threshold and feature index.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn validate(&self) -> Result<(), Invalid> {
        let coefficient = |value: f32| value > 0.0 && value <= 1.0;
        // Exact: 32 is representable.
        let longest = f32::from(u16::try_from(MAX_DEAD_TIME_SAMPLES).unwrap_or(u16::MAX));
        let dead_time = self.dead_time_samples;
        require((0.0..=longest).contains(&dead_time), "front_end.dead_time_samples", 0, "between 0 and 32")?;
        require(coefficient(self.lag_coefficient), "front_end.lag_coefficient", 0, "above 0 and at most 1")?;
        bounded(&self.play_thresholds, "front_end.play_thresholds")?;
        bounded(&self.play_weights, "front_end.play_weights")?;
        bounded(&self.creep_weights, "front_end.creep_weights")?;
        bounded(&[self.input_weight], "front_end.input_weight")?;
        bounded(&[self.bias], "front_end.bias")?;
        let plays = self.play_thresholds.len();
        require(self.play_weights.len() == plays, "front_end.play_weights", 0, "as many as there are thresholds")?;
        let creeps = self.creep_coefficients.len();
        require(self.creep_weights.len() == creeps, "front_end.creep_weights", 0, "as many as there are creep coefficients")?;
        let mut least = 0.0;
        for (index, &threshold) in self.play_thresholds.iter().enumerate() {
            require(threshold >= least, "front_end.play_thresholds", index, "non-negative and ascending")?;
            least = threshold;
        }
        for (index, &value) in self.creep_coefficients.iter().enumerate() {
            require(coefficient(value), "front_end.creep_coefficients", index, "above 0 and at most 1")?;
        }
        for (index, feature) in self.features.iter().enumerate() {
            bounded(&[feature.offset, feature.gain], "front_end.features")?;
            match feature.source {
                FeatureSource::Play(operator) => {
                    require(usize::from(operator) < plays, "front_end.features", index, "an existing play operator")?;
                }
                FeatureSource::Stop(operator) => {
                    let threshold = self.play_thresholds.get(usize::from(operator)).copied().unwrap_or(0.0);
                    require(
                        threshold >= MIN_STOP_THRESHOLD,
                        "front_end.features",
                        index,
                        "an existing operator with a positive threshold",
                    )?;
                }
                FeatureSource::Creep(filter) => {
                    require(usize::from(filter) < creeps, "front_end.features", index, "an existing creep filter")?;
                }
                FeatureSource::Input
                | FeatureSource::InputDifference
                | FeatureSource::Path
                | FeatureSource::PathDifference
                | FeatureSource::Readout => {}
            }
        }
        Ok(())
    }
}
