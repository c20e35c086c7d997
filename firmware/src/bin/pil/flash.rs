//! Flash in the emulator: the chip's own flash memory for reading, the file `flash.bin` beside the emulator for writing.
//!
//! QEMU has no flash controller, and the processor cannot write its flash memory. A debugger can, and semihosting reads a file into memory as
//! a debugger would: each word goes to the file first and from the file to memory. The file is what stays when the emulator ends; its layout
//! is settings A and B, models A and B.

use core::slice;

use cortex_m_semihosting::nr::open::RW_BINARY;
use cortex_m_semihosting::syscall;
use firmware::storage::{Flash, Slot};

/// Upper half of the flash memory; the program lies in the lower one.
const BASE: usize = 0x0808_0000;
/// As the board's sectors.
const SETTINGS_SLOT_BYTES: usize = 16 * 1024;
const MODEL_SLOT_BYTES: usize = 128 * 1024;
const TOTAL_BYTES: usize = 2 * (SETTINGS_SLOT_BYTES + MODEL_SLOT_BYTES);
const NAME: &[u8] = b"flash.bin\0";

/// The whole flash.
pub struct Memory {
    file: usize,
}

/// Two slots of it.
pub struct SlotPair {
    file: usize,
    /// Offset of slot A in the file and from [`BASE`].
    offset: usize,
    bytes: usize,
}

/// The file cannot be read or written.
#[derive(Clone, Copy, Debug)]
pub struct NoFile;

impl Memory {
    /// Opens the file and brings its contents into memory.
    pub fn open() -> Self {
        // SAFETY: a name with its length, as the operation wants it.
        let file = unsafe { syscall!(OPEN, NAME.as_ptr(), RW_BINARY, NAME.len() - 1) };
        let memory = Self { file };
        if bring(file, 0, TOTAL_BYTES).is_err() {
            panic!("flash.bin is missing or too short");
        }
        memory
    }

    /// The settings' slots.
    pub fn settings(&self) -> SlotPair {
        SlotPair { file: self.file, offset: 0, bytes: SETTINGS_SLOT_BYTES }
    }

    /// The models' slots.
    pub fn models(&self) -> SlotPair {
        SlotPair { file: self.file, offset: 2 * SETTINGS_SLOT_BYTES, bytes: MODEL_SLOT_BYTES }
    }
}

impl SlotPair {
    fn start(&self, slot: Slot) -> usize {
        self.offset + if slot == Slot::B { self.bytes } else { 0 }
    }

    fn write(&mut self, at: usize, bytes: &[u8]) -> Result<(), NoFile> {
        // SAFETY: an open file, an offset within it, a buffer with its length.
        let left = unsafe {
            let _ = syscall!(SEEK, self.file, at);
            syscall!(WRITE, self.file, bytes.as_ptr(), bytes.len())
        };
        if left == 0 { bring(self.file, at, bytes.len()) } else { Err(NoFile) }
    }
}

/// Reads a part of the file into its place in memory.
fn bring(file: usize, at: usize, length: usize) -> Result<(), NoFile> {
    // SAFETY: the place lies in the upper half of the flash memory, which holds neither program nor data of this image.
    let left = unsafe {
        let _ = syscall!(SEEK, file, at);
        syscall!(READ, file, BASE + at, length)
    };
    if left == 0 { Ok(()) } else { Err(NoFile) }
}

impl Flash for SlotPair {
    type Error = NoFile;

    fn contents(&self, slot: Slot) -> &[u8] {
        // SAFETY: `bring` filled this part of the flash memory; it only changes in `erase` and `program`, which borrow the slots mutably.
        unsafe { slice::from_raw_parts((BASE + self.start(slot)) as *const u8, self.bytes) }
    }

    fn erase(&mut self, slot: Slot) -> Result<(), NoFile> {
        let start = self.start(slot);
        (0..self.bytes).step_by(1024).try_for_each(|at| self.write(start + at, &[0xff; 1024]))
    }

    fn program(&mut self, slot: Slot, offset: u32, word: u32) -> Result<(), NoFile> {
        let at = usize::try_from(offset).map_err(|_| NoFile)?;
        let before = self.contents(slot).get(at..).and_then(|bytes| bytes.first_chunk::<4>()).filter(|_| at % 4 == 0).ok_or(NoFile)?;
        // Programming clears bits and sets none.
        let after = u32::from_le_bytes(*before) & word;
        self.write(self.start(slot) + at, &after.to_le_bytes())
    }
}
