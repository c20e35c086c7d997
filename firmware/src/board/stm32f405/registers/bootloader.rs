//! Into the chip's own bootloader (AN2606), which takes a program over the serial line (AN3155).
//!
//! The bootloader expects a chip as it is after a reset: internal oscillator, no interrupts, no watchdog. So the way there is a reset. A word in RAM
//! that is not cleared tells the first code after it where to go, before anything else is set up; the dump valve's pin is released by then.

use core::mem::MaybeUninit;

use stm32f4::stm32f405::{RCC, SYSCFG};

/// Where the bootloader's vector table begins (AN2606, system memory of the F405).
const SYSTEM_MEMORY: usize = 0x1fff_0000;
const WANTED: u32 = 0xb007_10ad;

#[unsafe(link_section = ".uninit.bootloader")]
static mut REQUEST: MaybeUninit<u32> = MaybeUninit::uninit();

fn request() -> *mut u32 {
    (&raw mut REQUEST).cast()
}

/// Vents, and starts again in the bootloader.
pub fn enter() -> ! {
    cortex_m::interrupt::disable();
    super::crash::vent();
    // The last byte is still in the line's shift register: eleven bits at 921,600 baud are 12 us.
    cortex_m::asm::delay(168_000);
    // SAFETY: a word of ours that nothing else reads before the reset.
    unsafe { request().write_volatile(WANTED) };
    cortex_m::asm::dsb();
    cortex_m::peripheral::SCB::sys_reset()
}

/// Goes to the bootloader if that was wanted before the reset. The first thing that the program does.
pub fn follow(rcc: &RCC, system: &SYSCFG) {
    // SAFETY: RAM always holds something, and every word is valid.
    let wanted = unsafe { request().read_volatile() } == WANTED;
    // SAFETY: as above. Once: the start after this one is a start.
    unsafe { request().write_volatile(0) };
    if wanted {
        // The bootloader's memory at address zero, as the boot pins would have it (RM0090 section 9.2.1).
        enable_clock!(rcc.apb2enr: syscfgen);
        // SAFETY: the mode of system flash, in a field of its width.
        #[allow(unused_unsafe, reason = "safe in some versions of the register definitions")]
        system.memrmp().write(|w| unsafe { w.mem_mode().bits(1) });
        // What was unmasked for this program's interrupts is masked again; then as after a reset.
        // SAFETY: every bit masks its interrupt.
        unsafe { (*cortex_m::peripheral::NVIC::PTR).icer.iter().for_each(|mask| mask.write(u32::MAX)) };
        // SAFETY: there is nothing left that could interrupt.
        unsafe { cortex_m::interrupt::enable() };
        let table = core::ptr::with_exposed_provenance::<u32>(SYSTEM_MEMORY);
        // SAFETY: the vector table of the bootloader in the chip's ROM. Nothing of this program is left running: no interrupt is enabled yet.
        unsafe { cortex_m::asm::bootload(table) }
    }
}
