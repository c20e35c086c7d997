//! The bootloader in the chip's ROM: how a new program gets onto a board without a debug probe.
//!
//! The protocol is ST's (application note AN3155, USART protocol used in the STM32 bootloader): a command and its complement, an
//! address or data with their exclusive-or, and after each a byte that acknowledges or refuses. The bootloader waits for ever for a byte that was lost;
//! what is refused or not answered is therefore taken up again from a known point (`Bootloader::resynchronise`).
//!
//! # Order
//!
//! 1. The image is checked before anything is erased: its CRC, where it lies, which board and which chip it is for.
//! 2. Sector 0 is erased first: from then on the chip starts nothing, and the dump valve stays released. The others follow.
//! 3. Everything but the first two words is written and read back.
//! 4. Those two, the reset vector behind the other, are written last: a chip that starts the new program has all of it.

mod image;
#[cfg(test)]
mod model;
mod protocol;
#[cfg(test)]
mod tests;

use std::time::Duration;

pub use image::{FLASH_BASE, ImageError, PROGRAM_BYTES, ProgramImage};

use crate::link::{LinkError, Transport};
use protocol::{ACK, NACK, SYNCHRONISE};

/// Fills up whatever the bootloader still waits for. A command of it is none, and as data it changes no flash; a count of sectors made of it is
/// refused by its checksum.
const PADDING: u8 = 0xff;
/// Most bytes that a sound command waits for: a count, 256 bytes, their check.
const LONGEST_WAIT: usize = 258;
/// A count of sectors that was damaged on its way can make it wait for twice 65,536.
const BURST: usize = 1024;
const MOST_BURSTS: usize = 130;

/// Commands (AN3155 table 2).
mod command {
    pub const GET_ID: u8 = 0x02;
    pub const READ: u8 = 0x11;
    pub const GO: u8 = 0x21;
    pub const WRITE: u8 = 0x31;
    pub const EXTENDED_ERASE: u8 = 0x44;
}

/// Most bytes of a block.
const BLOCK: usize = 256;
/// What the chip starts with: where the stack begins, and the reset vector.
const START_BYTES: usize = 8;
/// A byte at this speed takes 0.1 ms, a block 25 ms, programming it 5 ms.
const ANSWERED_WITHIN: Duration = Duration::from_millis(500);
/// A sector of 128 KiB takes 2 s, 4 s at worst (DS8626 table 40).
const ERASED_WITHIN: Duration = Duration::from_secs(8);
/// Nothing comes any more when nothing came for this time.
const SETTLED: Duration = Duration::from_millis(40);
/// How often a step is tried.
const ATTEMPTS: u32 = 4;

/// Why a program was not put onto the board.
#[derive(Debug, thiserror::Error)]
pub enum UpdateError {
    /// The image cannot be the one.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The line.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Nobody answers as a bootloader does.
    #[error("no bootloader answers; hold BOOT0 high while the board is powered up, then run this again with --in-bootloader")]
    Silent,
    /// Another chip.
    #[error("the chip says that it is {found:#05x}, the image is for {expected:#05x}; nothing was erased")]
    OtherChip {
        /// What it says.
        found: u16,
        /// What the image is for.
        expected: u16,
    },
    /// A step that failed again and again.
    #[error(
        "{what} at {address:#010x} failed {ATTEMPTS} times; the board has no whole program now and stays vented: check the line and run this again with --in-bootloader"
    )]
    Failed {
        /// The step.
        what: &'static str,
        /// Where.
        address: u32,
    },
    /// The bootloader answers no more.
    #[error(
        "the board fell silent while {what} at {address:#010x}; it has no whole program now and stays vented: hold BOOT0 high, switch it off and \
         on, and run this again with --in-bootloader"
    )]
    Vanished {
        /// The step.
        what: &'static str,
        /// Where.
        address: u32,
    },
}

/// What one attempt came to.
enum Trouble {
    /// Refused, nothing answered, or an answer that is none.
    Again,
    Link(LinkError),
}

impl From<LinkError> for Trouble {
    fn from(error: LinkError) -> Self {
        Self::Link(error)
    }
}

/// A bootloader at the other end of a line.
pub struct Bootloader<T> {
    line: T,
    received: Vec<u8>,
}

