//! How many milliseconds a tick stands for, by a count that does not depend on the sampling.

/// Turns the count of periods into elapsed ticks.
///
/// The sum of all elapsed ticks is the count, except that a tick always stands for at least one period: one that came late and is followed
/// by one in time must not count twice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PeriodClock {
    claimed: u32,
}

impl PeriodClock {
    /// Periods lost since the last tick, given the count of all periods so far; wraps.
    pub fn lost(&mut self, periods: u32) -> u16 {
        let elapsed = periods.wrapping_sub(self.claimed);
        if elapsed == 0 || elapsed > u32::MAX / 2 {
            return 0;
        }
        self.claimed = periods;
        u16::try_from(elapsed.saturating_sub(1)).unwrap_or(u16::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_in_time_lose_nothing_and_lost_ones_are_counted_once() {
        let mut clock = PeriodClock { claimed: u32::MAX - 1 };
        let counts = [u32::MAX, 0, 1, 5, 6, 6, 7];
        let lost = counts.map(|periods| clock.lost(periods));
        assert_eq!(lost, [0, 0, 0, 3, 0, 0, 0]);
    }
}
