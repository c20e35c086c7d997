//! What the linker knows: the program's pieces, its seal, and the stack.

use core::ptr;

use cortex_m_rt::STACK_PAINT_VALUE;

/// First word of a seal that was made; see [`Seal`].
pub const SEALED: u32 = u32::from_le_bytes(*b"SEAL");
/// First word of a seal that waits for `cargo xtask firmware`.
pub const OPEN: u32 = u32::from_le_bytes(*b"OPEN");

unsafe extern "C" {
    static __vector_table: u8;
    static __vector_table_end: u8;
    static __stext: u8;
    static __etext: u8;
    static __srodata: u8;
    static __erodata: u8;
    static __sdata: u8;
    static __edata: u8;
    static __sidata: u8;
    static _stack_start: u32;
    static _stack_end: u32;
}

/// The program's checksum, written into the finished image: a word that says whether it is there, and the CRC-32 over all pieces.
#[unsafe(link_section = ".seal")]
#[used]
static SEAL: [u32; 2] = [OPEN, 0];

/// The CRC-32 that the image was sealed with; `None` if it was not.
pub fn image_crc() -> Option<u32> {
    // SAFETY: a static of ours; volatile, because it is changed after the compiler saw it.
    let [state, crc32] = unsafe { ptr::read_volatile(&raw const SEAL) };
    (state == SEALED).then_some(crc32)
}

/// Whether a debug probe is attached (DHCSR.C_DEBUGEN, Armv7-M manual section C1.6.2).
pub fn is_debugged() -> bool {
    cortex_m::peripheral::DCB::is_debugger_attached()
}

/// The program in flash: vector table, code, constants, initial data.
pub fn program() -> [&'static [u8]; 4] {
    // SAFETY: symbols of the linker script; each pair encloses a section that is in flash and never changes.
    unsafe {
        [
            between(&raw const __vector_table, &raw const __vector_table_end),
            between(&raw const __stext, &raw const __etext),
            between(&raw const __srodata, &raw const __erodata),
            core::slice::from_raw_parts(&raw const __sidata, length(&raw const __sdata, &raw const __edata)),
        ]
    }
}

unsafe fn between(first: *const u8, end: *const u8) -> &'static [u8] {
    // SAFETY: by the caller.
    unsafe { core::slice::from_raw_parts(first, length(first, end)) }
}

fn length(first: *const u8, end: *const u8) -> usize {
    end.addr().saturating_sub(first.addr())
}

/// Bytes of the stack that were never used: what still carries the paint of the start.
pub fn stack_unused_bytes() -> u32 {
    let (mut word, top) = (&raw const _stack_end, &raw const _stack_start);
    let mut bytes = 0;
    // SAFETY: words of the stack's region; volatile, because they belong to whoever runs.
    while word < top && unsafe { word.read_volatile() } == STACK_PAINT_VALUE {
        bytes += 4;
        word = word.wrapping_add(1);
    }
    bytes
}
