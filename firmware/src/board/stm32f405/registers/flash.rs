//! The flash controller's registers (RM0090 section 3.9).

use core::ptr;

use stm32f4::stm32f405::FLASH;

use super::sampling::Milliseconds;
use crate::board::shared_atomics::SharedAtomics;
use crate::board::stm32f405::brown_out::OptionBytes;
use crate::board::stm32f405::flash::{FlashController, control};
use crate::board::target::protection;

/// The controller. Both pairs of slots have one; they run in the background only, one operation at a time.
#[derive(Debug)]
pub struct Controller {
    clock: Milliseconds,
    shared: &'static SharedAtomics,
}

impl Controller {
    /// A controller that books the time in which the processor stood still.
    ///
    /// # Safety
    /// All controllers must be used from one context that does not interrupt itself.
    pub const unsafe fn new(clock: Milliseconds, shared: &'static SharedAtomics) -> Self {
        Self { clock, shared }
    }

    fn registers(&self) -> &stm32f4::stm32f405::flash::RegisterBlock {
        // SAFETY: the registers exist for ever; nobody else writes to them after the clock has started, by the contract of `new`.
        unsafe { &*FLASH::ptr() }
    }
}

impl FlashController for Controller {
    fn status(&mut self) -> u32 {
        self.registers().sr().read().bits()
    }

    fn clear_status(&mut self, flags: u32) {
        // SAFETY: writing ones clears flags and does nothing else.
        self.registers().sr().write(|w| unsafe { w.bits(flags) });
    }

    fn write_key(&mut self, key: u32) {
        // SAFETY: one of the two keys.
        self.registers().keyr().write(|w| unsafe { w.bits(key) });
    }

    fn control(&mut self) -> u32 {
        self.registers().cr().read().bits()
    }

    fn set_control(&mut self, bits: u32) {
        let before_ms = self.clock.now();
        // SAFETY: a value of the sequences in `board::flash`, which touch their own sectors only.
        self.registers().cr().write(|w| unsafe { w.bits(bits) });
        if bits & control::START != 0 {
            // Wait here, so that the time is booked where it passed. Only one of the lost SysTick interrupts is pending.
            while_busy(self.registers());
            self.shared.add_periods(self.clock.now().wrapping_sub(before_ms).saturating_sub(1));
        }
    }

    fn write_word(&mut self, address: u32, word: u32) {
        // SAFETY: the address is a word of a slot's sector, by the check in `InternalFlash::write`; no reference into that sector is
        // alive, since the driver is borrowed mutably and what is lent out is held.
        // The controller runs in the background alone, by the contract of `new`.
        unsafe { protection::while_writable(|| ptr::with_exposed_provenance_mut::<u32>(address as usize).write_volatile(word)) };
    }

    fn flush_caches(&mut self) {
        let acr = self.registers().acr();
        let before = acr.read();
        acr.modify(|_, w| w.icen().clear_bit().dcen().clear_bit());
        acr.modify(|_, w| w.icrst().set_bit().dcrst().set_bit());
        acr.modify(|_, w| w.icrst().clear_bit().dcrst().clear_bit());
        acr.modify(|_, w| w.icen().bit(before.icen().bit()).dcen().bit(before.dcen().bit()));
    }

    fn mapped(&self, address: u32, length: usize) -> &[u8] {
        // SAFETY: flash is mapped and readable for ever, and changes only through `write_word` and `set_control`, which borrow mutably.
        unsafe { core::slice::from_raw_parts(ptr::with_exposed_provenance::<u8>(address as usize), length) }
    }
}

fn while_busy(registers: &stm32f4::stm32f405::flash::RegisterBlock) {
    // The processor stops at an instruction from flash anyway; the bound is for a controller that never finishes.
    crate::board::clock::wait(1_000_000, || registers.sr().read().bsy().bit_is_clear());
}

impl OptionBytes for &FLASH {
    fn is_busy(&mut self) -> bool {
        self.sr().read().bsy().bit_is_set()
    }

    fn control(&mut self) -> u32 {
        self.optcr().read().bits()
    }

    fn set_control(&mut self, bits: u32) {
        // SAFETY: a value of the sequence in `board::brown_out`, which keeps every field but the level.
        self.optcr().write(|w| unsafe { w.bits(bits) });
    }

    fn write_key(&mut self, key: u32) {
        // SAFETY: one of the two keys.
        self.optkeyr().write(|w| unsafe { w.bits(key) });
    }
}
