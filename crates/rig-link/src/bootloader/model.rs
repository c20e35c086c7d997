//! A bootloader as AN3155 describes it, over flash as RM0090 describes it: what the host's side is tested against.

use std::collections::VecDeque;
use std::time::Duration;

use super::image::FLASH_BASE;
use super::protocol::{ACK, NACK, SYNCHRONISE};
use crate::link::{LinkError, Transport};

/// All of the chip's flash.
const FLASH_BYTES: usize = 1024 * 1024;
/// Lengths of its sectors (RM0090 table 5).
const SECTORS_KIB: [usize; 12] = [16, 16, 16, 16, 64, 128, 128, 128, 128, 128, 128, 128];

/// What the line and the supply do to a byte.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mishap {
    #[default]
    None,
    Lost,
    Flipped,
}

/// When something happens, by the number of the byte.
pub type Mishaps = Box<dyn FnMut(usize) -> Mishap>;

/// What the bootloader waits for.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Waits {
    /// The first byte after its start.
    Synchronise,
    Command,
    Complement(u8),
    Address(u8, Vec<u8>),
    ReadCount(u32),
    ReadComplement(u32, u8),
    Data(u32, Vec<u8>),
    Sectors(Vec<u8>),
    /// The program runs.
    Gone,
    /// There is no supply.
    Off,
}

pub struct Model {
    pub flash: Vec<u8>,
    pub chip: u16,
    pub to_device: Mishaps,
    pub from_device: Mishaps,
    /// Refuses the commands with these numbers, though nothing is wrong with them.
    pub refuses: Vec<usize>,
    /// Loses its supply when so many bytes have come.
    pub cut_at: Option<usize>,
    /// Loses its supply in the middle of this operation on the flash.
    pub cut_in_operation: Option<usize>,
    /// Bytes that came, operations on the flash, commands.
    pub counts: [usize; 3],
    pub started_at: Option<u32>,
    waits: Waits,
    answers: VecDeque<u8>,
    sent: usize,
    time: Duration,
}

impl Model {
    /// Over flash with these bytes at its begin, and models and settings behind the program.
    pub fn over(program: &[u8]) -> Self {
        let mut flash = vec![0xff; FLASH_BYTES];
        flash[..program.len()].copy_from_slice(program);
        flash[512 * 1024..].fill(0x5a);
        Self {
            flash,
            chip: 0x413,
            to_device: Box::new(|_| Mishap::None),
            from_device: Box::new(|_| Mishap::None),
            refuses: Vec::new(),
            cut_at: None,
            cut_in_operation: None,
            counts: [0; 3],
            started_at: None,
            waits: Waits::Synchronise,
            answers: VecDeque::new(),
            sent: 0,
            time: Duration::ZERO,
        }
    }

    /// Supply again, with nothing else broken, and the boot pin held.
    pub fn power_up(&mut self) {
        (self.cut_at, self.cut_in_operation) = (None, None);
        self.waits = Waits::Synchronise;
        self.answers.clear();
    }

