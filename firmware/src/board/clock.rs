//! The clock's start: from the internal oscillator the chip wakes up on to its full frequency, with every wait bounded.
//!
//! ```text
//! HSE starts? ─no──────────────► clock-failed ──┐
//!      │ yes                                        │
//! has its frequency? ─no───────────► clock-inaccurate (by the self-test)
//!      │ yes                                        │
//! PLL from the HSE              PLL from the internal oscillator
//!      │                                            │
//!      └──────── locks? ─no─► clock-failed, 16 MHz ◄┘
//! ```
//!
//! An HSE of the wrong frequency would drive the processor beyond its limit, so it is counted against the internal oscillator before
//! anything depends on it (RM0090 section 7.2.11). Whatever happens, the device comes up, speaks, and says what is wrong; without a good HSE it
//! stays vented, since every rate limit hangs on the time base.

use model_export::link::fault::{Fault, FaultSet};

use super::rates::{Rates, rounded};
use crate::self_test::ClockCheck;

/// Polls to wait for the HSE: each takes at least four cycles of 16 MHz, so 50 ms at least; typical is 2 ms (DS8626 table 38).
pub const HSE_POLLS: u32 = 200_000;
/// Polls to wait for the phase-locked loop: 2 ms at least, 0.3 ms at most are needed (DS8626 table 43).
pub const PLL_POLLS: u32 = 8_000;
/// Polls to wait for a register to show what was written.
pub const SWITCH_POLLS: u32 = 1_000;

/// HSE periods counted: 64 captures of every eighth edge of the HSE over 31.
pub const COUNTED_PERIODS: u32 = 64 * 8 * 31;

/// What the internal oscillator should count meanwhile, rounded to nearest.
pub const fn expected_count(internal_hz: u32, hse_hz: u32) -> u32 {
    rounded(COUNTED_PERIODS as u64 * internal_hz as u64, hse_hz as u64)
}

/// What the clock should become, by chip and HSE.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockPlan<P> {
    /// What the internal oscillator counts over [`COUNTED_PERIODS`] of the right HSE.
    pub expected_count: u32,
    /// How far the count may be off, by the internal oscillator's tolerance.
    pub tolerance_per_mille: u32,
    /// What the phase-locked loop makes of the HSE.
    pub from_hse: P,
    /// The frequencies that come of it.
    pub hse_rates: Rates,
    /// What the phase-locked loop makes of the internal oscillator.
    pub from_internal: P,
    /// The frequencies that come of it.
    pub internal_fast_rates: Rates,
    /// The frequencies without the phase-locked loop.
    pub internal_rates: Rates,
}

/// Where the time comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The HSE, through the phase-locked loop.
    Hse,
    /// The internal oscillator, through the phase-locked loop.
    InternalFast,
    /// The internal oscillator alone.
    Internal,
}

/// How the clock came up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockReport {
    /// Where the time comes from.
    pub source: Source,
    /// The frequencies that go with it.
    pub rates: Rates,
    /// What went wrong; it stays true until the next start, so every self-test repeats it.
    pub faults: FaultSet,
    /// The HSE against the internal oscillator, if the HSE ran.
    pub check: Option<ClockCheck>,
}

/// The registers behind the clock, as the start needs them.
pub trait ClockTree {
    /// Settings of the phase-locked loop.
    type Pll: Copy;
    /// Switches the HSE oscillator on.
    fn start_hse(&mut self);
    /// Whether it runs.
    fn hse_is_ready(&mut self) -> bool;
    /// Counts the internal oscillator over [`COUNTED_PERIODS`] of the HSE; `None` if no edges come.
    fn count_hse(&mut self) -> Option<u32>;
    /// Switches the HSE oscillator off.
    fn stop_hse(&mut self);
    /// Switches the phase-locked loop on, fed by the HSE or by the internal oscillator.
    fn start_pll(&mut self, from_hse: bool, pll: Self::Pll);
    /// Whether it has locked.
    fn pll_is_ready(&mut self) -> bool;
    /// Switches it off.
    fn stop_pll(&mut self);
    /// Sets flash wait states and bus dividers for the full frequency.
    fn prepare_fast(&mut self);
    /// Whether they are in force.
    fn is_prepared(&mut self) -> bool;
    /// Runs the processor from the phase-locked loop or from the internal oscillator.
    fn select_pll(&mut self, pll: bool);
    /// Whether it runs from the phase-locked loop.
    fn runs_from_pll(&mut self) -> bool;
    /// Watches the HSE from now on: its failure is an interrupt that cannot be masked.
    fn watch_hse(&mut self);
}

/// Asks up to `polls` times.
pub fn wait(polls: u32, mut ready: impl FnMut() -> bool) -> bool {
    (0..polls).any(|_| ready())
}

