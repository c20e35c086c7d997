//! The valve's drive by pulse width, over any timer of this kind, and whether its pin does what the timer is told.
//!
//! The pin is an input too while the timer has it (RM0090 section 8.3.11). The background reads it together with the timer's count, thousands of
//! times a second and at every phase. Where the count leaves only one answer (it is neither near an edge nor between the width in force and the
//! one that comes next) the level has to be the one that the count says. Both levels are judged apart, since a pin that is stuck agrees half of the
//! time. So this finds a pin that is stuck, shorted or given to something else, and a timer that stands still or has another period.

use core::convert::Infallible;
use core::sync::atomic::{AtomicU32, Ordering};

use embedded_hal::pwm::{ErrorType, SetDutyCycle};
use model_export::link::settings::Settings;

use super::pulse::PulseTiming;
use super::rates::Rates;
use super::read_back::READINGS;
use crate::drivers::{PulseFrequency, PwmValve};

/// Time around an edge in which the level is not judged: a slow driver's gate at the pin, and the reading itself.
const EDGE_US: u32 = 2;
/// A count below which an update may have come between two accesses of the drive.
const JUST_NOW_COUNTS: u16 = 64;

/// A timer whose compare register and period are taken over by an update, at the end of a period.
pub trait PulseTimer {
    /// Writes the compare register.
    fn set_compare(&mut self, counts: u16);
    /// Writes prescaler and period with the compare register at zero, and makes an update.
    fn set_timing(&mut self, timing: PulseTiming);
    /// Gives the pin to the timer and lets it count.
    fn begin(&mut self);
    /// The count.
    fn count(&self) -> u16;
    /// Whether there was an update since the last call.
    fn take_update(&mut self) -> bool;
}

/// What the pin has to do, as the tick tells the background.
#[derive(Debug, Default)]
pub struct PulseExpectation {
    width: AtomicU32,
    timing: AtomicU32,
    edge: AtomicU32,
}

/// The same in plain numbers, of one instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExpectedPulse {
    /// The least and the most counts that may be in force.
    pub width: [u16; 2],
    /// Prescaler and period.
    pub timing: PulseTiming,
    /// Counts around an edge in which the level is not judged.
    pub edge: u16,
}

const fn pack(low: u16, high: u16) -> u32 {
    let ([l0, l1], [h0, h1]) = (low.to_le_bytes(), high.to_le_bytes());
    u32::from_le_bytes([l0, l1, h0, h1])
}

const fn unpack(word: u32) -> [u16; 2] {
    let [l0, l1, h0, h1] = word.to_le_bytes();
    [u16::from_le_bytes([l0, l1]), u16::from_le_bytes([h0, h1])]
}

impl PulseExpectation {
    /// Before there is a drive.
    pub const fn new() -> Self {
        Self { width: AtomicU32::new(0), timing: AtomicU32::new(0), edge: AtomicU32::new(0) }
    }

    fn set(&self, expected: ExpectedPulse) {
        let ExpectedPulse { width: [low, high], timing, edge } = expected;
        self.width.store(pack(low, high), Ordering::Relaxed);
        self.timing.store(pack(timing.prescaler, timing.period_counts), Ordering::Relaxed);
        self.edge.store(u32::from(edge), Ordering::Relaxed);
    }

    /// What is expected now; to be asked where no tick can come in between.
    pub fn now(&self) -> ExpectedPulse {
        let [prescaler, period_counts] = unpack(self.timing.load(Ordering::Relaxed));
        let [edge, _] = unpack(self.edge.load(Ordering::Relaxed));
        ExpectedPulse { width: unpack(self.width.load(Ordering::Relaxed)), timing: PulseTiming { prescaler, period_counts }, edge }
    }
}

/// The drive.
pub struct PulseDrive<T> {
    timer: T,
    timer_hz: u32,
    timing: PulseTiming,
    edge: u16,
    /// What was written last, and between which widths the one in force was at the last update that was seen.
    written: u16,
    held: [u16; 2],
    expectation: &'static PulseExpectation,
}

impl<T: PulseTimer> PulseDrive<T> {
    /// At zero. What the pin has to do is left in `expectation`.
    pub fn new(timer: T, rates: Rates, expectation: &'static PulseExpectation) -> PwmValve<Self> {
        let timing = PulseTiming::new(rates.timer_hz, Settings::DEFAULT.pulse_hz);
        let mut drive = Self { timer, timer_hz: rates.timer_hz, timing, edge: 0, written: 0, held: [0; 2], expectation };
        drive.set_pulse_hz(Settings::DEFAULT.pulse_hz);
        drive.timer.begin();
        PwmValve(drive)
    }

