//! The independent watchdog: short while there may be pressure, long while vented.
//!
//! It has an oscillator of its own and nothing can stop it once it runs. While energised it must catch a hang within 50 ms; while vented an
//! erase of a flash sector stops the processor for up to two seconds, and the watchdog must wait that long.

/// Frequencies of the watchdogs' own oscillators, Hz, from the slowest to the fastest of all chips; each chip's are checked against these.
pub const OSCILLATOR_HZ: (u32, u32) = (17_000, 47_000);
/// Longest erase of a flash sector of all chips, ms; each chip's is checked against it.
pub const LONGEST_ERASE_MS: u32 = 2_000;

/// What the watchdog is set to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WatchdogMode {
    /// For vented states.
    Vented,
    /// For energised states.
    Energised,
}

impl WatchdogMode {
    /// Prescaler code: the divider is 4 shifted left by it (RM0090 section 21.4.2).
    pub const fn prescaler(self) -> u8 {
        match self {
            Self::Vented => 4,
            Self::Energised => 0,
        }
    }

    /// Value the counter starts from, 12 bits.
    pub const fn reload(self) -> u16 {
        match self {
            Self::Vented => 4095,
            Self::Energised => 200,
        }
    }

    /// Shortest and longest time without a feed, ms, by the oscillator's tolerance.
    pub const fn period_ms(self) -> (u32, u32) {
        let counts = 1000 * (4 << self.prescaler()) * (self.reload() as u32 + 1);
        (counts / OSCILLATOR_HZ.1, counts.div_ceil(OSCILLATOR_HZ.0))
    }
}
const _: () = assert!(WatchdogMode::Energised.period_ms().1 < 50 && WatchdogMode::Energised.period_ms().0 > 10);
const _: () = assert!(WatchdogMode::Vented.period_ms().0 > 2 * LONGEST_ERASE_MS);

/// The watchdog's registers.
pub trait WatchdogTimer {
    /// Whether an earlier setting is still on its way to the watchdog's clock domain.
    fn is_busy(&self) -> bool;
    /// Sets prescaler and reload value.
    fn set(&mut self, prescaler: u8, reload: u16);
    /// Starts the counter again from the reload value.
    fn feed(&mut self);
}

/// The running watchdog.
#[derive(Debug)]
pub struct Watchdog<T> {
    timer: T,
    mode: WatchdogMode,
}

impl<T: WatchdogTimer> Watchdog<T> {
    /// Takes over a timer that was started in the mode for vented states.
    pub fn new(mut timer: T) -> Self {
        timer.set(WatchdogMode::Vented.prescaler(), WatchdogMode::Vented.reload());
        timer.feed();
        Self { timer, mode: WatchdogMode::Vented }
    }

    /// Once a tick: the mode follows the state, and the counter starts again if `feed`. Never waits.
    pub fn serve(&mut self, energised: bool, feed: bool) {
        let wanted = if energised { WatchdogMode::Energised } else { WatchdogMode::Vented };
        // A setting takes up to five periods of the slow oscillator; until then the next one has to wait a tick.
        if wanted != self.mode && !self.timer.is_busy() {
            self.timer.set(wanted.prescaler(), wanted.reload());
            self.mode = wanted;
        }
        if feed {
            self.timer.feed();
        }
    }

    /// Whether the last setting is still on its way.
    pub fn is_settling(&self) -> bool {
        self.timer.is_busy()
    }

    /// The mode in force.
    pub fn mode(&self) -> WatchdogMode {
        self.mode
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts in its own clock domain; a setting needs two ticks to get there.
    #[derive(Default)]
    struct Timer {
        settling: u8,
        next: (u8, u16),
        left_ms: f64,
    }

    impl Timer {
        /// A millisecond of the slowest oscillator; `false` when the watchdog bites.
        fn advance(&mut self) -> bool {
            self.settling = self.settling.saturating_sub(1);
            self.left_ms -= 1.0;
            self.left_ms > 0.0
        }
    }

    impl WatchdogTimer for Timer {
        fn is_busy(&self) -> bool {
            self.settling > 0
        }
        fn set(&mut self, prescaler: u8, reload: u16) {
            assert_eq!(self.settling, 0, "a setting is still on its way");
            (self.settling, self.next) = (2, (prescaler, reload));
        }
        fn feed(&mut self) {
            if self.settling == 0 {
                self.left_ms = f64::from(4u32 << self.next.0) * f64::from(self.next.1 + 1) * 1000.0 / f64::from(OSCILLATOR_HZ.0);
            }
        }
    }

    fn ticks_until_it_bites(watchdog: &mut Watchdog<Timer>, energised: bool) -> u32 {
        (1..100_000)
            .find(|_| {
                watchdog.serve(energised, false);
                !watchdog.timer.advance()
            })
            .unwrap()
    }

    #[test]
    fn a_hang_while_energised_is_caught_within_50_ms_and_an_erase_while_vented_is_not() {
        let mut watchdog = Watchdog::new(Timer::default());
        for energised in [false, true, false, true, true, false] {
            for _ in 0..20 {
                watchdog.serve(energised, true);
                watchdog.timer.advance();
            }
        }
        assert!(ticks_until_it_bites(&mut watchdog, false) > LONGEST_ERASE_MS);
        for _ in 0..20 {
            watchdog.serve(true, true);
            watchdog.timer.advance();
        }
        assert_eq!(watchdog.mode(), WatchdogMode::Energised);
        assert!(ticks_until_it_bites(&mut watchdog, true) < 50);
    }
}
