//! Internal flash behind [`Flash`]: the controller's sequences (RM0433 section 4.3.9 and 4.3.10), with every wait bounded.
//!
//! Models and settings lie in bank 2, so the processor runs on from bank 1 while they change. Flash is programmed in words of 256 bits with a
//! code that corrects errors, each of them once between two erases; so words of 32 bits are collected until there are eight.

use core::cell::Cell;

use super::facts::SECTOR_BYTES;
use crate::board::clock::wait;
use crate::storage::{Flash, Slot};

/// Bits of the status register FLASH_SR2, and of FLASH_CCR2, which clears them (RM0433 sections 4.9.26 and 4.9.27).
pub mod status {
    /// An operation is under way, data wait for their word to be full, or an operation is queued.
    pub const BUSY: u32 = 0b111;
    /// Everything that can go wrong: write protection, sequence, strobe, inconsistency, operation, read protection, double error.
    pub const ERRORS: u32 = (1 << 17) | (1 << 18) | (1 << 19) | (1 << 21) | (1 << 22) | (1 << 23) | (1 << 24) | (1 << 26);
}

/// Bits of the control register FLASH_CR2 (RM0433 section 4.9.25).
pub mod control {
    /// The register is locked.
    pub const LOCK: u32 = 1;
    /// Programming.
    pub const PROGRAM: u32 = 1 << 1;
    /// Erasing a sector.
    pub const SECTOR_ERASE: u32 = 1 << 2;
    /// 64 bits at once.
    pub const PARALLEL: u32 = 3 << 4;
    /// Begin.
    pub const START: u32 = 1 << 7;
    /// Position of the sector's number.
    pub const SECTOR_SHIFT: u32 = 8;
}

/// The two words that unlock the control register (RM0433 section 4.5.1).
pub const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];
/// Words of 32 bits that are programmed at once.
pub const WORDS: usize = 8;
const WORD_BYTES: u32 = 4;
/// Polls for a word, 0.5 ms at most (DS12110 table 140), and for a sector, 2 s at most; a poll takes ten cycles of 400 MHz at least.
const WORD_POLLS: u32 = 100_000;
const SECTOR_POLLS: u32 = 200_000_000;

/// The controller's registers and the memory behind them.
pub trait FlashController {
    /// The status register.
    fn status(&mut self) -> u32;
    /// Clears flags of the status register.
    fn clear_status(&mut self, flags: u32);
    /// Writes one of the keys.
    fn write_key(&mut self, key: u32);
    /// The control register.
    fn control(&mut self) -> u32;
    /// Writes the control register.
    fn set_control(&mut self, bits: u32);
    /// Writes the words of a flash word, one after the other.
    fn write_words(&mut self, address: u32, words: &[u32; WORDS]);
    /// Empties the data cache, which still holds what was there before.
    fn flush_caches(&mut self);
    /// The mapped bytes.
    fn mapped(&self, address: u32, length: usize) -> &[u8];
}

/// Why flash could not be changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FlashError {
    /// The control register stays locked.
    Locked,
    /// The controller does not finish.
    Busy,
    /// The controller reports these flags.
    Flags(u32),
    /// The slot's model is in use.
    InUse,
    /// Outside the slot, or not the next word of a flash word that was begun.
    Range,
}

/// A flash word that is not full yet.
#[derive(Clone, Copy, Debug)]
struct Pending {
    slot: Slot,
    offset: u32,
    words: [u32; WORDS],
    filled: usize,
}

/// A pair of sectors.
#[derive(Debug)]
pub struct InternalFlash<C> {
    controller: C,
    sectors: [(u32, u8); 2],
    in_use: Cell<Option<Slot>>,
    pending: Option<Pending>,
}

impl<C: FlashController> InternalFlash<C> {
    /// Over two sectors of bank 2, each with its first address and its number.
    pub const fn new(controller: C, sectors: [(u32, u8); 2]) -> Self {
        Self { controller, sectors, in_use: Cell::new(None), pending: None }
    }

