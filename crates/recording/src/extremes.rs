//! What one pass over many values shows: their extremes, how often these occur, how often a value changes. A value is compared with its
//! lane's extreme only, so that the processor takes several at a time.

const LANES: usize = 8;
/// Values that stay in the nearest cache while they are looked at twice.
const BLOCK: usize = 2048;

/// What one channel is like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extremes {
    pub(super) low: f64,
    pub(super) high: f64,
    /// Samples at the lowest and at the highest value.
    pub(super) at_low: usize,
    pub(super) at_high: usize,
    /// Samples that differ from the one before.
    pub(super) changes: usize,
}

impl Extremes {
    pub(super) fn of(values: &[f64]) -> Self {
        let mut found = Self { low: f64::INFINITY, high: f64::NEG_INFINITY, at_low: 0, at_high: 0, changes: 0 };
        for (index, block) in values.chunks(BLOCK).enumerate() {
            let (low, high) = bounds(block);
            if low < found.low {
                (found.low, found.at_low) = (low, 0);
            }
            if high > found.high {
                (found.high, found.at_high) = (high, 0);
            }
            let count = |extreme: f64| block.iter().map(|value| usize::from(*value == extreme)).sum::<usize>();
            if low == found.low {
                found.at_low += count(low);
            }
            if high == found.high {
                found.at_high += count(high);
            }
            let before = &values[(index * BLOCK).saturating_sub(1)..];
            let after = &values[(index * BLOCK).max(1)..];
            let pairs = before.iter().zip(after).take(if index == 0 { BLOCK - 1 } else { BLOCK });
            found.changes += pairs.map(|(one, other)| usize::from(one != other)).sum::<usize>();
        }
        found
    }

    /// The largest value without its sign.
    pub(super) fn most(&self) -> f64 {
        self.high.max(-self.low).max(0.0)
    }

    /// Largest less smallest value.
    pub(super) fn range(&self) -> f64 {
        if self.low <= self.high { self.high - self.low } else { 0.0 }
    }
}

/// The extremes of several values at a time.
struct Lanes {
    low: [f64; LANES],
    high: [f64; LANES],
}

impl Lanes {
    const NONE: Self = Self { low: [f64::INFINITY; LANES], high: [f64::NEG_INFINITY; LANES] };

    #[inline]
    fn take(&mut self, values: [f64; LANES]) {
        for ((low, high), value) in self.low.iter_mut().zip(&mut self.high).zip(values) {
            *low = if value < *low { value } else { *low };
            *high = if value > *high { value } else { *high };
        }
    }

    fn bounds(self) -> (f64, f64) {
        (self.low.into_iter().fold(f64::INFINITY, f64::min), self.high.into_iter().fold(f64::NEG_INFINITY, f64::max))
    }
}

/// Smallest and largest value; what is not a number is passed over.
pub(super) fn bounds(values: &[f64]) -> (f64, f64) {
    let (chunks, rest) = values.as_chunks::<LANES>();
    let mut lanes = Lanes::NONE;
    chunks.iter().for_each(|chunk| lanes.take(*chunk));
    rest.iter().for_each(|value| lanes.take([*value; LANES]));
    lanes.bounds()
}

/// Smallest and largest step from one value to the next.
pub(super) fn step_bounds(values: &[f64]) -> (f64, f64) {
    let after = values.get(1..).unwrap_or_default();
    let (chunks, rest) = after.as_chunks::<LANES>();
    let (before, rest_before) = values[..after.len()].as_chunks::<LANES>();
    let mut lanes = Lanes::NONE;
    chunks.iter().zip(before).for_each(|(next, this)| lanes.take(std::array::from_fn(|lane| next[lane] - this[lane])));
    rest.iter().zip(rest_before).for_each(|(next, this)| lanes.take([next - this; LANES]));
    lanes.bounds()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn one_pass_tells_what_a_pass_for_each_question_tells(
            levels in prop::collection::vec(-3_i8..3, 1..40), times in prop::collection::vec(0_usize..40, 1..40), length in 1_usize..5_000,
        ) {
            // Runs of few levels over several blocks.
            let runs = levels.iter().zip(times.iter().cycle()).cycle();
            let values: Vec<f64> =
                runs.flat_map(|(&level, &times)| std::iter::repeat_n(f64::from(level) + 0.5, times + 1)).take(length).collect();
            let low = values.iter().copied().fold(f64::INFINITY, f64::min);
            let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let count = |extreme: f64| values.iter().filter(|value| **value == extreme).count();
            let changes = values.windows(2).filter(|pair| pair[0] != pair[1]).count();
            let found = Extremes::of(&values);
            prop_assert_eq!(found, Extremes { low, high, at_low: count(low), at_high: count(high), changes });
            prop_assert_eq!((found.range(), found.most()), (high - low, low.abs().max(high.abs())));
            let steps = values.windows(2).map(|pair| pair[1] - pair[0]);
            let wanted = steps.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), step| (low.min(step), high.max(step)));
            prop_assert_eq!(step_bounds(&values), wanted);
        }
    }

    #[test]
    fn nothing_has_no_range_and_no_steps() {
        assert_eq!((Extremes::of(&[]).range(), Extremes::of(&[]).changes, Extremes::of(&[]).most()), (0.0, 0, 0.0));
        assert_eq!(step_bounds(&[]), (f64::INFINITY, f64::NEG_INFINITY));
        assert_eq!(bounds(&[f64::NAN, 1.0]), (1.0, 1.0));
    }
}
