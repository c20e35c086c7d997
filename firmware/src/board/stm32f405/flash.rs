//! Internal flash behind embedded-storage's [`NorFlash`]: the controller's sequences (RM0090 section 3.6), with every wait bounded.
//!
//! While a sector is erased or a word is programmed, the processor stops at its next instruction from flash, interrupts included: two seconds
//! for a sector at worst. That is why the link writes flash only while vented and the watchdog is long then.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

use super::clock::wait;
use super::facts::SECTOR_BYTES;
use crate::storage::MappedFlash;

/// Bits of the status register FLASH_SR (RM0090 section 3.9.4).
pub mod status {
    /// An operation is under way.
    pub const BUSY: u32 = 1 << 16;
    /// Everything that can go wrong: operation, write protection, alignment, parallelism, sequence.
    pub const ERRORS: u32 = (1 << 1) | (1 << 4) | (1 << 5) | (1 << 6) | (1 << 7);
}

/// Bits of the control register FLASH_CR (RM0090 section 3.9.5).
pub mod control {
    /// Programming.
    pub const PROGRAM: u32 = 1;
    /// Erasing a sector.
    pub const SECTOR_ERASE: u32 = 1 << 1;
    /// Position of the sector's number.
    pub const SECTOR_SHIFT: u32 = 3;
    /// 32 bits at once, which needs 2.7 V at least.
    pub const BY_WORDS: u32 = 2 << 8;
    /// Begin.
    pub const START: u32 = 1 << 16;
    /// The register is locked.
    pub const LOCK: u32 = 1 << 31;
}

/// The two words that unlock the control register (RM0090 section 3.6.1).
pub const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];

/// Bytes of a sector, as an offset.
#[expect(clippy::cast_possible_truncation, reason = "128 KiB")]
const SECTOR: u32 = SECTOR_BYTES as u32;

/// Polls of the status: the processor stops during an operation, so the first poll comes when it is over. The bound is for a controller
/// that never finishes.
const POLLS: u32 = 100_000;

/// The controller's registers and the memory behind them.
pub trait FlashController {
    /// The status register.
    fn status(&mut self) -> u32;
    /// Clears flags of the status register by writing ones.
    fn clear_status(&mut self, flags: u32);
    /// Writes one of the keys.
    fn write_key(&mut self, key: u32);
    /// The control register.
    fn control(&mut self) -> u32;
    /// Writes the control register.
    fn set_control(&mut self, bits: u32);
    /// Writes a word to flash.
    fn write_word(&mut self, address: u32, word: u32);
    /// Empties the caches, which still hold what was there before (RM0090 section 3.5.2).
    fn flush_caches(&mut self);
    /// The mapped bytes.
    fn mapped(&self, address: u32, length: usize) -> &[u8];
}

/// Why flash could not be changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub enum FlashError {
    /// The control register stays locked.
    Locked,
    /// The controller does not finish.
    Busy,
    /// The controller reports these flags.
    Flags(u32),
    /// Outside the sectors, or off their grid or that of the words.
    Range(#[cfg_attr(target_os = "none", defmt(Debug2Format))] NorFlashErrorKind),
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Range(kind) => *kind,
            _ => NorFlashErrorKind::Other,
        }
    }
}

/// A pair of sectors, as one piece of flash.
#[derive(Debug)]
pub struct InternalFlash<C> {
    controller: C,
    sectors: [(u32, u8); 2],
}

impl<C: FlashController> InternalFlash<C> {
    /// Over two sectors, each with its first address and its number.
    pub const fn new(controller: C, sectors: [(u32, u8); 2]) -> Self {
        Self { controller, sectors }
    }

    /// First address and number of the sector at this offset, and the offset in it.
    fn sector(&self, offset: u32) -> (u32, u8, u32) {
        let [(first, first_number), (second, second_number)] = self.sectors;
        match offset.checked_sub(SECTOR) {
            None => (first, first_number, offset),
            Some(offset) => (second, second_number, offset),
        }
    }

