//! The regions of this chip's memory.
//!
//! | region | addresses | read | write | execute |
//! |---|---|---|---|---|
//! | below the stack | 0x1fff_c000 to 0x1fff_ffff | no | no | no |
//! | program (bank 1) | 0x0800_0000 to 0x080f_ffff | yes | no | yes |
//! | models and settings (bank 2) | 0x0810_0000 to 0x081f_ffff | yes | while a word is programmed | no |
//! | data TCM | 0x2000_0000 to 0x2001_ffff | yes | yes | no |
//! | AXI SRAM, unused | 0x2400_0000 to 0x2407_ffff | no | no | no |
//! | SRAM1 to SRAM4, backup SRAM, unused but for the next | 0x3000_0000 to 0x3fff_ffff | no | no | no |
//! | the line's buffers in SRAM1, not cached | 0x3000_0000 to 0x3000_07ff | yes | yes | no |
//!
//! The stack is the lowest thing in the data TCM and grows down, so what overflows it meets the first region, and a hard fault vents.

use crate::board::memory_map::{Access, Region};

/// All regions; the place is the number.
pub const REGIONS: [Region; 7] = [
    Region { base: 0x1fff_c000, length_log2: 14, access: Access::None },
    Region { base: 0x0800_0000, length_log2: 20, access: Access::ReadExecute },
    DATA_FLASH_CLOSED,
    Region { base: 0x2000_0000, length_log2: 17, access: Access::ReadWrite },
    Region { base: 0x2400_0000, length_log2: 19, access: Access::None },
    Region { base: 0x3000_0000, length_log2: 28, access: Access::None },
    Region { base: 0x3000_0000, length_log2: 11, access: Access::Shared },
];
/// The region of [`REGIONS`] that holds models and settings.
pub const DATA_FLASH: u32 = 2;
/// As it is.
pub const DATA_FLASH_CLOSED: Region = Region { base: 0x0810_0000, length_log2: 20, access: Access::Read };
/// The same while a word is programmed.
pub const DATA_FLASH_PROGRAMMING: Region = Region { access: Access::ReadWrite, ..DATA_FLASH_CLOSED };

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::memory_map::unit::allows;
    use crate::board::stm32h743::facts::{MODEL_SECTORS, SECTOR_BYTES, SETTINGS_SECTORS};

    #[test]
    fn the_registers_say_what_the_table_says() {
        assert!(REGIONS.iter().all(|region| region.base.is_multiple_of(1 << region.length_log2)));
        for (addresses, expected) in [
            ([0x1fff_c000, 0x1fff_fffc], (false, false, false)),
            ([0x0800_0000, 0x080f_fffc], (true, false, true)),
            ([0x0810_0000, 0x081f_fffc], (true, false, false)),
            ([0x2000_0000, 0x2001_fffc], (true, true, false)),
            ([0x2400_0000, 0x2407_fffc], (false, false, false)),
            ([0x3000_0000, 0x3000_07fc], (true, true, false)),
            ([0x3000_0800, 0x3880_0ffc], (false, false, false)),
        ] {
            for address in addresses {
                assert_eq!(allows(&REGIONS, address), Some(expected), "{address:#x}");
            }
        }
        for address in [0x1ff1_e860, 0x5802_1018, 0xe000_ed00] {
            assert_eq!(allows(&REGIONS, address), None, "{address:#x}");
        }
    }

    #[test]
    fn every_sector_of_models_and_settings_can_be_programmed_and_the_program_cannot() {
        let mut programming = REGIONS;
        programming[DATA_FLASH as usize] = DATA_FLASH_PROGRAMMING;
        for (first, _) in MODEL_SECTORS.into_iter().chain(SETTINGS_SECTORS) {
            for address in [first, first + SECTOR_BYTES as u32 - 4] {
                assert_eq!(allows(&REGIONS, address), Some((true, false, false)));
                assert_eq!(allows(&programming, address), Some((true, true, false)));
            }
        }
        assert_eq!(allows(&programming, 0x080f_fffc), Some((true, false, true)));
    }
}
