//! Where a reader stands in a buffer that a transfer controller fills round and round.
//!
//! The controller counts down what is left of the round. A reader that comes later than a whole round finds what the last one wrote, in order and
//! without its beginning; checksums find the gap.

/// The reader's place in a buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CircularReader {
    next: usize,
}

impl CircularReader {
    /// The place of the next byte, if the controller has written it: `length` bytes a round, of which `remaining` are left.
    pub fn take(&mut self, length: usize, remaining: usize) -> Option<usize> {
        // At the end of a round the count is the whole length again.
        let written = length.saturating_sub(remaining);
        let written = if written < length { written } else { 0 };
        if self.next == written {
            return None;
        }
        let place = self.next;
        self.next = if place + 1 < length { place + 1 } else { 0 };
        Some(place)
    }

    /// The controller begins anew, at the first byte.
    pub fn restart(&mut self) {
        self.next = 0;
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::*;

    const LENGTH: usize = 8;

    #[test]
    fn every_byte_is_taken_once_and_in_order_however_the_rounds_fall() {
        for step in 1..LENGTH {
            let mut buffer = [0; LENGTH];
            let mut reader = CircularReader::default();
            let (mut sent, mut taken) = (0, Vec::new());
            for _ in 0..100 {
                for _ in 0..step {
                    buffer[sent % LENGTH] = sent;
                    sent += 1;
                }
                while let Some(place) = reader.take(LENGTH, LENGTH - sent % LENGTH) {
                    taken.push(buffer[place]);
                }
            }
            assert_eq!(taken, (0..100 * step).collect::<Vec<_>>(), "{step}");
        }
    }

    #[test]
    fn a_count_of_zero_is_the_end_of_a_round() {
        let mut reader = CircularReader { next: LENGTH - 1 };
        assert_eq!(reader.take(LENGTH, 0), Some(LENGTH - 1));
        assert_eq!(reader.take(LENGTH, 0), None);
        assert_eq!(reader.take(LENGTH, LENGTH), None);
        assert_eq!(reader.take(LENGTH, LENGTH - 1), Some(0));
        reader.restart();
        assert_eq!(reader.take(LENGTH, LENGTH), None);
    }
}
