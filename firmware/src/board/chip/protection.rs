//! The memory protection unit's registers (Armv7-M manual section B3.5).

use cortex_m::peripheral::MPU;
use cortex_m::peripheral::mpu::RegisterBlock;

use crate::board::memory_map::{DATA_FLASH, DATA_FLASH_CLOSED, DATA_FLASH_PROGRAMMING, REGIONS, Region};

/// On, with the architecture's map where no region is; off in hard faults, whose way down must not meet another.
const ENABLE: u32 = 0b101;

/// Switches the unit on.
pub fn start(unit: &MPU) {
    for (number, region) in (0..).zip(&REGIONS) {
        set(unit, number, region);
    }
    // SAFETY: the regions allow what this program does: `board::memory_map` and its tests.
    unsafe { unit.ctrl.write(ENABLE) };
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

fn set(unit: &RegisterBlock, number: u32, region: &Region) {
    // SAFETY: values of `board::memory_map`.
    unsafe {
        unit.rbar.write(region.base_register(number));
        unit.rasr.write(region.attribute_register());
    }
}

/// Lets models and settings be written while `write` runs.
///
/// # Safety
/// From the background alone, which nothing interrupts that calls this.
pub unsafe fn while_writable(write: impl FnOnce()) {
    // SAFETY: the registers exist for ever, and nobody else writes them after the start, by the contract.
    let unit = unsafe { &*MPU::PTR };
    set(unit, DATA_FLASH, &DATA_FLASH_PROGRAMMING);
    cortex_m::asm::dsb();
    write();
    cortex_m::asm::dsb();
    set(unit, DATA_FLASH, &DATA_FLASH_CLOSED);
    cortex_m::asm::dsb();
}
