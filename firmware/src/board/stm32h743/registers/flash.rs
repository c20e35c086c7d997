//! The flash controller's registers, those of bank 2 (RM0433 section 4.9).

use core::ptr;

use cortex_m::peripheral::SCB;
use stm32h7::stm32h743v::FLASH;
use stm32h7::stm32h743v::flash::BANK;

use crate::board::shared_atomics::SharedAtomics;
use crate::board::stm32h743::brown_out::OptionBytes;
use crate::board::stm32h743::flash::{FlashController, WORDS};
use crate::board::target::protection;

/// The controller. Both pairs of slots have one; they run in the background only, one operation at a time.
#[derive(Debug)]
pub struct Controller {
    shared: &'static SharedAtomics,
}

impl Controller {
    /// A controller.
    ///
    /// # Safety
    /// All controllers must be used from one context that does not interrupt itself.
    pub const unsafe fn new(shared: &'static SharedAtomics) -> Self {
        Self { shared }
    }

    fn bank(&self) -> &BANK {
        // SAFETY: the registers exist for ever; nobody else writes to this bank's, by the contract of `new`.
        unsafe { (*FLASH::ptr()).bank2() }
    }
}

impl OptionBytes for &FLASH {
    fn in_force(&mut self) -> u32 {
        self.optsr_cur().read().bits()
    }

    fn wanted(&mut self) -> u32 {
        self.optsr_prg().read().bits()
    }

    fn set_wanted(&mut self, bits: u32) {
        // SAFETY: what is in force with another brown-out level, by the sequence in `stm32h743::brown_out`.
        self.optsr_prg().write(|w| unsafe { w.bits(bits) });
    }

    fn is_locked(&mut self) -> bool {
        self.optcr().read().bits() & 1 != 0
    }

    fn write_key(&mut self, key: u32) {
        // SAFETY: one of the two keys.
        self.optkeyr().write(|w| unsafe { w.bits(key) });
    }

    fn start(&mut self) {
        // SAFETY: OPTSTART (RM0433 section 4.9.7).
        self.optcr().modify(|r, w| unsafe { w.bits(r.bits() | 1 << 1) });
    }

    fn lock(&mut self) {
        // SAFETY: OPTLOCK.
        self.optcr().modify(|r, w| unsafe { w.bits(r.bits() | 1) });
    }
}

impl FlashController for Controller {
    fn status(&mut self) -> u32 {
        // The processor runs on from the other bank, so ticks go on while the background waits here: it lives.
        self.shared.show_life();
        self.bank().sr().read().bits()
    }

    fn clear_status(&mut self, flags: u32) {
        // SAFETY: writing ones clears flags and does nothing else.
        self.bank().ccr().write(|w| unsafe { w.bits(flags) });
    }

    fn write_key(&mut self, key: u32) {
        // SAFETY: one of the two keys.
        self.bank().keyr().write(|w| unsafe { w.bits(key) });
    }

    fn control(&mut self) -> u32 {
        self.bank().cr().read().bits()
    }

    fn set_control(&mut self, bits: u32) {
        // SAFETY: a value of the sequences in `stm32h743::flash`, which touch their own sectors only.
        self.bank().cr().write(|w| unsafe { w.bits(bits) });
    }

    fn write_words(&mut self, address: u32, words: &[u32; WORDS]) {
        let place = ptr::with_exposed_provenance_mut::<u32>(address as usize);
        let write = || {
            for (index, word) in words.iter().enumerate() {
                // SAFETY: a flash word of a slot's sector, by the check in `InternalFlash::program`; no reference into that sector is alive, since
                // the driver is borrowed mutably and what is lent out is held.
                unsafe { place.add(index).write_volatile(*word) };
            }
        };
        // SAFETY: the controller runs in the background alone, by the contract of `new`.
        unsafe { protection::while_writable(write) };
    }

    fn flush_caches(&mut self) {
        // SAFETY: the registers exist for ever; nothing dirty is lost, because the regions are written through.
        unsafe { cortex_m::Peripherals::steal().SCB.clean_invalidate_dcache(&mut cortex_m::Peripherals::steal().CPUID) };
    }

    fn mapped(&self, address: u32, length: usize) -> &[u8] {
        // SAFETY: flash is mapped and readable for ever, and changes only through `write_words` and `set_control`, which borrow mutably.
        unsafe { core::slice::from_raw_parts(ptr::with_exposed_provenance::<u8>(address as usize), length) }
    }
}

/// Switches both caches on.
pub fn start_caches(scb: &mut SCB, cpuid: &mut cortex_m::peripheral::CPUID) {
    scb.enable_icache();
    scb.enable_dcache(cpuid);
}
