//! What may be done with which memory: the regions of the memory protection unit (Armv7-M manual section B3.5).
//!
//! | region | addresses | read | write | execute |
//! |---|---|---|---|---|
//! | below the stack | 0x1fff_c000 to 0x1fff_ffff | no | no | no |
//! | program | 0x0800_0000 to 0x0807_ffff | yes | no | yes |
//! | models and settings | 0x0808_0000 to 0x080f_ffff | yes | while a word is programmed | no |
//! | SRAM | 0x2000_0000 to 0x2003_ffff | yes | yes | no |
//! | core-coupled memory | 0x1000_0000 to 0x1000_ffff | yes | yes | no |
//!
//! The stack is the lowest thing in SRAM and grows down, so what overflows it meets the first region, and a hard fault vents. Everything
//! else is as the architecture has it: peripherals are never executed. A violation is a hard fault.

/// What may be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Nothing.
    None,
    /// Reading.
    Read,
    /// Reading and executing.
    ReadExecute,
    /// Reading and writing.
    ReadWrite,
}

/// A region: a power of two of bytes at a multiple of its length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First address.
    pub base: u32,
    /// Length as a power of two.
    pub length_log2: u32,
    /// What may be done.
    pub access: Access,
}

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

/// Bits of the region attribute and size register MPU_RASR (Armv7-M manual section B3.5.9).
mod bits {
    pub const ENABLE: u32 = 1;
    pub const SIZE_SHIFT: u32 = 1;
    /// Normal memory, write-through: what flash and SRAM are.
    pub const CACHEABLE: u32 = 1 << 17;
    pub const ACCESS_SHIFT: u32 = 24;
    pub const EXECUTE_NEVER: u32 = 1 << 28;
}

impl Region {
    /// The base address register's value for this region's number.
    pub const fn base_register(&self, number: u32) -> u32 {
        // With the valid bit, the region's number comes along.
        self.base | (1 << 4) | number
    }

    /// The attribute and size register's value.
    pub const fn attribute_register(&self) -> u32 {
        let (access, execute_never) = match self.access {
            Access::None => (0b000, bits::EXECUTE_NEVER),
            Access::Read => (0b110, bits::EXECUTE_NEVER),
            Access::ReadExecute => (0b110, 0),
            Access::ReadWrite => (0b011, bits::EXECUTE_NEVER),
        };
        bits::ENABLE | ((self.length_log2 - 1) << bits::SIZE_SHIFT) | bits::CACHEABLE | (access << bits::ACCESS_SHIFT) | execute_never
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::hardware::{MODEL_SECTORS, SECTOR_BYTES, SETTINGS_SECTORS};

    /// What the unit does with an access, by the manual: the highest-numbered region that holds the address decides, and without one the
    /// privileged background region.
    fn allows(regions: &[Region], address: u32) -> Option<(bool, bool, bool)> {
        let registers: [(u32, u32); 5] =
            core::array::from_fn(|index| (regions[index].base_register(index as u32), regions[index].attribute_register()));
        let hit = registers.iter().rev().find(|(base, attributes)| {
            let length = 2u64 << ((attributes >> 1) & 0x1f);
            let base = u64::from(base & !0x1f);
            attributes & 1 != 0 && (base..base + length).contains(&u64::from(address))
        })?;
        let access = (hit.1 >> 24) & 7;
        let (read, write) = ([1, 2, 3, 5, 6].contains(&access), [1, 2, 3].contains(&access));
        Some((read, write, read && hit.1 & (1 << 28) == 0))
    }

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
