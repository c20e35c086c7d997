//! The brown-out reset's level, which lies in the option bytes and comes from the factory switched off (RM0090 sections 3.7 and 5.2.2).
//!
//! The supply monitor (`chip::supply`) vents in time; this is the net below it: under 2.7 V or so the chip holds itself in reset, and the
//! pull-downs outside vent. Between there and the power-down reset at 1.7 V nothing the chip does would be certain.

use super::clock::wait;

/// Bits of the option control register FLASH_OPTCR (RM0090 section 3.9.6).
pub mod option {
    /// The register is locked.
    pub const LOCK: u32 = 1;
    /// Begin.
    pub const START: u32 = 1 << 1;
    /// The brown-out level: 0 is level 3, the highest; 3 is off.
    pub const LEVEL: u32 = 3 << 2;
    /// Read protection; 0xcc is for ever.
    pub const READ_PROTECTION: u32 = 0xff << 8;
}

/// The two words that unlock the option bytes (RM0090 section 3.7.2).
pub const KEYS: [u32; 2] = [0x0819_2a3b, 0x4c5d_6e7f];
/// Polls for an operation; the processor stands still while it lasts.
const POLLS: u32 = 100_000;

/// The option bytes' registers.
pub trait OptionBytes {
    /// Whether the flash is busy.
    fn is_busy(&mut self) -> bool;
    /// The option control register.
    fn control(&mut self) -> u32;
    /// Writes it.
    fn set_control(&mut self, bits: u32);
    /// Writes one of the keys.
    fn write_key(&mut self, key: u32);
}

/// What became of the level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Outcome {
    /// It was right already.
    Kept,
    /// It is right now, from the next reset on.
    Programmed,
    /// The option bytes cannot be changed.
    Refused,
}

/// Sets the highest level, and touches nothing else: least of all the read protection.
pub fn ensure(bytes: &mut impl OptionBytes) -> Outcome {
    let before = bytes.control();
    if before & option::LEVEL == 0 {
        return Outcome::Kept;
    }
    if !wait(POLLS, || !bytes.is_busy()) {
        return Outcome::Refused;
    }
    KEYS.into_iter().for_each(|key| bytes.write_key(key));
    if bytes.control() & option::LOCK != 0 {
        return Outcome::Refused;
    }
    let wanted = before & !(option::LEVEL | option::LOCK | option::START);
    bytes.set_control(wanted);
    let unchanged = (bytes.control() ^ before) & option::READ_PROTECTION == 0;
    if unchanged {
        bytes.set_control(wanted | option::START);
    }
    let finished = wait(POLLS, || !bytes.is_busy());
    bytes.set_control(wanted | option::LOCK);
    if unchanged && finished && bytes.control() & option::LEVEL == 0 { Outcome::Programmed } else { Outcome::Refused }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The registers of RM0090 section 3.9, and the bytes behind them.
    struct Registers {
        control: u32,
        stored: u32,
        keys: [u32; 2],
        busy: u32,
        programmed: u32,
        opens: bool,
    }

    impl Registers {
        fn new(control: u32) -> Self {
            Self { control: control | option::LOCK, stored: control, keys: [0; 2], busy: 3, programmed: 0, opens: true }
        }
    }

    impl OptionBytes for Registers {
        fn is_busy(&mut self) -> bool {
            self.busy = self.busy.saturating_sub(1);
            self.busy > 0
        }
        fn control(&mut self) -> u32 {
            self.control
        }
        fn set_control(&mut self, bits: u32) {
            assert_eq!(self.control & option::LOCK, 0, "locked");
            assert_eq!(self.busy, 0, "busy");
            self.control = bits;
            if bits & option::START != 0 {
                (self.stored, self.busy) = (bits & !3, 20);
                self.programmed += 1;
            }
        }
        fn write_key(&mut self, key: u32) {
            self.keys = [self.keys[1], key];
            if self.keys == KEYS && self.opens {
                self.control &= !option::LOCK;
            }
        }
    }

    /// As from the factory (RM0090 section 3.9.6): brown-out reset off, no protection.
    const FACTORY: u32 = 0x0fff_aaec;

    #[test]
    fn the_factorys_level_is_raised_once_and_nothing_else_changes() {
        let mut registers = Registers::new(FACTORY);
        assert_eq!(ensure(&mut registers), Outcome::Programmed);
        assert_eq!(registers.stored, FACTORY & !option::LEVEL);
        assert_eq!(registers.control & option::LOCK, option::LOCK);
        assert_eq!((ensure(&mut registers), registers.programmed), (Outcome::Kept, 1), "flash wears");
    }

    #[test]
    fn option_bytes_that_stay_locked_or_never_finish_are_told() {
        let mut locked = Registers { opens: false, ..Registers::new(FACTORY) };
        assert_eq!((ensure(&mut locked), locked.stored), (Outcome::Refused, FACTORY));
        let mut busy = Registers { busy: u32::MAX, ..Registers::new(FACTORY) };
        assert_eq!((ensure(&mut busy), busy.programmed), (Outcome::Refused, 0));
    }
}
