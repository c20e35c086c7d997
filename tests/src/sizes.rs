//! How much memory a linked image takes, read from its section headers.
//!
//! Source: Tool Interface Standard, "Executable and Linking Format Specification", version 1.2, book I, for 32-bit little-endian files.

use std::path::Path;

/// Where the chip has its flash and its SRAM; the core-coupled memory, which holds weights, counts for neither.
const FLASH: std::ops::Range<u32> = 0x0800_0000..0x0810_0000;
const SRAM: std::ops::Range<u32> = 0x2000_0000..0x2002_0000;

/// Section type without contents in the file, and the flag of sections that occupy memory.
const NO_BITS: u32 = 8;
const ALLOCATED: u32 = 2;

/// Memory of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Code, constants and the initial values of variables.
    pub flash_bytes: u32,
    /// Variables; the stack comes on top.
    pub ram_bytes: u32,
}

/// Reads an image's sizes.
///
/// # Panics
/// When the file cannot be read or is no 32-bit ELF file.
#[must_use]
pub fn of(path: &Path) -> Sizes {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    parse(&bytes).unwrap_or_else(|| panic!("{} is no 32-bit ELF file", path.display()))
}

fn parse(bytes: &[u8]) -> Option<Sizes> {
    let word = |at: usize| bytes.get(at..at + 4)?.try_into().ok().map(u32::from_le_bytes);
    let half = |at: usize| Some(usize::from(u16::from_le_bytes(bytes.get(at..at + 2)?.try_into().ok()?)));
    if !bytes.starts_with(b"\x7fELF\x01\x01") {
        return None;
    }
    let (headers, header_bytes, count) = (usize::try_from(word(32)?).ok()?, half(46)?, half(48)?);
    let mut sizes = Sizes::default();
    for header in (0..count).map(|index| headers + index * header_bytes) {
        let (kind, flags, address, size) = (word(header + 4)?, word(header + 8)?, word(header + 12)?, word(header + 20)?);
        if flags & ALLOCATED == 0 {
            continue;
        }
        // Initial values lie in flash and are copied to the variables at reset.
        sizes.flash_bytes += if FLASH.contains(&address) || (SRAM.contains(&address) && kind != NO_BITS) { size } else { 0 };
        sizes.ram_bytes += if SRAM.contains(&address) { size } else { 0 };
    }
    Some(sizes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_count_where_they_lie() {
        let mut bytes = vec![0; 52];
        bytes[..6].copy_from_slice(b"\x7fELF\x01\x01");
        bytes[32] = 52;
        bytes[46] = 40;
        let sections =
            [(1, 2, 0x0800_0000, 100), (1, 3, 0x2000_0000, 20), (8, 3, 0x2000_0020, 7), (8, 3, 0x1000_0000, 5000), (1, 0, 0, 900)];
        bytes[48] = sections.len() as u8;
        for (kind, flags, address, size) in sections {
            for word in [0, kind, flags, address, 0, size, 0, 0, 0, 0] {
                bytes.extend(u32::to_le_bytes(word));
            }
        }
        assert_eq!(parse(&bytes), Some(Sizes { flash_bytes: 120, ram_bytes: 27 }));
        assert_eq!(parse(&bytes[..100]), None);
    }
}