    fn tell(&self) {
        let Self { written, held: [low, high], timing, edge, .. } = *self;
        self.expectation.set(ExpectedPulse { width: [low.min(written), high.max(written)], timing, edge });
    }
}

impl<T: PulseTimer> PulseFrequency for PulseDrive<T> {
    fn set_pulse_hz(&mut self, pulse_hz: u32) {
        self.timing = PulseTiming::new(self.timer_hz, pulse_hz);
        self.timer.set_timing(self.timing);
        let clocks = self.timer_hz / (1_000_000 / EDGE_US);
        let counts = clocks.checked_div(u32::from(self.timing.prescaler) + 1).unwrap_or(clocks);
        // At least two, for the count that goes on while the pin is read.
        self.edge = u16::try_from(counts).unwrap_or(u16::MAX).saturating_add(2);
        (self.written, self.held) = (0, [0; 2]);
        self.tell();
    }
}

impl<T> ErrorType for PulseDrive<T> {
    type Error = Infallible;
}

impl<T: PulseTimer> SetDutyCycle for PulseDrive<T> {
    fn max_duty_cycle(&self) -> u16 {
        self.timing.period_counts
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        // A duty of the period's counts is always on.
        let duty = duty.min(self.timing.period_counts);
        self.timer.set_compare(duty);
        if self.timer.take_update() {
            // An update took over what stood there: the width before, or this one if it came just now.
            let just_now = self.timer.count() < JUST_NOW_COUNTS;
            self.held = if just_now { [duty.min(self.written), duty.max(self.written)] } else { [self.written; 2] };
        }
        self.written = duty;
        self.tell();
        Ok(())
    }
}

/// A look at the pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PulseReading {
    /// The count before and after the pin was read.
    pub counts: [u16; 2],
    /// Whether the pin is high.
    pub is_high: bool,
    /// Prescaler and period of the timer; a prescaler above 16 bits is none.
    pub timing: PulseTiming,
    /// Whether the timer counts and has the pin.
    pub is_on: bool,
}

/// Looks in a row that were wrong, for each level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PulseMonitor {
    not_high: u8,
    not_low: u8,
    not_set_up: u8,
}

impl PulseMonitor {
    /// Takes in a look; whether the pin does something else.
    pub fn step(&mut self, expected: &ExpectedPulse, reading: &PulseReading) -> bool {
        let PulseReading { counts: [before, after], is_high, timing, is_on } = *reading;
        let is_wrong = timing != expected.timing || !is_on;
        self.not_set_up = if is_wrong { self.not_set_up.saturating_add(1) } else { 0 };
        match level(expected, before, after) {
            Some(true) => self.not_high = if is_high { 0 } else { self.not_high.saturating_add(1) },
            Some(false) => self.not_low = if is_high { self.not_low.saturating_add(1) } else { 0 },
            None => {}
        }
        [self.not_high, self.not_low, self.not_set_up].iter().any(|readings| *readings >= READINGS)
    }
}

/// The level that the pin has to have between two counts; `None` where that is not certain.
fn level(expected: &ExpectedPulse, before: u16, after: u16) -> Option<bool> {
    let ExpectedPulse { width: [low, high], timing, edge } = *expected;
    let is_always_high = low >= timing.period_counts;
    if high == 0 || is_always_high {
        return Some(is_always_high);
    }
    if after < before {
        return None;
    }
    if before >= edge && after < low.saturating_sub(edge) {
        Some(true)
    } else if before >= high.saturating_add(edge) {
        Some(false)
    } else {
        None
    }
}

