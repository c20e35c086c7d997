//! What may be done with which memory: the regions of the memory protection unit (Armv7-M manual section B3.5).
//!
//! Each chip's `regions` lists its own. Everything else is as the architecture has it: peripherals are never executed. A violation is a hard
//! fault.

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
    /// The same by a transfer controller too, so no cache may hold it.
    Shared,
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

/// Bits of the region attribute and size register MPU_RASR (Armv7-M manual section B3.5.9).
mod bits {
    pub const ENABLE: u32 = 1;
    pub const SIZE_SHIFT: u32 = 1;
    /// Normal memory, write-through: what flash and SRAM are.
    pub const CACHEABLE: u32 = 1 << 17;
    /// Normal memory without a cache: TEX 001 (table B3-13).
    pub const UNCACHED: u32 = 1 << 19;
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
            Access::ReadWrite | Access::Shared => (0b011, bits::EXECUTE_NEVER),
        };
        let cache = if matches!(self.access, Access::Shared) { bits::UNCACHED } else { bits::CACHEABLE };
        bits::ENABLE | ((self.length_log2 - 1) << bits::SIZE_SHIFT) | cache | (access << bits::ACCESS_SHIFT) | execute_never
    }
}

#[cfg(test)]
pub(super) mod unit {
    use super::{Access, Region};

    #[test]
    fn a_region_that_a_controller_writes_has_no_cache() {
        // C, B and TEX of MPU_RASR (Armv7-M manual table B3-13): write-through against not cacheable, both normal memory.
        let attributes = |access| Region { base: 0, length_log2: 12, access }.attribute_register() >> 16 & 0b11_1111;
        assert_eq!((attributes(Access::ReadWrite), attributes(Access::Shared)), (0b00_0010, 0b00_1000));
    }

    /// What the unit does with an access, by the manual: the highest-numbered region that holds the address decides, and without one the
    /// privileged background region.
    pub fn allows(regions: &[Region], address: u32) -> Option<(bool, bool, bool)> {
        let registers = regions.iter().zip(0..).map(|(region, number)| (region.base_register(number), region.attribute_register()));
        let hits = registers.filter(|(base, attributes)| {
            let length = 2u64 << ((attributes >> 1) & 0x1f);
            let base = u64::from(base & !0x1f);
            attributes & 1 != 0 && (base..base + length).contains(&u64::from(address))
        });
        let hit = hits.last()?;
        let access = (hit.1 >> 24) & 7;
        let (read, write) = ([1, 2, 3, 5, 6].contains(&access), [1, 2, 3].contains(&access));
        Some((read, write, read && hit.1 & (1 << 28) == 0))
    }
}