    fn answer(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.sent += 1;
            match (self.from_device)(self.sent) {
                Mishap::None => self.answers.push_back(*byte),
                Mishap::Lost => {}
                Mishap::Flipped => self.answers.push_back(byte ^ 0x10),
            }
        }
    }

    fn refuse(&mut self) -> Waits {
        self.answer(&[NACK]);
        Waits::Command
    }

    /// Whether an operation on the flash ends; if not, half of it is done.
    fn operate(&mut self, range: std::ops::Range<usize>, change: impl Fn(&mut u8, usize)) -> bool {
        self.counts[1] += 1;
        let cut = self.cut_in_operation == Some(self.counts[1]);
        let length = if cut { range.len() / 2 } else { range.len() };
        self.flash[range].iter_mut().take(length).enumerate().for_each(|(index, byte)| change(byte, index));
        !cut
    }

    fn take(&mut self, byte: u8) {
        let waits = std::mem::replace(&mut self.waits, Waits::Command);
        self.waits = match waits {
            Waits::Off | Waits::Gone => waits,
            Waits::Synchronise => {
                if byte == SYNCHRONISE {
                    self.answer(&[ACK]);
                    Waits::Command
                } else {
                    Waits::Synchronise
                }
            }
            Waits::Command => Waits::Complement(byte),
            Waits::Complement(command) if byte == !command => self.command(command),
            Waits::Complement(_) => self.refuse(),
            Waits::Address(command, mut bytes) => {
                bytes.push(byte);
                if bytes.len() < 5 { Waits::Address(command, bytes) } else { self.address(command, &bytes) }
            }
            Waits::ReadCount(address) => Waits::ReadComplement(address, byte),
            Waits::ReadComplement(address, count) if byte == !count => {
                let from = (address - FLASH_BASE) as usize;
                let bytes = self.flash[from..from + usize::from(count) + 1].to_vec();
                self.answer(&[ACK]);
                self.answer(&bytes);
                Waits::Command
            }
            Waits::ReadComplement(..) => self.refuse(),
            Waits::Data(address, mut bytes) => {
                bytes.push(byte);
                if bytes.len() < usize::from(bytes[0]) + 3 { Waits::Data(address, bytes) } else { self.write(address, &bytes) }
            }
            Waits::Sectors(mut bytes) => {
                bytes.push(byte);
                let count = bytes.first_chunk().map(|count| u16::from_be_bytes(*count));
                // The highest numbers stand for everything and have the check behind them at once.
                let wanted = count.map_or(3, |count| if count >= 0xfff0 { 3 } else { 2 * usize::from(count) + 5 });
                if bytes.len() < wanted { Waits::Sectors(bytes) } else { self.erase(&bytes) }
            }
        };
    }

    fn command(&mut self, command: u8) -> Waits {
        self.counts[2] += 1;
        if self.refuses.contains(&self.counts[2]) {
            return self.refuse();
        }
        match command {
            0x02 => {
                let [high, low] = self.chip.to_be_bytes();
                self.answer(&[ACK, 1, high, low, ACK]);
                Waits::Command
            }
            0x11 | 0x21 | 0x31 => {
                self.answer(&[ACK]);
                Waits::Address(command, Vec::new())
            }
            0x44 => {
                self.answer(&[ACK]);
                Waits::Sectors(Vec::new())
            }
            _ => self.refuse(),
        }
    }

    fn address(&mut self, command: u8, bytes: &[u8]) -> Waits {
        let check = bytes.iter().fold(0, |check, byte| check ^ byte);
        let address = u32::from_be_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let inside = address.checked_sub(FLASH_BASE).is_some_and(|at| at as usize + 256 <= FLASH_BYTES);
        if check != 0 || !inside || !address.is_multiple_of(4) {
            return self.refuse();
        }
        self.answer(&[ACK]);
        match command {
            0x11 => Waits::ReadCount(address),
            0x31 => Waits::Data(address, Vec::new()),
            _ => {
                self.started_at = Some(address);
                Waits::Gone
            }
        }
    }

    fn write(&mut self, address: u32, bytes: &[u8]) -> Waits {
        if bytes.iter().fold(0, |check, byte| check ^ byte) != 0 {
            return self.refuse();
        }
        let data = bytes[1..bytes.len() - 1].to_vec();
        let from = (address - FLASH_BASE) as usize;
        // Programming clears bits and sets none.
        if !self.operate(from..from + data.len(), |byte, index| *byte &= data[index]) {
            return Waits::Off;
        }
        self.answer(&[ACK]);
        Waits::Command
    }

    fn erase(&mut self, bytes: &[u8]) -> Waits {
        let check = bytes.iter().fold(0, |check, byte| check ^ byte);
        let count = u16::from_be_bytes([bytes[0], bytes[1]]);
        assert!(check != 0 || count < 0xfff0, "nobody wanted everything erased");
        if check != 0 {
            return self.refuse();
        }
        for sector in bytes[2..bytes.len() - 1].as_chunks::<2>().0 {
            let number = usize::from(u16::from_be_bytes(*sector));
            let Some(kib) = SECTORS_KIB.get(number) else { return self.refuse() };
            let from: usize = SECTORS_KIB[..number].iter().sum::<usize>() * 1024;
            if !self.operate(from..from + kib * 1024, |byte, _| *byte = 0xff) {
                return Waits::Off;
            }
            self.time += Duration::from_millis(*kib as u64 * 16);
        }
        self.answer(&[ACK]);
        Waits::Command
    }
}

impl Transport for &mut Model {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        for byte in bytes {
            self.counts[0] += 1;
            self.time += Duration::from_micros(96);
            if self.cut_at == Some(self.counts[0]) {
                self.waits = Waits::Off;
            }
            match (self.to_device)(self.counts[0]) {
                Mishap::None => self.take(*byte),
                Mishap::Lost => {}
                Mishap::Flipped => self.take(byte ^ 0x04),
            }
        }
        Ok(())
    }

    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        match self.answers.pop_front() {
            Some(byte) => {
                self.time += Duration::from_micros(96);
                into.push(byte);
            }
            None => self.time += limit,
        }
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        self.time
    }

    fn place(&self) -> &'static str {
        "the bootloader's model"
    }
}
