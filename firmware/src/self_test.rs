//! The self-test: what the background checks before the rig may be armed.
//!
//! The program's own checksum, the clock against a second oscillator, and the active model with its golden vectors, one of which is corrupted
//! on purpose and must fail. Everything it finds goes to the tick as one report; a fault keeps the rig vented.

use model_export::blob::crc32;
use model_export::link::fault::{Fault, FaultSet};

use crate::model::ModelFacts;
use crate::tick::Action;

/// One oscillator counted against another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockCheck {
    /// Cycles counted.
    pub counted: u32,
    /// Cycles there should be.
    pub expected: u32,
    /// Allowed difference in parts per thousand; the less exact oscillator's tolerance.
    pub tolerance_per_mille: u32,
}

impl ClockCheck {
    /// Whether the two agree.
    pub fn agrees(&self) -> bool {
        let difference = u64::from(self.counted.abs_diff(self.expected));
        difference * 1000 <= u64::from(self.expected) * u64::from(self.tolerance_per_mille)
    }
}

/// The program and its clock, as the board hands them to the self-test; the model is [`crate::model`]'s.
#[derive(Clone, Copy, Debug)]
pub struct SelfTest<'a> {
    /// The program in flash, piece by piece, and the CRC-32 over all of it that it was sealed with.
    pub program: &'a [&'a [u8]],
    /// See `program`.
    pub program_crc32: u32,
    /// The clock; `None` where there is only one oscillator to ask, as in the emulator.
    pub clock: Option<ClockCheck>,
}

/// What the self-test found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// Empty if all is well.
    pub faults: FaultSet,
    /// The model that may run.
    pub model: Option<ModelFacts>,
}

impl Report {
    /// The report as the tick takes it.
    pub fn action(&self) -> Action {
        Action::SelfTestReport { faults: self.faults, model_period: self.model.map(|model| model.period) }
    }
}

impl SelfTest<'_> {
    /// Checks everything and tells everything, not only the first thing that is wrong.
    ///
    /// # Deadline
    /// Not for the tick: about 20 instructions a byte of the program.
    pub fn run(&self) -> FaultSet {
        let mut faults = FaultSet::EMPTY;
        let program_crc32 = self.program.iter().fold(0, |crc, piece| crc32(crc, piece));
        faults.insert_if(program_crc32 != self.program_crc32, Fault::FlashCorrupt);
        faults.insert_if(self.clock.is_some_and(|clock| !clock.agrees()), Fault::ClockInaccurate);
        faults
    }
}
