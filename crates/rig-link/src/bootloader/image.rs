//! The image as it lies in the chip's flash, and every reason not to put it there.

use model_export::blob::crc32;
use object::LittleEndian;
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader, SectionHeader};

/// Where the flash begins.
pub const FLASH_BASE: u32 = 0x0800_0000;
/// What of it is for the program: sectors 0 to 7. Models and settings lie behind and stay.
pub const PROGRAM_BYTES: u32 = 512 * 1024;
/// Lengths of those sectors (RM0090 table 5).
const SECTORS_KIB: [u32; 8] = [16, 16, 16, 16, 64, 128, 128, 128];
/// Product identifier of the STM32F405 (AN2606).
const CHIP: u16 = 0x413;
/// Sections that the CRC covers, in its order: `cargo xtask firmware` makes it.
const SEALED: [&str; 4] = [".vector_table", ".text", ".rodata", ".data"];

/// Why an image is refused.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// No ELF file of the microcontroller.
    #[error("is no image of a microcontroller; `cargo xtask firmware` makes one: target/thumbv7em-none-eabihf/release/rig")]
    NotAnImage,
    /// It lies elsewhere.
    #[error("does not lie where the program of this board lies, {FLASH_BASE:#010x} and {PROGRAM_BYTES} bytes on")]
    Place,
    /// It has no CRC.
    #[error("is not sealed: it is straight from the compiler; `cargo xtask firmware` makes a sealed one")]
    NotSealed,
    /// Its checksum is wrong.
    #[error("is damaged: its checksum is {found:08x}, its seal says {sealed:08x}; build or copy it again")]
    Damaged {
        /// Of the bytes.
        found: u32,
        /// In the image.
        sealed: u32,
    },
    /// Its first two words are no stack and no start.
    #[error("has no start: its first words are {0:08x} and {1:08x}")]
    NoStart(u32, u32),
    /// Its name is not in it.
    #[error("is for another board: the one at the other end is `{0}`")]
    OtherBoard(String),
}

/// A sealed image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProgramImage {
    bytes: Vec<u8>,
    crc: u32,
}

impl ProgramImage {
    /// Reads and checks an ELF file.
    ///
    /// # Errors
    /// See [`ImageError`].
    pub fn of(file: &[u8]) -> Result<Self, ImageError> {
        let header = FileHeader32::<LittleEndian>::parse(file).map_err(|_| ImageError::NotAnImage)?;
        let segments = header.program_headers(LittleEndian, file).map_err(|_| ImageError::NotAnImage)?;
        let mut bytes = Vec::new();
        for segment in segments.iter().filter(|segment| segment.p_type(LittleEndian) == PT_LOAD) {
            let contents = segment.data(LittleEndian, file).map_err(|()| ImageError::NotAnImage)?;
            if contents.is_empty() {
                continue;
            }
            let at = segment.p_paddr(LittleEndian).checked_sub(FLASH_BASE).ok_or(ImageError::Place)?;
            let end = at.checked_add(u32::try_from(contents.len()).map_err(|_| ImageError::Place)?);
            let end = end.filter(|end| *end <= PROGRAM_BYTES).ok_or(ImageError::Place)?;
            let (at, end) = (at as usize, end as usize);
            if bytes.len() < end {
                bytes.resize(end, 0xff);
            }
            bytes[at..end].copy_from_slice(contents);
        }
        let crc = sealed(header, file)?;
        match bytes[..] {
            [a, b, c, d, e, f, g, h, ..] => {
                let (stack, start) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
                let starts = start & 1 == 1 && (FLASH_BASE..FLASH_BASE + PROGRAM_BYTES).contains(&start);
                if !(starts && stack.is_multiple_of(8) && stack >> 24 == 0x20) {
                    return Err(ImageError::NoStart(stack, start));
                }
            }
            _ => return Err(ImageError::Place),
        }
        // The bootloader writes words.
        bytes.resize(bytes.len().next_multiple_of(4), 0xff);
        Ok(Self { bytes, crc })
    }