/// Brings the clock up as planned.
pub fn start<T: ClockTree>(tree: &mut T, plan: &ClockPlan<T::Pll>) -> ClockReport {
    let mut faults = FaultSet::EMPTY;
    tree.start_hse();
    let mut check = None;
    if wait(HSE_POLLS, || tree.hse_is_ready()) {
        // An HSE without edges counts as none: it differs from any expectation.
        let counted = tree.count_hse().unwrap_or(0);
        check = Some(ClockCheck { counted, expected: plan.expected_count, tolerance_per_mille: plan.tolerance_per_mille });
    } else {
        faults.insert(Fault::ClockFailed);
    }
    let from_hse = check.is_some_and(|check| check.agrees());
    faults.insert_if(check.is_some() && !from_hse, Fault::ClockInaccurate);
    if !from_hse {
        tree.stop_hse();
    }
    tree.start_pll(from_hse, if from_hse { plan.from_hse } else { plan.from_internal });
    let fast = wait(PLL_POLLS, || tree.pll_is_ready())
        && {
            tree.prepare_fast();
            wait(SWITCH_POLLS, || tree.is_prepared())
        }
        && {
            tree.select_pll(true);
            wait(SWITCH_POLLS, || tree.runs_from_pll())
        };
    let (source, rates) = match (fast, from_hse) {
        (true, true) => {
            tree.watch_hse();
            (Source::Hse, plan.hse_rates)
        }
        (true, false) => (Source::InternalFast, plan.internal_fast_rates),
        (false, _) => {
            tree.select_pll(false);
            tree.stop_pll();
            faults.insert(Fault::ClockFailed);
            (Source::Internal, plan.internal_rates)
        }
    };
    ClockReport { source, rates, faults, check }
}

#[cfg(test)]
mod tests {
    use super::super::stm32f405::facts::{CORE_HZ, INTERNAL_HZ, PLL_CORE_DIVIDER, Pll, fast, plan};
    use super::*;

    const HSE_HZ: u32 = 8_000_000;

    /// With an HSE of 8 MHz.
    fn start(tree: &mut Tree) -> ClockReport {
        super::start(tree, &plan(HSE_HZ))
    }

    /// A clock tree that does what it is told, but for what is broken in it.
    #[derive(Default)]
    struct Tree {
        hse_hz: Option<u32>,
        /// Of the internal oscillator's frequency.
        internal_error: f64,
        pll_never_locks: bool,
        wait_states_do_not_hold: bool,
        hse_on: bool,
        pll: Option<(bool, Pll)>,
        prepared: bool,
        on_pll: bool,
        watched: bool,
        polls: u32,
        overclocked: bool,
    }

    impl ClockTree for Tree {
        type Pll = Pll;
        fn start_hse(&mut self) {
            self.hse_on = true;
        }
        fn hse_is_ready(&mut self) -> bool {
            self.polls += 1;
            self.hse_on && self.hse_hz.is_some() && self.polls > 100
        }
        fn count_hse(&mut self) -> Option<u32> {
            assert!(!self.on_pll, "the count is of the internal oscillator");
            let counted = |hz| f64::from(COUNTED_PERIODS) * f64::from(INTERNAL_HZ) * (1.0 + self.internal_error) / f64::from(hz);
            self.hse_hz.filter(|hz| *hz > 0).map(|hz| counted(hz) as u32)
        }
        fn stop_hse(&mut self) {
            assert!(!matches!(self.pll, Some((true, _))));
            self.hse_on = false;
        }
        fn start_pll(&mut self, from_hse: bool, pll: Pll) {
            self.pll = Some((from_hse, pll));
        }
        fn pll_is_ready(&mut self) -> bool {
            self.polls += 1;
            !self.pll_never_locks
        }
        fn stop_pll(&mut self) {
            assert!(!self.on_pll, "the processor runs from it");
            self.pll = None;
        }
        fn prepare_fast(&mut self) {
            self.prepared = !self.wait_states_do_not_hold;
        }
        fn is_prepared(&mut self) -> bool {
            self.polls += 1;
            self.prepared
        }
        fn select_pll(&mut self, pll: bool) {
            let core_hz = self.pll.map_or(0, |(from_hse, pll)| {
                let input_hz = if from_hse { self.hse_hz.unwrap_or(0) } else { INTERNAL_HZ };
                u64::from(input_hz) * u64::from(pll.multiplier) / u64::from(pll.divider) / u64::from(PLL_CORE_DIVIDER)
            });
            self.overclocked |= pll && (!self.prepared || core_hz > u64::from(CORE_HZ));
            self.on_pll = pll;
        }
        fn runs_from_pll(&mut self) -> bool {
            self.on_pll
        }
        fn watch_hse(&mut self) {
            self.watched = true;
        }
    }

    fn faults(set: FaultSet) -> Vec<Fault> {
        set.iter().collect()
    }

    extern crate std;
    use std::vec::Vec;

    #[test]
    fn a_good_hse_drives_the_processor_and_is_watched() {
        let mut tree = Tree { hse_hz: Some(HSE_HZ), ..Tree::default() };
        let report = start(&mut tree);
        assert_eq!((report.source, faults(report.faults)), (Source::Hse, Vec::new()));
        assert_eq!(report.check.unwrap().counted, expected_count(INTERNAL_HZ, HSE_HZ));
        assert!(tree.watched && tree.on_pll && tree.pll == Some((true, Pll::from_input(HSE_HZ).unwrap())) && !tree.overclocked);
    }

