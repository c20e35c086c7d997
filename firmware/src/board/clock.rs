//! The clock's start: from the internal oscillator the chip wakes up on to 168 MHz, with every wait bounded.
//!
//! ```text
//! crystal starts? ─no──────────────► clock-failed ──┐
//!      │ yes                                        │
//! has its frequency? ─no───────────► clock-inaccurate (by the self-test)
//!      │ yes                                        │
//! PLL from the crystal              PLL from the internal oscillator
//!      │                                            │
//!      └──────── locks? ─no─► clock-failed, 16 MHz ◄┘
//! ```
//!
//! A crystal of the wrong frequency would drive the processor beyond its limit, so it is counted against the internal oscillator before
//! anything depends on it (RM0090 section 7.2.11). Whatever happens, the device comes up, speaks, and says what is wrong; without a good crystal it
//! stays vented, since every rate limit hangs on the time base.

use model_export::link::fault::{Fault, FaultSet};

use super::hardware::{CRYSTAL_HZ, INTERNAL_HZ, INTERNAL_TOLERANCE_PER_MILLE, Rates};
use crate::self_test::ClockCheck;

/// Polls to wait for the crystal: each takes at least four cycles of 16 MHz, so 50 ms at least; typical is 2 ms (DS8626 table 38).
pub const CRYSTAL_POLLS: u32 = 200_000;
/// Polls to wait for the phase-locked loop: 2 ms at least, 0.3 ms at most are needed (DS8626 table 43).
pub const PLL_POLLS: u32 = 8_000;
/// Polls to wait for a register to show what was written.
pub const SWITCH_POLLS: u32 = 1_000;

/// Crystal periods counted: 64 captures of every eighth edge of the crystal over 31.
pub const COUNTED_PERIODS: u32 = 64 * 8 * 31;
/// What the internal oscillator should count meanwhile; fits the 16-bit timer for every crystal the chip takes (4 to 26 MHz).
pub const EXPECTED_COUNT: u32 = COUNTED_PERIODS * (INTERNAL_HZ / CRYSTAL_HZ);
const _: () = assert!(COUNTED_PERIODS * (INTERNAL_HZ / 1_000_000) / 4 < 65_536);

/// Where the time comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The crystal, through the phase-locked loop.
    Crystal,
    /// The internal oscillator, through the phase-locked loop.
    InternalFast,
    /// The internal oscillator alone.
    Internal,
}

impl Source {
    /// The frequencies that go with it.
    pub const fn rates(self) -> Rates {
        match self {
            Self::Crystal | Self::InternalFast => Rates::FAST,
            Self::Internal => Rates::INTERNAL,
        }
    }
}

/// How the clock came up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockReport {
    /// Where the time comes from.
    pub source: Source,
    /// What went wrong; it stays true until the next start, so every self-test repeats it.
    pub faults: FaultSet,
    /// The crystal against the internal oscillator, if the crystal ran.
    pub check: Option<ClockCheck>,
}

/// The registers behind the clock, as the start needs them.
pub trait ClockTree {
    /// Switches the crystal oscillator on.
    fn start_crystal(&mut self);
    /// Whether it runs.
    fn crystal_is_ready(&mut self) -> bool;
    /// Counts the internal oscillator over [`COUNTED_PERIODS`] of the crystal; `None` if no edges come.
    fn count_crystal(&mut self) -> Option<u32>;
    /// Switches the crystal oscillator off.
    fn stop_crystal(&mut self);
    /// Switches the phase-locked loop on, fed by the crystal or by the internal oscillator.
    fn start_pll(&mut self, from_crystal: bool);
    /// Whether it has locked.
    fn pll_is_ready(&mut self) -> bool;
    /// Switches it off.
    fn stop_pll(&mut self);
    /// Sets flash wait states and bus dividers for 168 MHz.
    fn prepare_fast(&mut self);
    /// Whether they are in force.
    fn is_prepared(&mut self) -> bool;
    /// Runs the processor from the phase-locked loop or from the internal oscillator.
    fn select_pll(&mut self, pll: bool);
    /// Whether it runs from the phase-locked loop.
    fn runs_from_pll(&mut self) -> bool;
    /// Watches the crystal from now on: its failure is an interrupt that cannot be masked.
    fn watch_crystal(&mut self);
}

/// Asks up to `polls` times.
pub fn wait(polls: u32, mut ready: impl FnMut() -> bool) -> bool {
    (0..polls).any(|_| ready())
}

