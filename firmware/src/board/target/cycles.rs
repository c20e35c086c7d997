//! The debug unit's cycle counter.

use cortex_m::peripheral::{DCB, DWT};

use crate::board::tick_task::CycleCounter;

/// The counter; stands still in the emulator.
pub struct Cycles(DWT);

impl Cycles {
    /// Switches the counter on.
    pub fn start(dcb: &mut DCB, mut dwt: DWT) -> Self {
        dcb.enable_trace();
        dwt.enable_cycle_counter();
        Self(dwt)
    }
}

impl CycleCounter for Cycles {
    fn cycles(&self) -> u32 {
        self.0.cyccnt.read()
    }
}
