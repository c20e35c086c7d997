//! The way down: vent first, then write into memory that survives what struck, then start again.

use core::mem::MaybeUninit;

use model_export::link::fault::Fault;
use stm32f4::stm32f405::{DAC, TIM3};

use crate::board::chip::pins;
use crate::board::tick_task::RecordKeeper;
use crate::retain::{Retained, SEALED_BYTES};

/// The record in memory that start-up code neither loads nor clears.
#[unsafe(link_section = ".uninit.retained")]
static mut RETAINED: MaybeUninit<[u8; SEALED_BYTES]> = MaybeUninit::uninit();

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
fn read() -> Option<Retained> {
    let bytes = (&raw const RETAINED).cast::<u8>();
    let mut sealed = [0; SEALED_BYTES];
    for (index, byte) in sealed.iter_mut().enumerate() {
        // SAFETY: within the array. RAM always holds some bytes, and every byte is valid; volatile, so that the compiler does not reason
        // about where they came from.
        *byte = unsafe { bytes.add(index).read_volatile() };
    }
    Retained::open(&sealed)
}

/// What the run before left; afterwards it is gone.
pub fn take() -> Option<Retained> {
    let retained = read();
    write(&[0; SEALED_BYTES]);
    retained
}

/// Keeps the tick's record.
#[derive(Debug)]
pub struct Keeper(());

impl Keeper {
    /// # Safety
    /// One keeper for the whole program, in the tick.
    pub const unsafe fn new() -> Self {
        Self(())
    }
}

impl RecordKeeper for Keeper {
    fn keep(&mut self, sealed: &[u8; SEALED_BYTES]) {
        write(sealed);
    }
}

/// Releases the dump valve and takes the drive to zero, whoever owns them.
pub fn vent() {
    pins::release_dump_valve();
    // SAFETY: single writes that any owner may find done; the program ends after this.
    unsafe {
        (*DAC::ptr()).dhr12r1().write(|w| w.bits(0));
        (*TIM3::ptr()).ccr1().write(|w| w.bits(0));
    }
}

/// Vents and remembers what struck. The caller must not return to the program.
pub fn vent_and_remember(crash: Fault) {
    cortex_m::interrupt::disable();
    vent();
    let record = read().map(|retained| retained.record).unwrap_or_default();
    write(&Retained { record, crash: Some(crash) }.seal());
}

/// Vents, remembers, and starts again: the next start tells.
pub fn crash(crash: Fault) -> ! {
    vent_and_remember(crash);
    cortex_m::peripheral::SCB::sys_reset()
}