impl<T: Transport> Bootloader<T> {
    /// Says the first byte to a bootloader that has just started, or finds one that was spoken to before.
    ///
    /// # Errors
    /// [`UpdateError::Silent`] or the line's.
    pub fn connect(line: T) -> Result<Self, UpdateError> {
        let mut bootloader = Self { line, received: Vec::new() };
        for _ in 0..ATTEMPTS {
            bootloader.line.send(&[SYNCHRONISE])?;
            // One that knows the speed already takes the byte for half of a command.
            if bootloader.byte(ANSWERED_WITHIN)? == Some(ACK) || bootloader.resynchronise()? {
                return Ok(bootloader);
            }
        }
        Err(UpdateError::Silent)
    }

    /// Gives the line back.
    pub fn into_line(self) -> T {
        self.line
    }

    /// The chip's product identifier.
    ///
    /// # Errors
    /// [`UpdateError::Failed`] or the line's.
    pub fn chip(&mut self) -> Result<u16, UpdateError> {
        self.again("reading the chip's identifier", 0, |bootloader| {
            // Answers carry no check: twice the same is one.
            let (first, second) = (bootloader.identifier()?, bootloader.identifier()?);
            if first == second { Ok(first) } else { Err(Trouble::Again) }
        })
    }

    fn identifier(&mut self) -> Result<u16, Trouble> {
        self.command(command::GET_ID)?;
        let answer = self.bytes(3)?;
        self.acknowledged(ANSWERED_WITHIN)?;
        match answer[..] {
            [1, high, low] => Ok(u16::from_be_bytes([high, low])),
            _ => Err(Trouble::Again),
        }
    }

    /// Puts a program onto the chip; `progress` hears of bytes written.
    ///
    /// # Errors
    /// See [`UpdateError`].
    pub fn update(&mut self, image: &ProgramImage, mut progress: impl FnMut(usize)) -> Result<(), UpdateError> {
        let found = self.chip()?;
        if found != image.chip() {
            return Err(UpdateError::OtherChip { found, expected: image.chip() });
        }
        for _ in 1..ATTEMPTS {
            match self.write_all(image, &mut progress) {
                // A lost byte shifts the block behind it, and one time in 256 the check is right all the same: then bits are cleared that only
                // erasing sets again.
                Err(UpdateError::Failed { .. }) => {}
                outcome => return outcome,
            }
        }
        self.write_all(image, &mut progress)
    }

    fn write_all(&mut self, image: &ProgramImage, progress: &mut impl FnMut(usize)) -> Result<(), UpdateError> {
        for (number, address) in image.sectors() {
            self.erase(number, address)?;
        }
        let Some((start, rest)) = image.bytes().split_at_checked(START_BYTES) else { return Ok(()) };
        let blocks = (FLASH_BASE + START_BYTES as u32..).step_by(BLOCK).zip(rest.chunks(BLOCK));
        let mut written = 0;
        for (address, block) in blocks.chain([(FLASH_BASE, start)]) {
            self.put(address, block)?;
            written += block.len();
            progress(written);
        }
        Ok(())
    }

    /// Starts the program at this address.
    ///
    /// # Errors
    /// [`UpdateError::Failed`] or the line's.
    pub fn go(&mut self, address: u32) -> Result<(), UpdateError> {
        self.again("starting the program", address, |bootloader| {
            bootloader.command(command::GO)?;
            bootloader.address(address)
        })
    }

    fn erase(&mut self, sector: u16, address: u32) -> Result<(), UpdateError> {
        self.again("erasing a sector", address, |bootloader| {
            bootloader.command(command::EXTENDED_ERASE)?;
            let [high, low] = sector.to_be_bytes();
            // One sector: the count less one, its number, the check.
            bootloader.checked(&[0, 0, high, low])?;
            bootloader.acknowledged(ERASED_WITHIN)
        })
    }

