//! The brown-out reset's level, which lies in the option bytes and comes from the factory switched off (RM0433 sections 4.4 and 6.5.2).
//!
//! As on the STM32F405 it is the net below the supply monitor. The sequence is another: the bytes in force and those to be programmed have a
//! register each, and a change that the chip does not take is a flag.

use crate::board::clock::wait;
use crate::board::stm32f405::brown_out::Outcome;

/// Bits of FLASH_OPTSR_CUR and FLASH_OPTSR_PRG (RM0433 sections 4.9.8 and 4.9.9).
pub mod status {
    /// A change is under way.
    pub const BUSY: u32 = 1;
    /// The brown-out level: 3 is the highest, 0 is off.
    pub const LEVEL: u32 = 3 << 2;
    /// A change was not taken.
    pub const CHANGE_ERROR: u32 = 1 << 30;
}

/// The two words that unlock the option bytes (RM0433 section 4.5.1).
pub const KEYS: [u32; 2] = [0x0819_2a3b, 0x4c5d_6e7f];
/// Polls for a change: longer than an erase, since the chip erases the bytes first.
const POLLS: u32 = 20_000_000;

/// The option bytes' registers.
pub trait OptionBytes {
    /// FLASH_OPTSR_CUR.
    fn in_force(&mut self) -> u32;
    /// FLASH_OPTSR_PRG, which begins with what is in force.
    fn wanted(&mut self) -> u32;
    /// Writes it.
    fn set_wanted(&mut self, bits: u32);
    /// Whether both are locked.
    fn is_locked(&mut self) -> bool;
    /// Writes one of the keys.
    fn write_key(&mut self, key: u32);
    /// Begins a change.
    fn start(&mut self);
    /// Locks them again.
    fn lock(&mut self);
}

/// Sets the highest level, and touches nothing else: least of all the read protection.
pub fn ensure(bytes: &mut impl OptionBytes) -> Outcome {
    if bytes.in_force() & status::LEVEL == status::LEVEL {
        return Outcome::Kept;
    }
    if !wait(POLLS, || bytes.in_force() & status::BUSY == 0) {
        return Outcome::Refused;
    }
    KEYS.into_iter().for_each(|key| bytes.write_key(key));
    if bytes.is_locked() {
        return Outcome::Refused;
    }
    let others = !(status::LEVEL | status::BUSY | status::CHANGE_ERROR);
    let wanted = bytes.wanted() | status::LEVEL;
    bytes.set_wanted(wanted);
    // Nothing but the level may change.
    let is_sound = (bytes.wanted() ^ bytes.in_force()) & others == 0;
    if is_sound {
        bytes.start();
    }
    let finished = wait(POLLS, || bytes.in_force() & status::BUSY == 0);
    bytes.lock();
    let after = bytes.in_force();
    let is_set = after & status::LEVEL == status::LEVEL && after & status::CHANGE_ERROR == 0;
    if is_sound && finished && is_set { Outcome::Programmed } else { Outcome::Refused }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The registers of RM0433 section 4.9, and the bytes behind them.
    struct Registers {
        in_force: u32,
        wanted: u32,
        locked: bool,
        keys: [u32; 2],
        busy_polls: u32,
        changes: u32,
        opens: bool,
        takes: bool,
    }

    impl Registers {
        fn new(bytes: u32) -> Self {
            Self { in_force: bytes, wanted: bytes, locked: true, keys: [0; 2], busy_polls: 0, changes: 0, opens: true, takes: true }
        }
    }

    impl OptionBytes for Registers {
        fn in_force(&mut self) -> u32 {
            self.busy_polls = self.busy_polls.saturating_sub(1);
            self.in_force | u32::from(self.busy_polls > 0)
        }
        fn wanted(&mut self) -> u32 {
            self.wanted
        }
        fn set_wanted(&mut self, bits: u32) {
            assert!(!self.locked);
            self.wanted = bits;
        }
        fn is_locked(&mut self) -> bool {
            self.locked
        }
        fn write_key(&mut self, key: u32) {
            self.keys = [self.keys[1], key];
            self.locked = !(self.keys == KEYS && self.opens);
        }
        fn start(&mut self) {
            assert!(!self.locked);
            self.changes += 1;
            self.busy_polls = 20;
            self.in_force = if self.takes { self.wanted } else { self.in_force | status::CHANGE_ERROR };
        }
        fn lock(&mut self) {
            self.locked = true;
        }
    }

    /// As from the factory (RM0433 table 21): brown-out reset off, no protection.
    const FACTORY: u32 = 0x1406_aaf0;

    #[test]
    fn the_factorys_level_is_raised_once_and_nothing_else_changes() {
        let mut registers = Registers::new(FACTORY);
        assert_eq!(ensure(&mut registers), Outcome::Programmed);
        assert_eq!((registers.in_force, registers.locked), (FACTORY | status::LEVEL, true));
        assert_eq!((ensure(&mut registers), registers.changes), (Outcome::Kept, 1));
    }

    #[test]
    fn bytes_that_stay_locked_or_refuse_the_change_are_refused() {
        let mut locked = Registers { opens: false, ..Registers::new(FACTORY) };
        assert_eq!((ensure(&mut locked), locked.in_force, locked.changes), (Outcome::Refused, FACTORY, 0));
        let mut stubborn = Registers { takes: false, ..Registers::new(FACTORY) };
        assert_eq!(ensure(&mut stubborn), Outcome::Refused);
        // Somebody else's change is under way in the programming register: it is not ours to start.
        let mut foreign = Registers { wanted: FACTORY ^ 1 << 8, ..Registers::new(FACTORY) };
        assert_eq!((ensure(&mut foreign), foreign.changes), (Outcome::Refused, 0));
    }
}