    fn sector(&self, slot: Slot) -> (u32, u8) {
        let [a, b] = self.sectors;
        match slot {
            Slot::A => a,
            Slot::B => b,
        }
    }

    /// Unlocks, does one operation, locks again.
    fn operate(&mut self, slot: Slot, polls: u32, operation: impl FnOnce(&mut C)) -> Result<(), FlashError> {
        if self.in_use.get() == Some(slot) {
            return Err(FlashError::InUse);
        }
        let controller = &mut self.controller;
        if !wait(WORD_POLLS, || controller.status() & status::BUSY == 0) {
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
        let finished = wait(polls, || controller.status() & status::BUSY == 0);
        let flags = controller.status() & status::ERRORS;
        controller.set_control(control::PARALLEL);
        controller.set_control(control::PARALLEL | control::LOCK);
        controller.flush_caches();
        match (finished, flags) {
            (false, _) => Err(FlashError::Busy),
            (true, 0) => Ok(()),
            (true, flags) => Err(FlashError::Flags(flags)),
        }
    }
}

impl<C: FlashController> Flash for InternalFlash<C> {
    type Error = FlashError;

    const PROGRAM_WORDS: u32 = 8;

    fn hold(&self, slot: Option<Slot>) {
        self.in_use.set(slot);
    }

    fn contents(&self, slot: Slot) -> &[u8] {
        self.controller.mapped(self.sector(slot).0, SECTOR_BYTES)
    }

    fn erase(&mut self, slot: Slot) -> Result<(), FlashError> {
        self.pending = None;
        let sector = u32::from(self.sector(slot).1) << control::SECTOR_SHIFT;
        self.operate(slot, SECTOR_POLLS, |controller| {
            let bits = control::PARALLEL | control::SECTOR_ERASE | sector;
            controller.set_control(bits);
            controller.set_control(bits | control::START);
        })
    }

