//! The regions of this chip's memory.
//!
//! | region | addresses | read | write | execute |
//! |---|---|---|---|---|
//! | below the stack | 0x1fff_c000 to 0x1fff_ffff | no | no | no |
//! | program | 0x0800_0000 to 0x0807_ffff | yes | no | yes |
//! | models and settings | 0x0808_0000 to 0x080f_ffff | yes | while a word is programmed | no |
//! | SRAM | 0x2000_0000 to 0x2003_ffff | yes | yes | no |
//! | core-coupled memory | 0x1000_0000 to 0x1000_ffff | yes | yes | no |
//!
//! The stack is the lowest thing in SRAM and grows down, so what overflows it meets the first region, and a hard fault vents.

use crate::board::memory_map::{Access, Region};

/// All regions; the place is the number.
pub const REGIONS: [Region; 5] = [
    Region { base: 0x1fff_c000, length_log2: 14, access: Access::None },
    Region { base: 0x0800_0000, length_log2: 19, access: Access::ReadExecute },
    DATA_FLASH_CLOSED,
    Region { base: 0x2000_0000, length_log2: 18, access: Access::ReadWrite },
    Region { base: 0x1000_0000, length_log2: 16, access: Access::ReadWrite },
];
/// The region of [`REGIONS`] that holds models and settings.
pub const DATA_FLASH: u32 = 2;
/// As it is.
pub const DATA_FLASH_CLOSED: Region = Region { base: 0x0808_0000, length_log2: 19, access: Access::Read };
/// The same while a word is programmed.
pub const DATA_FLASH_PROGRAMMING: Region = Region { access: Access::ReadWrite, ..DATA_FLASH_CLOSED };

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::memory_map::unit::allows;
    use crate::board::stm32f405::facts::{MODEL_SECTORS, SECTOR_BYTES, SETTINGS_SECTORS};

    #[test]
    fn the_registers_say_what_the_table_says() {
        // A region begins at a multiple of its length.
        assert!(REGIONS.iter().all(|region| region.base.is_multiple_of(1 << region.length_log2)));
        for (addresses, expected) in [
            ([0x1fff_c000, 0x1fff_fffc], (false, false, false)),
            ([0x0800_0000, 0x0807_fffc], (true, false, true)),
            ([0x0808_0000, 0x080f_fffc], (true, false, false)),
            ([0x2000_0000, 0x2002_fffc], (true, true, false)),
            ([0x1000_0000, 0x1000_fffc], (true, true, false)),
        ] {
            for address in addresses {
                assert_eq!(allows(&REGIONS, address), Some(expected), "{address:#x}");
            }
        }
        // Factory calibration, peripherals and the processor's own registers are as the architecture has them.
        for address in [0x1fff_7a2a, 0x4002_0418, 0xe000_ed00] {
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
        assert_eq!(allows(&programming, 0x0807_fffc), Some((true, false, true)));
    }
}
