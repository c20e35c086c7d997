//! A list of at most `N` numbers, stored in place.

use crate::{Error, Real};

/// At most `N` numbers; what lies beyond the length is zero, so that derived equality is equality of the lists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct List<T, const N: usize> {
    items: [T; N],
    length: usize,
}

impl<T: Real, const N: usize> List<T, N> {
    pub(crate) fn from_slice(values: &[T]) -> Result<Self, Error> {
        let mut list = Self::zeros(values.len())?;
        list.as_mut_slice().copy_from_slice(values);
        Ok(list)
    }

    pub(crate) fn zeros(length: usize) -> Result<Self, Error> {
        if length > N { Err(Error::TooLong { capacity: N, found: length }) } else { Ok(Self { items: [T::ZERO; N], length }) }
    }

    /// Zeros, as many as `other` has elements.
    pub(crate) fn zeros_like<U>(other: &List<U, N>) -> Self {
        Self { items: [T::ZERO; N], length: other.length }
    }

    // The length never exceeds N; `get` keeps the panicking branch out of the firmware.
    pub(crate) fn as_slice(&self) -> &[T] {
        self.items.get(..self.length).unwrap_or(&self.items)
    }

    pub(crate) fn as_mut_slice(&mut self) -> &mut [T] {
        self.items.get_mut(..self.length).unwrap_or_default()
    }
}