/// Brings the clock up.
pub fn start(tree: &mut impl ClockTree) -> ClockReport {
    let mut faults = FaultSet::EMPTY;
    tree.start_crystal();
    let mut check = None;
    if wait(CRYSTAL_POLLS, || tree.crystal_is_ready()) {
        // A crystal without edges counts as none: it differs from any expectation.
        let counted = tree.count_crystal().unwrap_or(0);
        check = Some(ClockCheck { counted, expected: EXPECTED_COUNT, tolerance_per_mille: INTERNAL_TOLERANCE_PER_MILLE });
    } else {
        faults.insert(Fault::ClockFailed);
    }
    let from_crystal = check.is_some_and(|check| check.agrees());
    faults.insert_if(check.is_some() && !from_crystal, Fault::ClockInaccurate);
    if !from_crystal {
        tree.stop_crystal();
    }
    tree.start_pll(from_crystal);
    let fast = wait(PLL_POLLS, || tree.pll_is_ready())
        && {
            tree.prepare_fast();
            wait(SWITCH_POLLS, || tree.is_prepared())
        }
        && {
            tree.select_pll(true);
            wait(SWITCH_POLLS, || tree.runs_from_pll())
        };
    let source = match (fast, from_crystal) {
        (true, true) => {
            tree.watch_crystal();
            Source::Crystal
        }
        (true, false) => Source::InternalFast,
        (false, _) => {
            tree.select_pll(false);
            tree.stop_pll();
            faults.insert(Fault::ClockFailed);
            Source::Internal
        }
    };
    ClockReport { source, faults, check }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clock tree that does what it is told, but for what is broken in it.
    #[derive(Default)]
    struct Tree {
        crystal_hz: Option<u32>,
        pll_never_locks: bool,
        wait_states_do_not_hold: bool,
        crystal_on: bool,
        pll: Option<bool>,
        prepared: bool,
        on_pll: bool,
        watched: bool,
        polls: u32,
        overclocked: bool,
    }

    impl ClockTree for Tree {
        fn start_crystal(&mut self) {
            self.crystal_on = true;
        }
        fn crystal_is_ready(&mut self) -> bool {
            self.polls += 1;
            self.crystal_on && self.crystal_hz.is_some() && self.polls > 100
        }
        fn count_crystal(&mut self) -> Option<u32> {
            assert!(!self.on_pll, "the count is of the internal oscillator");
            self.crystal_hz.filter(|hz| *hz > 0).map(|hz| (u64::from(COUNTED_PERIODS) * u64::from(INTERNAL_HZ) / u64::from(hz)) as u32)
        }
        fn stop_crystal(&mut self) {
            assert_ne!(self.pll, Some(true));
            self.crystal_on = false;
        }
        fn start_pll(&mut self, from_crystal: bool) {
            self.pll = Some(from_crystal);
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
            self.overclocked |= pll && (!self.prepared || (self.pll == Some(true) && self.crystal_hz != Some(CRYSTAL_HZ)));
            self.on_pll = pll;
        }
        fn runs_from_pll(&mut self) -> bool {
            self.on_pll
        }
        fn watch_crystal(&mut self) {
            self.watched = true;
        }
    }

    fn faults(set: FaultSet) -> Vec<Fault> {
        set.iter().collect()
    }

    extern crate std;
    use std::vec::Vec;

    #[test]
    fn a_good_crystal_drives_the_processor_and_is_watched() {
        let mut tree = Tree { crystal_hz: Some(CRYSTAL_HZ), ..Tree::default() };
        let report = start(&mut tree);
        assert_eq!((report.source, faults(report.faults)), (Source::Crystal, Vec::new()));
        assert_eq!(report.check.unwrap().counted, EXPECTED_COUNT);
        assert!(tree.watched && tree.on_pll && tree.pll == Some(true) && !tree.overclocked);
    }

    #[test]
    fn a_dead_crystal_is_a_named_fault_and_the_device_comes_up_at_full_speed() {
        let mut tree = Tree::default();
        let report = start(&mut tree);
        assert_eq!((report.source, faults(report.faults), report.check), (Source::InternalFast, [Fault::ClockFailed].to_vec(), None));
        assert!(tree.on_pll && tree.pll == Some(false) && !tree.crystal_on && !tree.watched && !tree.overclocked);
    }

    #[test]
    fn a_crystal_of_another_frequency_never_drives_the_processor() {
        for crystal_hz in [4_000_000, 7_000_000, 9_000_000, 12_000_000, 16_000_000, 25_000_000, 26_000_000, 0] {
            let mut tree = Tree { crystal_hz: Some(crystal_hz), ..Tree::default() };
            let report = start(&mut tree);
            assert_eq!(
                (report.source, faults(report.faults)),
                (Source::InternalFast, [Fault::ClockInaccurate].to_vec()),
                "{crystal_hz} Hz"
            );
            assert!(!report.check.unwrap().agrees() && !tree.overclocked && !tree.crystal_on, "{crystal_hz} Hz");
        }
    }

    #[test]
    fn a_loop_that_does_not_lock_leaves_the_device_on_the_internal_oscillator() {
        for crystal_hz in [None, Some(CRYSTAL_HZ)] {
            let mut tree = Tree { crystal_hz, pll_never_locks: true, ..Tree::default() };
            let report = start(&mut tree);
            assert_eq!((report.source, faults(report.faults)), (Source::Internal, [Fault::ClockFailed].to_vec()));
            assert!(!tree.on_pll && tree.pll.is_none() && tree.polls <= CRYSTAL_POLLS + PLL_POLLS);
        }
    }

    #[test]
    fn the_processor_never_outruns_the_flash() {
        let mut tree = Tree { crystal_hz: Some(CRYSTAL_HZ), wait_states_do_not_hold: true, ..Tree::default() };
        let report = start(&mut tree);
        assert_eq!((report.source, faults(report.faults)), (Source::Internal, [Fault::ClockFailed].to_vec()));
        assert!(!tree.overclocked);
    }
}
