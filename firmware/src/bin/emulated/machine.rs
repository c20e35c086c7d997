//! The emulated machine: the work file in its flash, a timer that counts instructions, and the stack.
//!
//! QEMU runs with `-icount shift=0,sleep=off`: each instruction then takes one nanosecond of the machine's time, whatever the host does.
//! The general-purpose timers of its STM32F405 count that time at 1 GHz, not at the clock of a real chip, so that timer 2 counts
//! instructions. It lacks the clock, CCM, DWT and flash-interface models, which is why no board code is used here.

/// Where the work file is: the upper half of the 1 MiB flash, which no image reaches.
pub const WORK_ADDRESS: usize = 0x0808_0000;
/// Longest work file.
const WORK_BYTES: usize = 512 * 1024;

/// Timer 2 (RM0090 section 18.4): control, event generation, counter, prescaler, reload.
const TIMER_CONTROL: *mut u32 = 0x4000_0000 as *mut u32;
const TIMER_EVENT: *mut u32 = 0x4000_0014 as *mut u32;
const TIMER_COUNTER: *mut u32 = 0x4000_0024 as *mut u32;
const TIMER_PRESCALER: *mut u32 = 0x4000_0028 as *mut u32;
const TIMER_RELOAD: *mut u32 = 0x4000_002c as *mut u32;

/// The work file's region, if something lies there.
pub fn work() -> Option<&'static [u8]> {
    // SAFETY: flash of the emulated machine: readable, aligned for bytes, and nothing writes it while the image runs.
    let region = unsafe { core::slice::from_raw_parts(WORK_ADDRESS as *const u8, WORK_BYTES) };
    region.starts_with(b"WORK").then_some(region)
}

/// Counts instructions.
pub struct Counter {
    /// What two readings in a row differ by.
    own: u32,
}

impl Counter {
    /// Starts the timer.
    pub fn start() -> Self {
        // SAFETY: registers of the emulated timer 2, which nothing else uses: no prescaler, the full 32 bits, loaded by an update event.
        unsafe {
            TIMER_PRESCALER.write_volatile(0);
            TIMER_RELOAD.write_volatile(u32::MAX);
            TIMER_EVENT.write_volatile(1);
            TIMER_CONTROL.write_volatile(1);
        }
        let (first, second) = (Self::now(), Self::now());
        Self { own: second.wrapping_sub(first) }
    }

    #[inline(always)]
    fn now() -> u32 {
        // SAFETY: reading the emulated timer's counter has no effect.
        unsafe { TIMER_COUNTER.read_volatile() }
    }

    /// Instructions that `work` takes, without those of counting.
    #[inline(always)]
    pub fn count<T>(&self, work: impl FnOnce() -> T) -> (u32, T) {
        let start = Self::now();
        let result = work();
        (Self::now().wrapping_sub(start).wrapping_sub(self.own), result)
    }

    /// Instructions of `turns` turns of a loop of two instructions, to check the counting itself: `2 * turns` and a constant.
    pub fn count_loop(&self, turns: u32) -> u32 {
        let count = || {
            // SAFETY: counts a register down and touches nothing else.
            unsafe {
                core::arch::asm!("2:", "subs {turns}, {turns}, #1", "bne 2b", turns = inout(reg) turns => _, options(nomem, nostack));
            }
        };
        self.count(count).0
    }
}

/// The stack below the caller, filled with a pattern to see how far down it gets used.
pub struct Stack {
    top: usize,
}

impl Stack {
    /// Bytes that are painted.
    const PAINTED: usize = 4 * 1024;
    /// Left alone, for the frames of the functions here.
    const OWN: usize = 128;
    const PATTERN: u32 = 0xa5c3_5a3c;

    /// Fills the stack from here on down.
    #[inline(always)]
    pub fn paint() -> Self {
        let top = cortex_m::register::msp::read() as usize & !3;
        for address in (top - Self::PAINTED..top - Self::OWN).step_by(4) {
            // SAFETY: memory below the stack pointer belongs to nobody; the image leaves more than this free, and no interrupt is enabled.
            unsafe { (address as *mut u32).write_volatile(Self::PATTERN) };
        }
        Self { top }
    }

    /// Bytes below the place of painting that have been used since.
    pub fn used(&self) -> usize {
        let untouched = (self.top - Self::PAINTED..self.top).step_by(4).take_while(|address| {
            // SAFETY: reads what `paint` has written, or what lay there before.
            let word = unsafe { (*address as *const u32).read_volatile() };
            word == Self::PATTERN
        });
        Self::PAINTED - 4 * untouched.count()
    }
}