    /// Unlocks, does one operation, locks again.
    fn operate(&mut self, operation: impl FnOnce(&mut C)) -> Result<(), FlashError> {
        let controller = &mut self.controller;
        if !wait(POLLS, || controller.status() & status::BUSY == 0) {
            return Err(FlashError::Busy);
        }
        if controller.control() & control::LOCK != 0 {
            KEYS.into_iter().for_each(|key| controller.write_key(key));
        }
        if controller.control() & control::LOCK != 0 {
            return Err(FlashError::Locked);
        }
        // Flags of an operation before would stop this one.
        controller.clear_status(status::ERRORS);
        operation(controller);
        let finished = wait(POLLS, || controller.status() & status::BUSY == 0);
        let flags = controller.status() & status::ERRORS;
        controller.set_control(control::LOCK);
        controller.flush_caches();
        match (finished, flags) {
            (false, _) => Err(FlashError::Busy),
            (true, 0) => Ok(()),
            (true, flags) => Err(FlashError::Flags(flags)),
        }
    }
}

impl<C> ErrorType for InternalFlash<C> {
    type Error = FlashError;
}

impl<C: FlashController> ReadNorFlash for InternalFlash<C> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        check_read(self, offset, bytes.len()).map_err(FlashError::Range)?;
        let offset = usize::try_from(offset).unwrap_or(usize::MAX);
        let pieces = (0..2).flat_map(|sector| self.mapped(sector)).skip(offset);
        bytes.iter_mut().zip(pieces).for_each(|(byte, found)| *byte = *found);
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * SECTOR_BYTES
    }
}

impl<C: FlashController> NorFlash for InternalFlash<C> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR_BYTES;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        check_erase(self, from, to).map_err(FlashError::Range)?;
        for offset in (from..to).step_by(SECTOR_BYTES) {
            let sector = u32::from(self.sector(offset).1) << control::SECTOR_SHIFT;
            self.operate(|controller| {
                let bits = control::BY_WORDS | control::SECTOR_ERASE | sector;
                controller.set_control(bits);
                controller.set_control(bits | control::START);
            })?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        check_write(self, offset, bytes.len()).map_err(FlashError::Range)?;
        for (offset, word) in (offset..).step_by(4).zip(bytes.as_chunks::<4>().0) {
            let (first, _, within) = self.sector(offset);
            self.operate(|controller| {
                controller.set_control(control::BY_WORDS | control::PROGRAM);
                controller.write_word(first + within, u32::from_le_bytes(*word));
            })?;
        }
        Ok(())
    }
}

