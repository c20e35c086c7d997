//! What a crash leaves behind: a record in memory that a reset does not clear, and the reset itself.
//!
//! The pins of a chip in reset drive nothing, which releases the dump valve: resetting at once is the fastest way to vent.

use core::arch::naked_asm;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr;

use cortex_m::peripheral::SCB;
use firmware::crash_record::{CrashRecord, SEALED_BYTES};
use model_export::link::fault::Fault;

/// Neither loaded nor cleared at a reset.
#[unsafe(link_section = ".uninit.retained")]
static mut SEALED: MaybeUninit<[u8; SEALED_BYTES]> = MaybeUninit::uninit();

/// What survived the last reset.
pub fn crash_record() -> Option<CrashRecord> {
    // SAFETY: one thread, no interrupts; any bytes are bytes, and what is no record fails its checksum.
    let sealed = unsafe { ptr::read_volatile(ptr::addr_of!(SEALED).cast::<[u8; SEALED_BYTES]>()) };
    CrashRecord::open(&sealed)
}

/// Keeps a record across resets.
pub fn keep(crash_record: &CrashRecord) {
    // SAFETY: one thread, no interrupts, and nobody holds a reference.
    unsafe { ptr::write_volatile(ptr::addr_of_mut!(SEALED).cast::<[u8; SEALED_BYTES]>(), crash_record.encode()) };
}

/// Writes down what struck, and resets.
fn restart_after(fault: Fault) -> ! {
    let record = crash_record().map(|crash_record| crash_record.record).unwrap_or_default();
    keep(&CrashRecord { record, crash: Some(fault) });
    SCB::sys_reset()
}

#[panic_handler]
fn panic(_information: &PanicInfo) -> ! {
    restart_after(Fault::Panicked)
}

extern "C" fn hard_fault() -> ! {
    restart_after(Fault::HardFault)
}

/// Entered with a stack that may be full: it begins with a new one.
#[unsafe(naked)]
#[unsafe(no_mangle)]
extern "C" fn HardFault() -> ! {
    naked_asm!("ldr r0, =_stack_start", "msr msp, r0", "b {handler}", handler = sym hard_fault)
}

/// The vector's name for the same.
#[unsafe(naked)]
#[unsafe(no_mangle)]
extern "C" fn HardFaultTrampoline() -> ! {
    naked_asm!("b {handler}", handler = sym HardFault)
}
