//! How a field of a model is refused, and the bound that all parameters share.

use core::fmt;

/// Largest magnitude of a weight, gain, threshold or normalised constant.
pub const MAX_PARAMETER: f32 = 1.0e6;

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