/// TIM3 of a chip behind [`PulseTimer`], and the look at its pin: both chips' registers are the same, in definitions of their own.
#[cfg(target_os = "none")]
macro_rules! pulse_timer {
    ($timer:ty, $pin_is_high:path) => {
        /// The timer of the pulse width, channel 1.
        pub struct Timer($timer);

        impl $crate::board::pulse_drive::PulseTimer for Timer {
            fn set_compare(&mut self, counts: u16) {
                // SAFETY: every number of counts has a meaning.
                self.0.ccr1().write(|w| unsafe { w.bits(u32::from(counts)) });
            }

            fn set_timing(&mut self, timing: $crate::board::pulse::PulseTiming) {
                // SAFETY: every prescaler and period counts; the width is zero.
                unsafe {
                    self.0.ccr1().write(|w| w.bits(0));
                    self.0.psc().write(|w| w.bits(u32::from(timing.prescaler)));
                    self.0.arr().write(|w| w.bits(u32::from(timing.period_counts.saturating_sub(1))));
                }
                // Only an update takes them over.
                self.0.egr().write(|w| w.ug().set_bit());
            }

            fn begin(&mut self) {
                self.0.ccer().write(|w| w.cc1e().set_bit());
                self.0.cr1().write(|w| w.arpe().set_bit().cen().set_bit());
            }

            fn count(&self) -> u16 {
                low_half(self.0.cnt().read().bits())
            }

            fn take_update(&mut self) -> bool {
                let is_updated = self.0.sr().read().uif().bit_is_set();
                if is_updated {
                    // SAFETY: flags are cleared by writing zeros, and ones leave them.
                    self.0.sr().write(|w| unsafe { w.bits(!1) });
                }
                is_updated
            }
        }

        impl Timer {
            /// Puts channel 1 into PWM mode 1 (OC1M = 110) with preload (OC1PE).
            fn new(timer: $timer) -> Self {
                // SAFETY: as said.
                timer.ccmr1_output().write(|w| unsafe { w.bits((0b110 << 4) | (1 << 3)) });
                Self(timer)
            }
        }

        fn low_half(bits: u32) -> u16 {
            let [low, high, ..] = bits.to_le_bytes();
            u16::from_le_bytes([low, high])
        }

        /// Looks at the pulse width's pin, with what it should do at that instant. No interrupt comes between, for less than a microsecond.
        pub fn read_pulse(
            expectation: &$crate::board::pulse_drive::PulseExpectation,
        ) -> ($crate::board::pulse_drive::ExpectedPulse, $crate::board::pulse_drive::PulseReading) {
            cortex_m::interrupt::free(|_| {
                // SAFETY: reading these registers changes nothing.
                let timer = unsafe { &*<$timer>::ptr() };
                let before = low_half(timer.cnt().read().bits());
                let is_high = $pin_is_high();
                let after = low_half(timer.cnt().read().bits());
                let timing = $crate::board::pulse::PulseTiming {
                    prescaler: low_half(timer.psc().read().bits()),
                    period_counts: low_half(timer.arr().read().bits()).saturating_add(1),
                };
                let is_on = timer.cr1().read().cen().bit_is_set() && timer.ccer().read().cc1e().bit_is_set();
                let reading = $crate::board::pulse_drive::PulseReading { counts: [before, after], is_high, timing, is_on };
                (expectation.now(), reading)
            })
        }
    };
}
#[cfg(target_os = "none")]
pub(crate) use pulse_timer;

#[cfg(test)]
mod tests {
    extern crate std;
    use std::boxed::Box;
    use std::cell::RefCell;
    use std::rc::Rc;

    use super::*;
    use crate::parity::Noise;

    /// A timer of RM0090 section 18.3.9, whose time passes with every access.
    struct Timer {
        clocks: u64,
        timing: PulseTiming,
        period_began: u64,
        compare: u16,
        in_force: u16,
        updated: bool,
    }

    impl Timer {
        fn pass(&mut self, clocks: u64) {
            self.clocks += clocks;
            let period = u64::from(self.timing.period_counts) * (u64::from(self.timing.prescaler) + 1);
            while self.clocks - self.period_began >= period {
                self.period_began += period;
                (self.in_force, self.updated) = (self.compare, true);
            }
        }
        fn counted(&self) -> u16 {
            u16::try_from((self.clocks - self.period_began) / (u64::from(self.timing.prescaler) + 1)).unwrap()
        }
        fn is_high(&self) -> bool {
            self.counted() < self.in_force
        }
    }

    #[derive(Clone)]
    struct Shared(Rc<RefCell<Timer>>);

    impl PulseTimer for Shared {
        fn set_compare(&mut self, counts: u16) {
            let mut timer = self.0.borrow_mut();
            timer.pass(ACCESS_CLOCKS);
            timer.compare = counts;
        }
        fn set_timing(&mut self, timing: PulseTiming) {
            let mut timer = self.0.borrow_mut();
            (timer.timing, timer.compare, timer.in_force, timer.updated) = (timing, 0, 0, true);
            timer.period_began = timer.clocks;
        }
        fn begin(&mut self) {}
        fn count(&self) -> u16 {
            self.0.borrow().counted()
        }
        fn take_update(&mut self) -> bool {
            let mut timer = self.0.borrow_mut();
            timer.pass(ACCESS_CLOCKS);
            let updated = timer.updated;
            if updated {
                // What comes between the reading of the flag and its clearing is lost.
                timer.pass(ACCESS_CLOCKS);
                timer.updated = false;
            }
            updated
        }
    }

    const TIMER_HZ: u32 = 84_000_000;
    const ACCESS_CLOCKS: u64 = 3;

