//! What the image logs: its start, states, faults with what was measured then, refusals, flash errors. Target only.
//!
//! defmt leaves the texts on the host: a line costs some bytes and microseconds, and never waits for a reader. Only the start and the background
//! log; the tick does not. A debug probe or the board's model takes the lines (`cargo xtask flash`, `catheter rig log`).

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use model_export::link::fault::FaultSet;
use model_export::link::hello::Build;
use model_export::link::message::{FaultRecord, Refusal};
use model_export::link::state::{ResetCause, State};

use crate::storage::MappedFlash;

/// The program, the chip and why it started.
pub fn start(board: &str, build: &Build, cause: ResetCause, core_hz: u32, program_crc32: u32) {
    defmt::info!("{=str}, firmware {=str} of source {=[u8]:02x}", board, env!("CARGO_PKG_VERSION"), build.source);
    defmt::info!("chip {=u32:08x}, started by {}, core at {=u32} Hz, program {=u32:08x}", build.chip, cause, core_hz, program_crc32);
}

/// Faults that stand at the start.
pub fn standing(faults: FaultSet) {
    for fault in faults.iter() {
        defmt::error!("at the start: E{=u8:03} {=str}", fault.number(), fault.explanation().name);
    }
}

/// What the run before left.
pub fn before(record: &FaultRecord) {
    defmt::warn!("the run before ended in E{=u8:03} at {=u64} ms", record.first, record.time_ms);
}

/// A state that has just been entered.
pub fn state(state: State) {
    defmt::info!("state {}", state);
}

/// The fault that has just struck.
pub fn fault(record: &FaultRecord) {
    defmt::error!(
        "E{=u8:03} in state {} at {=u64} ms, then E{=u8:03}: output {=i32} ubar, codes: pressure {=u16}, laser {=u16}; {=f32} bar, {=f32} mm, set-point {=f32}, {=u32} late ticks",
        record.first,
        record.state,
        record.time_ms,
        record.second,
        record.output_ubar,
        record.pressure_code,
        record.laser_code,
        record.pressure_bar,
        record.displacement_mm,
        record.set_point,
        record.late_ticks
    );
}

/// A request that was refused.
pub fn refusal(token: u32, refusal: Refusal) {
    defmt::warn!("request {=u32} refused: {}", token, refusal);
}

/// A flash driver whose errors are logged.
#[derive(Debug)]
pub struct Logged<F> {
    flash: F,
    name: &'static str,
}

impl<F> Logged<F> {
    /// Over a driver, under a name.
    pub const fn new(flash: F, name: &'static str) -> Self {
        Self { flash, name }
    }
}

impl<F: ErrorType> ErrorType for Logged<F> {
    type Error = F::Error;
}

impl<F: ReadNorFlash> ReadNorFlash for Logged<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.flash.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl<F: NorFlash<Error: defmt::Format>> NorFlash for Logged<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        defmt::info!("flash of {=str}: erasing {=u32:x} to {=u32:x}", self.name, from, to);
        let erased = self.flash.erase(from, to);
        if let Err(error) = &erased {
            defmt::error!("flash of {=str}: {=u32:x} not erased: {}", self.name, from, error);
        }
        erased
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        let written = self.flash.write(offset, bytes);
        if let Err(error) = &written {
            defmt::error!("flash of {=str}: {=u32:x} not written: {}", self.name, offset, error);
        }
        written
    }
}

impl<F: MappedFlash<Error: defmt::Format>> MappedFlash for Logged<F> {
    fn mapped(&self, sector: usize) -> &[u8] {
        self.flash.mapped(sector)
    }
}
