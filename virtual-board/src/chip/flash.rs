//! The flash interface of the STM32F405 (RM0090 chapter 3): one bank, sectors 0 to 11.
//!
//! | register | behaviour | RM0090 |
//! |---|---|---|
//! | ACR | stored | 3.9.1 |
//! | KEYR | KEY1, then KEY2, unlocks CR; anything else locks it until the next reset | 3.6.1, 3.9.2 |
//! | OPTKEYR | OPTKEY1, then OPTKEY2, unlocks OPTCR; anything else locks it until the next reset | 3.7.2, 3.9.3 |
//! | OPTCR | frozen while locked; OPTSTRT programs the option bytes, which count from the next reset on | 3.7.2, 3.9.6 |
//! | SR | BSY while an operation runs; errors stay until they are written with ones; EOP with EOPIE | 3.9.4 |
//! | CR | frozen while locked; SER + SNB + STRT erases a sector; PG lets stores program | 3.6.3, 3.6.4, 3.9.5 |
//! | a store to the array | with PG and the width of PSIZE clears bits; otherwise PGSERR or PGPERR | 3.6.4, 3.9.4 |
//!
//! An operation takes the data sheet's time (DS8626 table 46), and meanwhile the processor stands still, as it does at its next fetch from
//! flash (3.6.3, 3.6.4): the machine sees to both, and changes the array when the time is over. Left out: mass erase, the effect of read
//! and write protection, PGAERR (a store that crosses 128 bits does not exist on a 32-bit bus), the caches.

use std::ops::Range;

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::Width;
use rigless::soc::stm32f427::generated::flash::Register;
use rigless::time::{EventId, VirtualNanos};

use crate::part::Change;

const KEYS: [u64; 2] = [0x4567_0123, 0xcdef_89ab];
const OPTION_KEYS: [u64; 2] = [0x0819_2a3b, 0x4c5d_6e7f];
const OPTLOCK: u64 = 1;
const OPTSTRT: u64 = 1 << 1;
const EOP: u64 = 1;
const OPERR: u64 = 1 << 1;
const WRPERR: u64 = 1 << 4;
const PGPERR: u64 = 1 << 6;
const PGSERR: u64 = 1 << 7;
const BSY: u64 = 1 << 16;
const PG: u64 = 1;
const SER: u64 = 1 << 1;
const STRT: u64 = 1 << 16;
const EOPIE: u64 = 1 << 24;
const ERRIE: u64 = 1 << 25;
const LOCK: u64 = 1 << 31;
/// Sizes of the sectors (RM0090 table 5).
const SECTORS_KIB: [u64; 12] = [16, 16, 16, 16, 64, 128, 128, 128, 128, 128, 128, 128];
/// First address of the array.
pub const ARRAY: u64 = 0x0800_0000;

/// Addresses of a sector.
pub fn sector(number: usize) -> Range<u64> {
    let start = ARRAY + SECTORS_KIB.iter().take(number).sum::<u64>() * 1024;
    start..start + SECTORS_KIB.get(number).copied().unwrap_or_default() * 1024
}

/// How long operations take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Speed {
    /// The data sheet's typical times: a 128 KiB sector by words in 1 s, a word in 16 us.
    #[default]
    Typical,
    /// Its longest times: 2 s and 100 us.
    Slowest,
}

/// The interface.
#[derive(Debug, Default)]
pub struct Flash {
    /// How long operations take.
    pub speed: Speed,
    /// The operation under way, and when it began.
    running: Option<(Change, EventId, VirtualNanos)>,
    finished: Vec<Change>,
    keys: usize,
    barred: bool,
    control: u64,
    /// The option bytes.
    pub option_bytes: u64,
    option_keys: usize,
    options_barred: bool,
    option_control: u64,
}

impl Flash {
    /// Out of reset.
    pub fn new(speed: Speed, option_bytes: u64) -> Self {
        Self { speed, control: LOCK, option_bytes, option_control: option_bytes | OPTLOCK, ..Self::default() }
    }

    /// The operation under way.
    pub fn running(&self) -> Option<Change> {
        self.running.map(|(change, ..)| change)
    }

    /// Changes that the array has to show now.
    pub fn take_finished(&mut self) -> Vec<Change> {
        std::mem::take(&mut self.finished)
    }

    fn time(&self, change: Change) -> VirtualNanos {
        // DS8626 table 46, by PSIZE; double words need a programming voltage that no board here has.
        let parallelism = usize::try_from(self.control >> 8 & 0b11).unwrap_or_default().min(2);
        let nanoseconds = match (change, self.speed) {
            (Change::Program { .. }, Speed::Typical) => 16_000,
            (Change::Program { .. }, Speed::Slowest) => 100_000,
            // Erasing and programming sector-like option bytes (DS8626 table 46: a 16 KiB sector).
            (Change::Options { .. }, speed) => {
                if speed == Speed::Slowest {
                    500_000_000
                } else {
                    250_000_000
                }
            }
            (Change::Erase { sector }, speed) => {
                let kib = SECTORS_KIB.get(sector).copied().unwrap_or_default();
                let typical_ms: [u64; 3] = match kib {
                    16 => [400, 300, 250],
                    64 => [1200, 700, 550],
                    _ => [2000, 1300, 1000],
                };
                let times = if speed == Speed::Slowest { 2 } else { 1 };
                typical_ms[parallelism] * times * 1_000_000
            }
        };
        VirtualNanos(nanoseconds)
    }