    /// That it is for the board of this name, which every image carries.
    ///
    /// # Errors
    /// [`ImageError::OtherBoard`].
    pub fn check_board(&self, name: &str) -> Result<(), ImageError> {
        let carries = !name.is_empty() && self.bytes.windows(name.len()).any(|window| window == name.as_bytes());
        if carries { Ok(()) } else { Err(ImageError::OtherBoard(name.to_owned())) }
    }

    /// The bytes from [`FLASH_BASE`] on.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Its checksum.
    #[must_use]
    pub fn crc(&self) -> u32 {
        self.crc
    }

    /// Product identifier of its chip.
    #[must_use]
    pub fn chip(&self) -> u16 {
        CHIP
    }

    /// Number and first address of every sector that it lies in, the first one first.
    pub fn sectors(&self) -> impl Iterator<Item = (u16, u32)> + '_ {
        let begins = SECTORS_KIB.iter().scan(0, |next, kib| {
            let begin = *next;
            *next += kib * 1024;
            Some(begin)
        });
        (0u16..)
            .zip(begins)
            .take_while(|(_, begin)| (*begin as usize) < self.bytes.len())
            .map(|(number, begin)| (number, FLASH_BASE + begin))
    }
}

/// Checks the CRC and gives it.
fn sealed(header: &FileHeader32<LittleEndian>, file: &[u8]) -> Result<u32, ImageError> {
    let sections = header.sections(LittleEndian, file).map_err(|_| ImageError::NotAnImage)?;
    let contents = |name: &str| {
        let (_, section) = sections.section_by_name(LittleEndian, name.as_bytes())?;
        section.data(LittleEndian, file).ok()
    };
    let crc = contents(".seal").and_then(<[u8]>::first_chunk::<8>).ok_or(ImageError::NotAnImage)?;
    let [s, e, a, l, x, y, z, w] = *crc;
    if [s, e, a, l] != *b"SEAL" {
        return Err(ImageError::NotSealed);
    }
    let sealed = u32::from_le_bytes([x, y, z, w]);
    let mut found = 0;
    for name in SEALED {
        found = crc32(found, contents(name).ok_or(ImageError::NotAnImage)?);
    }
    if found == sealed { Ok(sealed) } else { Err(ImageError::Damaged { found, sealed }) }
}

/// Images for tests.
#[cfg(test)]
pub mod tests_support {
    use super::*;

    /// A program with a start, a board's name, and bytes of every value, zeros among them.
    pub fn program(length: usize) -> Vec<u8> {
        let mut bytes: Vec<u8> = (0..length).map(|index| (index * 7 + index / 256) as u8).collect();
        bytes[..4].copy_from_slice(&0x2000_4000u32.to_le_bytes());
        bytes[4..8].copy_from_slice(&(FLASH_BASE + 0x189).to_le_bytes());
        bytes[1000..1013].copy_from_slice(b"stm32f405-rig");
        bytes
    }

