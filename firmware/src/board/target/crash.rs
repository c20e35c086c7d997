//! The way down: vent first, then write into memory that survives what struck, then start again.

use core::mem::MaybeUninit;

use model_export::link::fault::Fault;

use crate::board::chip::registers::vent;
use crate::board::tick_task::CrashMemory;
use crate::crash_record::{CrashRecord, SEALED_BYTES};
use crate::history::{HistoryMemory, HistoryWords, WORDS};

/// The record in memory that start-up code neither loads nor clears.
#[unsafe(link_section = ".uninit.retained")]
static mut RETAINED: MaybeUninit<[u8; SEALED_BYTES]> = MaybeUninit::uninit();

/// The last ticks, likewise.
#[unsafe(link_section = ".uninit.history")]
static mut HISTORY: MaybeUninit<[u32; WORDS]> = MaybeUninit::uninit();

fn history_word(word: usize) -> Option<*mut u32> {
    (word < WORDS).then(|| (&raw mut HISTORY).cast::<u32>().wrapping_add(word))
}

/// The last ticks, to read.
#[derive(Clone, Copy, Debug)]
pub struct LastTicks;

impl HistoryWords for LastTicks {
    fn read(&self, word: usize) -> u32 {
        // SAFETY: within the array. RAM always holds something, and every word is valid; volatile, since the tick writes it meanwhile and since
        // the compiler must not reason about where it came from.
        history_word(word).map_or(0, |place| unsafe { place.read_volatile() })
    }
}

/// Writes the record, byte by byte: the compiler must not think that nobody reads it.
#[inline(never)]
fn write(sealed: &[u8; SEALED_BYTES]) {
    let bytes = (&raw mut RETAINED).cast::<u8>();
    for (index, byte) in sealed.iter().enumerate() {
        // SAFETY: within the array. Only the tick and what never returns write here, so no write is interrupted by another that goes on.
        unsafe { bytes.add(index).write_volatile(*byte) };
    }
}

#[inline(never)]
fn read() -> Option<CrashRecord> {
    let bytes = (&raw const RETAINED).cast::<u8>();
    let mut sealed = [0; SEALED_BYTES];
    for (index, byte) in sealed.iter_mut().enumerate() {
        // SAFETY: within the array. RAM always holds some bytes, and every byte is valid; volatile, so that the compiler does not reason
        // about where they came from.
        *byte = unsafe { bytes.add(index).read_volatile() };
    }
    CrashRecord::open(&sealed)
}

/// The record as it is now; `None` while the tick writes it.
pub fn peek() -> Option<CrashRecord> {
    read()
}

/// What the run before left; afterwards it is gone.
pub fn take() -> Option<CrashRecord> {
    let crash_record = read();
    write(&[0; SEALED_BYTES]);
    crash_record
}

/// Keeps the tick's record.
#[derive(Debug)]
pub struct NoInitMemory(());

impl NoInitMemory {
    /// # Safety
    /// One for the whole program, in the tick.
    pub const unsafe fn new() -> Self {
        Self(())
    }
}

impl HistoryWords for NoInitMemory {
    fn read(&self, word: usize) -> u32 {
        LastTicks.read(word)
    }
}

impl HistoryMemory for NoInitMemory {
    fn write(&mut self, word: usize, value: u32) {
        if let Some(place) = history_word(word) {
            // SAFETY: within the array, and only the one of the tick writes; volatile, because it is read after a reset.
            unsafe { place.write_volatile(value) };
        }
    }
}

impl CrashMemory for NoInitMemory {
    fn keep(&mut self, sealed: &[u8; SEALED_BYTES]) {
        write(sealed);
    }
}

/// Vents and remembers what struck. The caller must not return to the program.
pub fn vent_and_remember(crash: Fault) {
    cortex_m::interrupt::disable();
    vent();
    let record = read().map(|crash_record| crash_record.record).unwrap_or_default();
    write(&CrashRecord { record, crash: Some(crash) }.encode());
}

/// Vents, remembers, and starts again: the next start tells.
pub fn crash(crash: Fault) -> ! {
    vent_and_remember(crash);
    cortex_m::peripheral::SCB::sys_reset()
}