    #[test]
    fn a_dead_hse_is_a_named_fault_and_the_device_comes_up_at_full_speed() {
        let mut tree = Tree::default();
        let report = start(&mut tree);
        assert_eq!((report.source, faults(report.faults), report.check), (Source::InternalFast, [Fault::ClockFailed].to_vec(), None));
        assert!(tree.on_pll && tree.pll == Some((false, Pll::INTERNAL)) && !tree.hse_on && !tree.watched && !tree.overclocked);
    }

    #[test]
    fn every_hse_that_the_chip_takes_drives_the_processor_and_no_other_in_its_place_does() {
        // Every megahertz, and those that divide nothing here.
        let odd = [7_372_800, 8_388_608, 11_059_200, 12_288_000, 14_745_600, 18_432_000, 24_576_000];
        for hse_hz in (4..=26).map(|mhz| mhz * 1_000_000).chain(odd) {
            let pll = Pll::from_input(hse_hz).unwrap();
            let divided_hz = f64::from(hse_hz) / f64::from(pll.divider);
            assert!((1e6..=2e6).contains(&divided_hz) && (50..=432).contains(&pll.multiplier) && (2..=63).contains(&pll.divider));
            let core_hz = divided_hz * f64::from(pll.multiplier) / f64::from(PLL_CORE_DIVIDER);
            // Exact wherever it can be, and nowhere slower by more than 1 %.
            assert!(core_hz <= f64::from(CORE_HZ) && core_hz > 0.99 * f64::from(CORE_HZ), "{hse_hz} Hz: {core_hz} Hz");
            assert!(hse_hz % 1_000_000 != 0 || pll.core_hz == CORE_HZ, "{hse_hz} Hz: {core_hz} Hz");
            let rates = fast(pll.core_hz);
            assert_eq!(rates.cycles_per_tick(), 2 * rates.timer_counts_per_tick(), "{hse_hz} Hz");
            let tick_s = f64::from(rates.timer_counts_per_tick()) / (core_hz / 2.0);
            assert!((tick_s * 1000.0 - 1.0).abs() < 12e-6, "{hse_hz} Hz: a tick of {tick_s} s");

            // The internal oscillator may be 8 % slow to 4.5 % fast.
            for internal_error in [-0.075, 0.0, 0.045] {
                let mut tree = Tree { hse_hz: Some(hse_hz), internal_error, ..Tree::default() };
                let report = super::start(&mut tree, &plan(hse_hz));
                assert_eq!((report.source, faults(report.faults)), (Source::Hse, Vec::new()), "{hse_hz} Hz, {internal_error}");
                assert!(tree.watched && !tree.overclocked && report.rates == rates, "{hse_hz} Hz");
            }
            for factor in [0.5, 0.66, 0.85, 1.15, 1.5, 2.0, 3.0] {
                let fitted = (f64::from(hse_hz) * factor) as u32;
                let mut tree = Tree { hse_hz: Some(fitted), ..Tree::default() };
                let report = super::start(&mut tree, &plan(hse_hz));
                assert_eq!(report.source, Source::InternalFast, "{fitted} Hz instead of {hse_hz} Hz");
                assert!(!tree.overclocked && faults(report.faults) == [Fault::ClockInaccurate]);
            }
        }
        assert_eq!((Pll::from_input(900_000), Pll::from_input(200_000_000)), (None, None));
    }

    #[test]
    fn a_hse_of_another_frequency_never_drives_the_processor() {
        for hse_hz in [4_000_000, 7_000_000, 9_000_000, 12_000_000, 16_000_000, 25_000_000, 26_000_000, 0] {
            let mut tree = Tree { hse_hz: Some(hse_hz), ..Tree::default() };
            let report = start(&mut tree);
            assert_eq!((report.source, faults(report.faults)), (Source::InternalFast, [Fault::ClockInaccurate].to_vec()), "{hse_hz} Hz");
            assert!(!report.check.unwrap().agrees() && !tree.overclocked && !tree.hse_on, "{hse_hz} Hz");
        }
    }

    #[test]
    fn a_loop_that_does_not_lock_leaves_the_device_on_the_internal_oscillator() {
        for hse_hz in [None, Some(HSE_HZ)] {
            let mut tree = Tree { hse_hz, pll_never_locks: true, ..Tree::default() };
            let report = start(&mut tree);
            assert_eq!((report.source, faults(report.faults)), (Source::Internal, [Fault::ClockFailed].to_vec()));
            assert!(!tree.on_pll && tree.pll.is_none() && tree.polls <= HSE_POLLS + PLL_POLLS);
        }
    }

    #[test]
    fn the_processor_never_outruns_the_flash() {
        let mut tree = Tree { hse_hz: Some(HSE_HZ), wait_states_do_not_hold: true, ..Tree::default() };
        let report = start(&mut tree);
        assert_eq!((report.source, faults(report.faults)), (Source::Internal, [Fault::ClockFailed].to_vec()));
        assert!(!tree.overclocked);
    }
}