    /// A sealed ELF file of it, after `change` of the parts: vector table, code, constants, initial data, CRC.
    pub fn elf(program: &[u8], change: impl FnOnce(&mut [Vec<u8>; 5])) -> Vec<u8> {
        let cuts = [0, 392, 30_000, 45_000, program.len() - 8, program.len()];
        let mut parts: [Vec<u8>; 5] = std::array::from_fn(|part| program[cuts[part]..cuts[part + 1]].to_vec());
        let crc = parts[..4].iter().fold(0, |crc, part| crc32(crc, part));
        parts[4] = [*b"SEAL", crc.to_le_bytes()].concat();
        change(&mut parts);
        let names = [".vector_table", ".text", ".rodata", ".data", ".seal", ".shstrtab"];
        let strings: Vec<u8> = names.iter().flat_map(|name| [0].into_iter().chain(name.bytes())).chain([0]).collect();
        let mut file = vec![0; 52 + 5 * 32];
        let (mut segments, mut sections) = (Vec::new(), vec![0; 40]);
        let mut name = 1u32;
        for (part, contents) in parts.iter().chain([&strings]).enumerate() {
            let (offset, length) = (file.len() as u32, contents.len() as u32);
            file.extend(contents);
            let address = if part < 5 { FLASH_BASE + cuts[part] as u32 } else { 0 };
            if part < 5 {
                for word in [1, offset, 0x2000_0000, address, length, length, 4, 4] {
                    segments.extend(u32::to_le_bytes(word));
                }
            }
            let kind = if part < 5 { 1 } else { 3 };
            for word in [name, kind, 2, address, offset, length, 0, 0, 1, 0] {
                sections.extend(u32::to_le_bytes(word));
            }
            name += names[part].len() as u32 + 1;
        }
        let places = [file.len() as u32, 52];
        file.extend(sections);
        file[52..52 + segments.len()].copy_from_slice(&segments);
        let mut header = vec![0x7f, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        header.extend([2u16, 40].iter().flat_map(|half| half.to_le_bytes()));
        header.extend([1, FLASH_BASE, places[1], places[0], 0].iter().flat_map(|word| word.to_le_bytes()));
        header.extend([52u16, 32, 5, 40, 7, 6].iter().flat_map(|half| half.to_le_bytes()));
        file[..52].copy_from_slice(&header);
        file
    }
}

#[cfg(test)]
mod tests {
    use super::tests_support::{elf, program};
    use super::*;

    #[test]
    fn a_sealed_image_is_read_as_it_lies_in_flash() {
        let bytes = program(50_001);
        let image = ProgramImage::of(&elf(&bytes, |_| {})).unwrap();
        assert_eq!(image.bytes().len(), 50_004);
        assert_eq!(image.bytes()[..49_993], bytes[..49_993]);
        assert_eq!(image.bytes()[50_001..], [0xff; 3]);
        assert_eq!(image.sectors().collect::<Vec<_>>(), [(0, 0x0800_0000), (1, 0x0800_4000), (2, 0x0800_8000), (3, 0x0800_c000)]);
        assert_eq!(image.check_board("stm32f405-rig"), Ok(()));
        assert_eq!(image.check_board("nucleo-h743zi"), Err(ImageError::OtherBoard("nucleo-h743zi".to_owned())));
        assert!(image.check_board("").is_err());
    }

    #[test]
    fn what_is_no_sealed_image_of_this_chip_is_refused_by_name() {
        let bytes = program(50_000);
        let refused = |change: &dyn Fn(&mut [Vec<u8>; 5])| ProgramImage::of(&elf(&bytes, change)).unwrap_err();
        assert_eq!(ProgramImage::of(b"no image"), Err(ImageError::NotAnImage));
        assert_eq!(refused(&|parts| parts[4][..4].copy_from_slice(b"OPEN")), ImageError::NotSealed);
        // Every part counts.
        for part in 0..4 {
            assert!(matches!(refused(&|parts| parts[part][20] ^= 1), ImageError::Damaged { .. }), "part {part}");
        }
        let reseal = |parts: &mut [Vec<u8>; 5]| {
            let crc = parts[..4].iter().fold(0, |crc, part| crc32(crc, part));
            parts[4][4..].copy_from_slice(&crc.to_le_bytes());
        };
        let no_start = refused(&|parts| {
            parts[0][4..8].fill(0);
            reseal(parts);
        });
        assert!(matches!(no_start, ImageError::NoStart(_, 0)), "{no_start}");
        let mut elsewhere = elf(&bytes, |_| {});
        // The address of the fifth segment: where settings lie.
        elsewhere[52 + 4 * 32 + 12..][..4].copy_from_slice(&0x080c_0000u32.to_le_bytes());
        assert_eq!(ProgramImage::of(&elsewhere), Err(ImageError::Place));
    }
}