    fn start(&mut self, change: Change, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let now = context.now();
        let event = context.schedule(VirtualNanos(now.0 + self.time(change).0));
        self.running = Some((change, event, now));
        registers.set(Register::Sr, registers.get(Register::Sr) | BSY);
    }

    fn fail(&self, flag: u64, registers: &mut RegisterFile) {
        let operation = if self.control & ERRIE != 0 { OPERR } else { 0 };
        registers.set(Register::Sr, registers.get(Register::Sr) | flag | operation);
    }

    fn write_options(&mut self, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if self.option_control & OPTLOCK == 0 && self.running.is_none() {
            self.option_control = value & !OPTSTRT;
            if value & OPTLOCK != 0 {
                self.option_keys = 0;
            } else if value & OPTSTRT != 0 {
                self.start(Change::Options { value: value & !(OPTSTRT | OPTLOCK) | OPTLOCK }, registers, context);
            }
        }
        registers.set(Register::Optcr, self.option_control);
    }

    fn write_control(&mut self, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if self.control & LOCK != 0 {
            registers.set(Register::Cr, self.control);
            return;
        }
        self.control = value & !STRT;
        if value & LOCK != 0 {
            self.keys = 0;
        } else if value & STRT != 0 && value & SER != 0 {
            let number = usize::try_from(value >> 3 & 0b1111).unwrap_or_default();
            if number < SECTORS_KIB.len() {
                self.start(Change::Erase { sector: number }, registers, context);
            } else {
                self.fail(WRPERR, registers);
            }
        }
        registers.set(Register::Cr, self.control);
    }
}

impl Device for Flash {
    type Register = Register;

    fn write(&mut self, register: Register, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        match register {
            Register::Keyr => {
                if self.barred || self.control & LOCK == 0 {
                    return;
                }
                if KEYS.get(self.keys) == Some(&value) {
                    self.keys += 1;
                } else {
                    self.barred = true;
                    context.tell("KEYR", "a wrong key locks FLASH_CR until the next reset, RM0090 section 3.6.1");
                }
                if self.keys == KEYS.len() {
                    self.control &= !LOCK;
                    registers.set(Register::Cr, self.control);
                }
            }
            Register::Cr => self.write_control(value, registers, context),
            // The file has cleared the flags that were written with ones; BSY is the hardware's.
            Register::Sr => {
                let busy = if self.running.is_some() { BSY } else { 0 };
                registers.set(Register::Sr, registers.get(Register::Sr) & !BSY | busy);
            }
            Register::Optkeyr => {
                if self.options_barred || self.option_control & OPTLOCK == 0 {
                    return;
                }
                if OPTION_KEYS.get(self.option_keys) == Some(&value) {
                    self.option_keys += 1;
                } else {
                    self.options_barred = true;
                    context.tell("OPTKEYR", "a wrong key locks FLASH_OPTCR until the next reset, RM0090 section 3.7.2");
                }
                if self.option_keys == OPTION_KEYS.len() {
                    self.option_control &= !OPTLOCK;
                    registers.set(Register::Optcr, self.option_control);
                }
            }
            Register::Optcr => self.write_options(value, registers, context),
            Register::Acr | Register::Optcr1 => {}
        }
    }

    fn write_region(
        &mut self,
        address: u64,
        width: Width,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> bool {
        let bits = 8u64 << (self.control >> 8 & 0b11);
        if self.control & LOCK != 0 || self.control & PG == 0 {
            self.fail(PGSERR, registers);
        } else if u64::from(width.bits()) != bits {
            self.fail(PGPERR, registers);
        } else if self.running.is_none() {
            self.start(Change::Program { address, width, value }, registers, context);
        }
        true
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, _context: &mut DeviceContext<'_>) {
        let Some((change, expected, _)) = self.running else { return };
        if expected != event {
            return;
        }
        self.running = None;
        match change {
            Change::Options { value } => self.option_bytes = value,
            Change::Program { .. } | Change::Erase { .. } => self.finished.push(change),
        }
        let end = if self.control & EOPIE != 0 { EOP } else { 0 };
        registers.set(Register::Sr, registers.get(Register::Sr) & !BSY | end);
    }

    fn reset(&mut self) {
        *self = Self::new(self.speed, self.option_bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_four_sectors_are_where_the_rig_keeps_models_and_settings() {
        assert_eq!(sector(0), 0x0800_0000..0x0800_4000);
        assert_eq!(sector(4), 0x0801_0000..0x0802_0000);
        assert_eq!(sector(8), 0x0808_0000..0x080a_0000);
        assert_eq!(sector(11), 0x080e_0000..0x0810_0000);
    }
}