    /// Writes a block and reads it back.
    fn put(&mut self, address: u32, block: &[u8]) -> Result<(), UpdateError> {
        let mut is_retry = false;
        self.again("writing a block", address, |bootloader| {
            // An attempt before may have written it without being able to say so.
            if core::mem::replace(&mut is_retry, true) && bootloader.read(address, block.len())? == block {
                return Ok(());
            }
            bootloader.command(command::WRITE)?;
            bootloader.address(address)?;
            let count = count(block.len())?;
            let mut bytes = vec![count];
            bytes.extend_from_slice(block);
            bootloader.checked(&bytes)?;
            bootloader.acknowledged(ANSWERED_WITHIN)?;
            if bootloader.read(address, block.len())? == block { Ok(()) } else { Err(Trouble::Again) }
        })
    }

    fn read(&mut self, address: u32, length: usize) -> Result<Vec<u8>, Trouble> {
        self.command(command::READ)?;
        self.address(address)?;
        let count = count(length)?;
        self.line.send(&[count, !count])?;
        self.acknowledged(ANSWERED_WITHIN)?;
        self.bytes(length)
    }

    fn again<R>(
        &mut self,
        what: &'static str,
        address: u32,
        mut step: impl FnMut(&mut Self) -> Result<R, Trouble>,
    ) -> Result<R, UpdateError> {
        for _ in 0..ATTEMPTS {
            match step(self) {
                Ok(result) => return Ok(result),
                Err(Trouble::Link(error)) => return Err(error.into()),
                Err(Trouble::Again) => {
                    if !self.resynchronise()? {
                        return Err(UpdateError::Vanished { what, address });
                    }
                }
            }
        }
        Err(UpdateError::Failed { what, address })
    }

    fn command(&mut self, command: u8) -> Result<(), Trouble> {
        self.line.send(&[command, !command])?;
        self.acknowledged(ANSWERED_WITHIN)
    }

    fn address(&mut self, address: u32) -> Result<(), Trouble> {
        self.checked(&address.to_be_bytes())?;
        self.acknowledged(ANSWERED_WITHIN)
    }

    /// Sends bytes and their exclusive-or.
    fn checked(&mut self, bytes: &[u8]) -> Result<(), Trouble> {
        let mut sent = bytes.to_vec();
        sent.push(bytes.iter().fold(0, |check, byte| check ^ byte));
        Ok(self.line.send(&sent)?)
    }

    fn acknowledged(&mut self, limit: Duration) -> Result<(), Trouble> {
        if self.byte(limit)? == Some(ACK) { Ok(()) } else { Err(Trouble::Again) }
    }

    fn bytes(&mut self, count: usize) -> Result<Vec<u8>, Trouble> {
        (0..count).map(|_| self.byte(ANSWERED_WITHIN)?.ok_or(Trouble::Again)).collect()
    }

    fn byte(&mut self, limit: Duration) -> Result<Option<u8>, LinkError> {
        let until = self.line.elapsed() + limit;
        while self.received.is_empty() {
            let now = self.line.elapsed();
            if now >= until {
                return Ok(None);
            }
            self.line.receive(until - now, &mut self.received)?;
        }
        Ok(Some(self.received.remove(0)))
    }

    /// Lets the line come to rest; something that never does is no bootloader.
    fn drain(&mut self) -> Result<(), LinkError> {
        for _ in 0..2 * BURST {
            if self.byte(SETTLED)?.is_none() {
                break;
            }
        }
        Ok(())
    }

    /// Brings the bootloader back to where it waits for a command: pads until it refuses what has become of that, then lets it finish.
    fn resynchronise(&mut self) -> Result<bool, LinkError> {
        self.drain()?;
        for step in 0..=LONGEST_WAIT + MOST_BURSTS {
            let is_burst = step > LONGEST_WAIT;
            self.line.send(if is_burst { &[PADDING; BURST] } else { &[PADDING] })?;
            if self.byte(SETTLED)?.is_some() {
                self.drain()?;
                if is_burst {
                    // It refused somewhere within, and what followed were commands of paddings, the last perhaps a half.
                    return self.resynchronise();
                }
                // Where it was in the middle of something, that is over; now it must be at a command, and a pair of paddings is none.
                self.line.send(&[PADDING, PADDING])?;
                if self.byte(ANSWERED_WITHIN)? == Some(NACK) && self.byte(SETTLED)?.is_none() {
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }
}

/// A count as the protocol has it: less one.
fn count(length: usize) -> Result<u8, Trouble> {
    length.checked_sub(1).and_then(|count| u8::try_from(count).ok()).ok_or(Trouble::Again)
}
