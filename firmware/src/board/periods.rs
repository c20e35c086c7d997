//! How many milliseconds a tick stands for, by a count that does not depend on the sampling.

/// Turns the count of periods into elapsed ticks.
///
/// The sum of all elapsed ticks is the count, except that a tick always stands for at least one period: one that came late and is followed
/// by one in time must not count twice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PeriodClock {
    claimed: u32,
    /// Ticks in a row that found no new period.
    without_period: u8,
}

/// Ticks in a row without a new period that show that nobody counts: one alone is one that came late.
const STANDS_AFTER: u8 = 3;

impl PeriodClock {
    /// Periods lost since the last tick, given the count of all periods so far; wraps.
    pub fn lost(&mut self, periods: u32) -> u16 {
        let elapsed = periods.wrapping_sub(self.claimed);
        if elapsed == 0 || elapsed > u32::MAX / 2 {
            self.without_period = self.without_period.saturating_add(1);
            return 0;
        }
        (self.claimed, self.without_period) = (periods, 0);
        u16::try_from(elapsed.saturating_sub(1)).unwrap_or(u16::MAX)
    }

    /// Whether the count stands, so that lost ticks would not be seen.
    pub fn stands(&self) -> bool {
        self.without_period >= STANDS_AFTER
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_in_time_lose_nothing_and_lost_ones_are_counted_once() {
        let mut clock = PeriodClock { claimed: u32::MAX - 1, ..PeriodClock::default() };
        let counts = [u32::MAX, 0, 1, 5, 6, 6, 7];
        let lost = counts.map(|periods| clock.lost(periods));
        assert_eq!(lost, [0, 0, 0, 3, 0, 0, 0]);
        assert!(!clock.stands(), "a late tick is no count that stands");
    }

    #[test]
    fn a_count_that_stands_is_seen_and_one_that_goes_on_is_not() {
        let mut clock = PeriodClock::default();
        let stands = [1, 2, 2, 3, 3, 3, 3, 3, 4].map(|periods| {
            clock.lost(periods);
            clock.stands()
        });
        assert_eq!(stands, [false, false, false, false, false, false, true, true, false]);
    }
}