    /// A second at this frequency with widths that change in every tick, and looks at the pin in between; counts how often a level was certain,
    /// and gives the look at which the monitor found a pin that `level` makes of the timer's.
    fn run(pulse_hz: u32, seed: u32, duty: impl Fn(f64, f64) -> f64, level: impl Fn(bool) -> bool) -> ([u32; 2], Option<u32>) {
        let expectation: &'static PulseExpectation = Box::leak(Box::default());
        let timing = PulseTiming { prescaler: 0, period_counts: 2 };
        let timer = Timer { clocks: 0, timing, period_began: 0, compare: 0, in_force: 0, updated: false };
        let timer = Shared(Rc::new(RefCell::new(timer)));
        let rates = Rates { core_hz: 2 * TIMER_HZ, timer_hz: TIMER_HZ, line_hz: TIMER_HZ };
        let PwmValve(mut drive) = PulseDrive::new(timer.clone(), rates, expectation);
        drive.set_pulse_hz(pulse_hz);
        let mut chance = Noise::new(seed);
        let mut certain = [0; 2];
        let mut looks = 0;
        let mut monitor = PulseMonitor::default();
        for tick in 0..1000u32 {
            let share = duty(f64::from(tick) / 1000.0, f64::from(chance.symmetric()));
            drive.set_duty_cycle((share.clamp(0.0, 1.0) * f64::from(drive.max_duty_cycle())) as u16).unwrap();
            // Looks until the next tick, at odd times.
            let mut timer = timer.0.borrow_mut();
            let end = u64::from(tick + 1) * u64::from(TIMER_HZ / 1000);
            while timer.clocks < end {
                timer.pass(500 + (1000.0 * (1.0 + chance.symmetric())) as u64);
                let expected = expectation.now();
                let before = timer.counted();
                timer.pass(ACCESS_CLOCKS);
                let is_high = level(timer.is_high());
                timer.pass(ACCESS_CLOCKS);
                let reading = PulseReading { counts: [before, timer.counted()], is_high, timing: timer.timing, is_on: true };
                if let Some(high) = super::level(&expected, before, timer.counted()) {
                    certain[usize::from(high)] += 1;
                }
                looks += 1;
                if monitor.step(&expected, &reading) {
                    return (certain, Some(looks));
                }
            }
        }
        (certain, None)
    }

    #[test]
    fn a_pin_that_obeys_is_never_found_wrong_at_any_frequency_and_width() {
        for (seed, pulse_hz) in (1..).zip([20, 50, 333, 500, 997, 1_000, 4_999, 20_000]) {
            for widths in [|_: f64, noise: f64| 0.5 + 0.5 * noise, |at: f64, _: f64| at, |at: f64, _: f64| 1.2 * (at * 9.0).fract() - 0.1] {
                let (certain, found) = run(pulse_hz, seed, widths, |is_high| is_high);
                assert_eq!(found, None, "{pulse_hz} Hz, seed {seed}");
                assert!(certain.iter().all(|looks| *looks > 1000), "{pulse_hz} Hz: {certain:?} looks were certain");
            }
        }
    }

    #[test]
    fn a_pin_that_is_stuck_is_found_within_the_time_of_some_pulses() {
        for (seed, pulse_hz) in (31..).zip([20, 500, 1_000, 20_000]) {
            for stuck in [false, true] {
                let (_, found) = run(pulse_hz, seed, |_, _| 0.3, |_| stuck);
                // A look takes 18 us on average: the tick until the width is in force, some ten pulses' width in looks, and two periods.
                let most = 150 + 2 * 1_000_000 / pulse_hz / 10;
                assert!(found.is_some_and(|looks| looks <= most), "{pulse_hz} Hz, stuck {stuck}: {found:?}");
            }
        }
        // The drive at rest.
        assert_eq!(run(20_000, 41, |_, _| 0.0, |_| true).1, Some(u32::from(READINGS)));
        assert_eq!(run(20_000, 42, |_, _| 1.0, |_| false).1.map(|looks| looks < 100), Some(true));
    }

    #[test]
    fn a_timer_that_stands_still_or_has_another_period_is_found() {
        let timing = PulseTiming { prescaler: 0, period_counts: 4200 };
        let expected = ExpectedPulse { width: [2000, 2000], timing, edge: 170 };
        let reading = PulseReading { counts: [2100, 2102], is_high: false, timing, is_on: true };
        for wrong in [
            PulseReading { timing: PulseTiming { period_counts: 8296, ..timing }, ..reading },
            PulseReading { timing: PulseTiming { prescaler: 4, ..timing }, ..reading },
            PulseReading { is_on: false, ..reading },
        ] {
            let mut monitor = PulseMonitor::default();
            assert_eq!((1..100).find(|_| monitor.step(&expected, &wrong)), Some(u32::from(READINGS)));
        }
        let mut monitor = PulseMonitor::default();
        assert!((0..100).all(|_| !monitor.step(&expected, &reading)));
    }
}
