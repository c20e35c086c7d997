//! What a constructor or a batch call refuses.

use core::fmt;

/// Why parameters, a start state or a batch were refused. Running an operator one sample at a time cannot fail.
///
/// ```
/// use hysteresis::{Error, Play};
///
/// let refused = Play::new(-0.1).expect_err("a threshold is not negative");
/// assert_eq!(refused, Error::OutOfDomain { parameter: "threshold", domain: "zero or more" });
/// assert_eq!(refused.to_string(), "threshold must be zero or more");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Error {
    /// The named parameter is NaN or infinite.
    NotFinite {
        /// The parameter.
        parameter: &'static str,
    },
    /// The named parameter is outside its domain.
    OutOfDomain {
        /// The parameter.
        parameter: &'static str,
        /// What its domain is.
        domain: &'static str,
    },
    /// The named list does not increase strictly at this index.
    NotAscending {
        /// The list.
        parameter: &'static str,
        /// First index that is not larger than the one before.
        index: usize,
    },
    /// Two slices that belong together differ in length.
    LengthMismatch {
        /// Length needed.
        expected: usize,
        /// Length given.
        found: usize,
    },
    /// More elements than the type's capacity.
    TooLong {
        /// Elements the type can hold.
        capacity: usize,
        /// Elements given.
        found: usize,
    },
    /// The operator has no inverse of its own kind; the reason names the condition.
    NotInvertible {
        /// The condition that fails.
        condition: &'static str,
        /// First element at which it fails.
        index: usize,
    },
    /// No input history leads to this state.
    UnreachableState {
        /// First operator that cannot stand there beside the one before it.
        index: usize,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite { parameter } => write!(formatter, "{parameter} must be finite"),
            Self::OutOfDomain { parameter, domain } => write!(formatter, "{parameter} must be {domain}"),
            Self::NotAscending { parameter, index } => write!(formatter, "{parameter} must increase strictly, but do not at index {index}"),
            Self::LengthMismatch { expected, found } => {
                write!(formatter, "slices must be of the same length: needs {expected}, got {found}")
            }
            Self::TooLong { capacity, found } => write!(formatter, "{found} elements given, but the type holds {capacity}"),
            Self::NotInvertible { condition, index } => write!(formatter, "not invertible: {condition}, which fails at index {index}"),
            Self::UnreachableState { index } => {
                write!(formatter, "no input leads to this state: operator {index} is too far from the one before it")
            }
        }
    }
}

impl core::error::Error for Error {}

/// Refuses a value that is NaN or infinite.
pub(crate) fn finite<T: crate::Real>(parameter: &'static str, value: T) -> Result<T, Error> {
    if value.is_finite() { Ok(value) } else { Err(Error::NotFinite { parameter }) }
}

/// Refuses a value that is not finite or negative.
pub(crate) fn not_negative<T: crate::Real>(parameter: &'static str, value: T) -> Result<T, Error> {
    if finite(parameter, value)? >= T::ZERO { Ok(value) } else { Err(Error::OutOfDomain { parameter, domain: "zero or more" }) }
}

/// Refuses a value that is not finite or not above zero.
pub(crate) fn positive<T: crate::Real>(parameter: &'static str, value: T) -> Result<T, Error> {
    if finite(parameter, value)? > T::ZERO { Ok(value) } else { Err(Error::OutOfDomain { parameter, domain: "above zero" }) }
}

/// Refuses slices of different lengths.
pub(crate) fn same_length(expected: usize, found: usize) -> Result<(), Error> {
    if expected == found { Ok(()) } else { Err(Error::LengthMismatch { expected, found }) }
}

/// Refuses a list that is not finite or does not increase strictly.
pub(crate) fn ascending<T: crate::Real>(parameter: &'static str, values: &[T]) -> Result<(), Error> {
    for value in values {
        finite(parameter, *value)?;
    }
    match values.windows(2).position(|pair| matches!(pair, [before, after] if before >= after)) {
        None => Ok(()),
        Some(position) => Err(Error::NotAscending { parameter, index: position + 1 }),
    }
}