    fn program(&mut self, slot: Slot, offset: u32, word: u32) -> Result<(), FlashError> {
        let within = usize::try_from(offset).is_ok_and(|offset| offset < SECTOR_BYTES) && offset.is_multiple_of(WORD_BYTES);
        if !within {
            return Err(FlashError::Range);
        }
        let unit_bytes = WORD_BYTES * Self::PROGRAM_WORDS;
        let begun = Pending { slot, offset, words: [u32::MAX; WORDS], filled: 0 };
        let mut pending = match self.pending.take() {
            Some(pending)
                if pending.slot == slot
                    && u32::try_from(pending.filled).is_ok_and(|filled| pending.offset + WORD_BYTES * filled == offset) =>
            {
                pending
            }
            _ if offset.is_multiple_of(unit_bytes) => begun,
            _ => return Err(FlashError::Range),
        };
        let Some(place) = pending.words.get_mut(pending.filled) else { return Err(FlashError::Range) };
        *place = word;
        pending.filled += 1;
        if pending.filled < WORDS {
            self.pending = Some(pending);
            return Ok(());
        }
        if pending.words == [u32::MAX; WORDS] {
            // What is erased stays so, and can be programmed later.
            return Ok(());
        }
        let address = self.sector(slot).0 + pending.offset;
        self.operate(slot, WORD_POLLS, |controller| {
            controller.set_control(control::PARALLEL | control::PROGRAM);
            controller.write_words(address, &pending.words);
        })
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::collections::HashSet;
    use std::vec;
    use std::vec::Vec;

    use super::*;
    use crate::storage::Store;

    const SECTORS: [(u32, u8); 2] = super::super::facts::SETTINGS_SECTORS;

    /// The controller of RM0433 section 4.3 over two sectors of memory.
    struct Controller {
        memory: Vec<u8>,
        programmed: HashSet<u32>,
        control: u32,
        keys: Vec<u32>,
        flags: u32,
        busy_polls: u32,
        never_finishes: bool,
        wear: u32,
        stale: bool,
        operations: u32,
        cut: Option<Cut>,
        has_power: bool,
    }

    /// Power goes in the middle of this operation: of what it changes, these bits of every word are done.
    #[derive(Clone, Copy, Debug)]
    struct Cut {
        operation: u32,
        done: [u32; WORDS],
    }

    impl Controller {
        fn new() -> Self {
            let memory = vec![0xff; 2 * SECTOR_BYTES];
            let programmed = HashSet::new();
            Self {
                memory,
                programmed,
                control: control::LOCK,
                keys: Vec::new(),
                flags: 0,
                busy_polls: 0,
                never_finishes: false,
                wear: 0,
                stale: false,
                operations: 0,
                cut: None,
                has_power: true,
            }
        }

        /// The bits that the operation that begins now may change.
        fn power(&mut self) -> [u32; WORDS] {
            if !self.has_power {
                return [0; WORDS];
            }
            self.operations += 1;
            match self.cut {
                Some(cut) if cut.operation == self.operations => {
                    self.has_power = false;
                    cut.done
                }
                _ => [u32::MAX; WORDS],
            }
        }

        /// After the power is back.
        fn started_again(self) -> Self {
            Self { memory: self.memory, programmed: self.programmed, ..Self::new() }
        }

        fn change(&mut self, at: usize, words: &[u32; WORDS], done: [u32; WORDS]) {
            for ((place, word), done) in self.memory[at..at + 32].as_chunks_mut::<4>().0.iter_mut().zip(words).zip(done) {
                *place = (u32::from_le_bytes(*place) & !done | word & done).to_le_bytes();
            }
        }
    }

    impl FlashController for Controller {
        fn status(&mut self) -> u32 {
            self.busy_polls = self.busy_polls.saturating_sub(u32::from(!self.never_finishes));
            self.flags | if self.busy_polls > 0 { 1 } else { 0 }
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
                let number = (bits >> control::SECTOR_SHIFT) & 7;
                let at = SECTORS.iter().position(|sector| u32::from(sector.1) == number).expect("one of the two sectors") * SECTOR_BYTES;
                let done = self.power();
                for word in (at..at + SECTOR_BYTES).step_by(32) {
                    self.change(word, &[u32::MAX; WORDS], done);
                }
                if !self.has_power {
                    return;
                }
                let erased = u32::try_from(at).unwrap()..u32::try_from(at + SECTOR_BYTES).unwrap();
                self.programmed.retain(|at| !erased.contains(at));
                (self.busy_polls, self.stale) = (50, true);
            }
        }
        fn write_words(&mut self, address: u32, words: &[u32; WORDS]) {
            assert_ne!(self.control & control::PROGRAM, 0);
            assert!(address.is_multiple_of(32));
            let at = usize::try_from(address - SECTORS[0].0).unwrap();
            // A second time would leave a code that fits neither (RM0433 section 4.3.9).
            assert!(!self.has_power || self.programmed.insert(u32::try_from(at).unwrap()), "{address:#x} is programmed twice");
            let done = self.power();
            self.change(at, words, done);
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
    fn a_store_keeps_what_it_saved_and_programs_every_flash_word_once() {
        let mut store = Store::new(InternalFlash::new(Controller::new(), SECTORS), 1, 1);
        // More often than a log has entries, with lengths that fill no flash word.
        for number in 0..40u8 {
            let payload = vec![number; 1 + 7 * usize::from(number)];
            store.save(&payload).unwrap();
            assert_eq!(store.active_payload(), Some(&payload[..]));
            assert!(!store.select().is_damaged, "{number}");
        }
        // Back and forth fills the logs, and ends in the error that says so.
        let mut activations = 0;
        while let Some(slot) = store.inactive_whole() {
            if store.activate(slot).is_err() {
                break;
            }
            activations += 1;
        }
        assert!(activations >= 14, "{activations}");
        assert_eq!(store.flash().controller.control & control::LOCK, control::LOCK);
    }

    /// Every operation of a save, and every way a word of 256 bits or an erase can stay half done that still reads. One that the chip refuses to
    /// read is a hard fault, which no code here sees.
    #[test]
    fn a_power_cut_at_any_flash_word_of_a_save_leaves_the_old_or_the_new() {
        let (old, new) = ([7u8; 331], [9u8; 305]);
        let mut chance = crate::parity::Noise::new(5);
        let mut random = || [0; WORDS].map(|_: u32| (f64::from(chance.symmetric()) * f64::from(u32::MAX)) as i64 as u32);
        let half = core::array::from_fn(|word| if word < WORDS / 2 { u32::MAX } else { 0 });
        let mut ways: Vec<[u32; WORDS]> = vec![[0; WORDS], [u32::MAX; WORDS], half, half.map(|word| !word), [0x5555_5555; WORDS]];
        ways.extend((0..20).map(|_| random()));
        let before = |rounds| {
            let mut store = Store::new(InternalFlash::new(Controller::new(), SECTORS), 1, 1);
            (0..rounds).for_each(|_| store.save(&old).unwrap());
            store.release().controller.started_again()
        };
        for rounds in 1..=3 {
            let mut whole = Store::new(InternalFlash::new(before(rounds), SECTORS), 1, 1);
            whole.save(&new).unwrap();
            let operations = whole.release().controller.operations;
            assert!(operations > 10, "{operations}");
            let (mut saw_old, mut saw_new) = (false, false);
            for operation in 1..=operations {
                for done in &ways {
                    let mut controller = before(rounds);
                    controller.cut = Some(Cut { operation, done: *done });
                    let mut cut = Store::new(InternalFlash::new(controller, SECTORS), 1, 1);
                    let _ = cut.save(&new);
                    let mut again = Store::new(InternalFlash::new(cut.release().controller.started_again(), SECTORS), 1, 1);
                    let found = again.active_payload().map(<[u8]>::to_vec);
                    let (is_old, is_new) = (found.as_deref() == Some(&old[..]), found.as_deref() == Some(&new[..]));
                    assert!(is_old || is_new, "operation {operation} of {operations}, {done:x?}: neither old nor new");
                    (saw_old, saw_new) = (saw_old | is_old, saw_new | is_new);
                    again.save(&old).unwrap();
                    assert_eq!(again.active_payload(), Some(&old[..]), "and it can be saved again");
                }
            }
            assert!(saw_old && saw_new);
        }
    }

    #[test]
    fn a_controller_that_never_finishes_or_reports_an_error_is_an_error() {
        let mut flash = InternalFlash::new(Controller { wear: 1 << 17, ..Controller::new() }, SECTORS);
        let results: Vec<_> = (0..8).map(|word| flash.program(Slot::B, 32 + 4 * word, 7)).collect();
        assert_eq!(results[6..], [Ok(()), Err(FlashError::Flags(1 << 17))]);
        // The flag does not stop the next operation.
        assert_eq!(flash.erase(Slot::B), Ok(()));
        let mut flash = InternalFlash::new(Controller { never_finishes: true, busy_polls: 1, ..Controller::new() }, SECTORS);
        assert_eq!(flash.erase(Slot::A), Err(FlashError::Busy));
    }

    #[test]
    fn what_is_in_use_cannot_be_changed_and_nothing_outside_a_slot_or_a_flash_word_can() {
        let mut flash = InternalFlash::new(Controller::new(), SECTORS);
        flash.hold(Some(Slot::B));
        assert_eq!((flash.erase(Slot::B), flash.erase(Slot::A)), (Err(FlashError::InUse), Ok(())));
        flash.hold(None);
        assert_eq!(flash.erase(Slot::B), Ok(()));
        for offset in [u32::try_from(SECTOR_BYTES).unwrap(), u32::MAX - 3, 2, 4, 28] {
            assert_eq!(flash.program(Slot::A, offset, 0), Err(FlashError::Range), "{offset}");
        }
    }
}