impl<C: FlashController> MappedFlash for InternalFlash<C> {
    fn mapped(&self, sector: usize) -> &[u8] {
        self.sectors.get(sector).map_or(&[], |(first, _)| self.controller.mapped(*first, SECTOR_BYTES))
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec;
    use std::vec::Vec;

    use super::*;
    use crate::storage::{Flash as _, SectorError, Sectors, Slot, Store};

    const SECTORS: [(u32, u8); 2] = super::super::facts::SETTINGS_SECTORS;

    /// The controller of RM0090 section 3.6 over two sectors of memory.
    struct Controller {
        memory: Vec<u8>,
        control: u32,
        keys: Vec<u32>,
        flags: u32,
        busy_polls: u32,
        never_finishes: bool,
        wear: u32,
        stale: bool,
    }

    impl Controller {
        fn new() -> Self {
            let memory = vec![0; 2 * SECTOR_BYTES];
            Self { memory, control: control::LOCK, keys: Vec::new(), flags: 0, busy_polls: 0, never_finishes: false, wear: 0, stale: false }
        }
    }

    impl FlashController for Controller {
        fn status(&mut self) -> u32 {
            self.busy_polls = self.busy_polls.saturating_sub(u32::from(!self.never_finishes));
            self.flags | if self.busy_polls > 0 { status::BUSY } else { 0 }
        }
        fn clear_status(&mut self, flags: u32) {
            self.flags &= !flags;
        }
        fn write_key(&mut self, key: u32) {
            self.keys.push(key);
            if self.keys == KEYS {
                self.control &= !control::LOCK;
            }
        }
        fn control(&mut self) -> u32 {
            self.control
        }
        fn set_control(&mut self, bits: u32) {
            assert_eq!(self.control & control::LOCK, 0, "the register is locked");
            self.control = bits;
            if bits & control::LOCK != 0 {
                self.keys.clear();
            }
            if bits & control::START != 0 {
                assert_ne!(bits & control::SECTOR_ERASE, 0);
                let number = (bits >> control::SECTOR_SHIFT) & 0xf;
                let at = SECTORS.iter().position(|sector| u32::from(sector.1) == number).expect("one of the two sectors") * SECTOR_BYTES;
                self.memory[at..at + SECTOR_BYTES].fill(0xff);
                (self.busy_polls, self.stale) = (50, true);
            }
        }
        fn write_word(&mut self, address: u32, word: u32) {
            assert_ne!(self.control & control::PROGRAM, 0);
            assert_eq!(self.control & (3 << 8), control::BY_WORDS);
            let at = usize::try_from(address - SECTORS[0].0).unwrap();
            self.memory[at..at + 4].iter_mut().zip(word.to_le_bytes()).for_each(|(old, new)| *old &= new);
            (self.busy_polls, self.stale) = (3, true);
            self.flags |= self.wear;
        }
        fn flush_caches(&mut self) {
            self.stale = false;
        }
        fn mapped(&self, address: u32, length: usize) -> &[u8] {
            assert!(!self.stale, "the caches hold what was there before");
            &self.memory[usize::try_from(address - SECTORS[0].0).unwrap()..][..length]
        }
    }

    #[test]
    fn a_store_over_the_controller_keeps_what_it_saved_and_leaves_it_locked() {
        let mut store = Store::new(Sectors::new(InternalFlash::new(Controller::new(), SECTORS)), 1, 1);
        for payload in [&b"the first"[..], b"the second one", b"a third"] {
            store.save(payload).unwrap();
            assert_eq!(store.active_payload(), Some(payload));
        }
        assert_eq!(store.release().release().controller.control & control::LOCK, control::LOCK);
    }

    #[test]
    fn a_controller_that_never_finishes_or_reports_an_error_is_an_error() {
        let mut flash = InternalFlash::new(Controller { never_finishes: true, ..Controller::new() }, SECTORS);
        assert_eq!(flash.erase(0, SECTOR), Err(FlashError::Busy));
        let mut flash = InternalFlash::new(Controller { wear: 1 << 4, ..Controller::new() }, SECTORS);
        assert_eq!(flash.write(SECTOR + 8, &[7; 4]), Err(FlashError::Flags(1 << 4)));
        // The flag does not stop the next operation.
        assert_eq!(flash.erase(SECTOR, 2 * SECTOR), Ok(()));
    }

    #[test]
    fn what_is_in_use_cannot_be_changed_and_nothing_outside_a_slot_can() {
        let mut flash = Sectors::new(InternalFlash::new(Controller::new(), SECTORS));
        flash.hold(Some(Slot::B));
        assert_eq!((flash.erase(Slot::B), flash.program(Slot::B, 0, 0)), (Err(SectorError::InUse), Err(SectorError::InUse)));
        assert_eq!(flash.erase(Slot::A), Ok(()));
        assert!(flash.contents(Slot::A).iter().all(|byte| *byte == 0xff) && flash.contents(Slot::B).iter().all(|byte| *byte == 0));
        flash.hold(None);
        assert_eq!(flash.erase(Slot::B), Ok(()));
        for offset in [SECTOR, u32::MAX - 3, 2] {
            assert!(matches!(flash.program(Slot::A, offset, 0), Err(SectorError::Flash(FlashError::Range(_)))), "{offset}");
        }
        assert_eq!(flash.program(Slot::B, SECTOR - 4, 0), Ok(()));
        assert!(flash.contents(Slot::A).iter().all(|byte| *byte == 0xff));
        assert_eq!(flash.contents(Slot::B).last_chunk(), Some(&[0; 4]));
    }

    #[test]
    fn words_and_reads_run_from_one_sector_into_the_other_and_not_beyond() {
        let mut flash = InternalFlash::new(Controller::new(), SECTORS);
        flash.erase(0, 2 * SECTOR).unwrap();
        flash.write(SECTOR - 4, &[1, 2, 3, 4, 5, 6, 7, 8]).unwrap();
        let mut bytes = [0; 10];
        flash.read(SECTOR - 5, &mut bytes).unwrap();
        assert_eq!(bytes, [0xff, 1, 2, 3, 4, 5, 6, 7, 8, 0xff]);
        assert_eq!(flash.erase(4, SECTOR), Err(FlashError::Range(NorFlashErrorKind::NotAligned)));
        assert_eq!(flash.erase(SECTOR, 3 * SECTOR), Err(FlashError::Range(NorFlashErrorKind::OutOfBounds)));
        assert_eq!(flash.read(2 * SECTOR - 1, &mut bytes), Err(FlashError::Range(NorFlashErrorKind::OutOfBounds)));
    }
}
