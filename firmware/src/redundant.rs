//! A choice that is kept twice, so that a flipped bit in memory is noticed instead of being another choice.
//!
//! It is kept as its number and the complement of that. Whoever reads it gets nothing when the two do not belong together, and decides what is
//! safe then.

use core::marker::PhantomData;

/// Something that is one of a few.
pub trait Choice: Copy + PartialEq + 'static {
    /// All of them; at most 256.
    const ALL: &'static [Self];
}

/// A choice, kept twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Redundant<T> {
    number: u8,
    inverted: u8,
    choice: PhantomData<T>,
}

impl<T: Choice> Redundant<T> {
    /// Keeps a choice.
    pub fn new(choice: T) -> Self {
        let number = T::ALL.iter().zip(0..=u8::MAX).find(|(candidate, _)| **candidate == choice).map_or(u8::MAX, |(_, number)| number);
        Self { number, inverted: !number, choice: PhantomData }
    }

    /// The choice; `None` if it was damaged.
    pub fn get(&self) -> Option<T> {
        if self.inverted == !self.number { T::ALL.get(usize::from(self.number)).copied() } else { None }
    }

    /// The copies with one of their sixteen bits flipped.
    #[cfg(test)]
    pub fn flipped(self, bit: u8) -> Self {
        let [number, inverted] = (u16::from_le_bytes([self.number, self.inverted]) ^ (1 << bit)).to_le_bytes();
        Self { number, inverted, ..self }
    }
}

impl<T: Choice + Default> Default for Redundant<T> {
    fn default() -> Self {
        Self::new(T::default())
    }
}
