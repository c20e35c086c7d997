//! The processor: the crate's Armv7E-M core, and the one exception that a peripheral raises past the interrupt controller.
//!
//! The clock security system's interrupt is the NMI (RM0090 section 7.2.7), which the crate's interrupt lines do not reach. Here it has a
//! line of its own, [`NMI_LINE`], behind all real ones; a core that hears it sets its own pending bit, as software would.

use std::num::{NonZeroU32, NonZeroU64};
use std::ops::Range;
use std::sync::Arc;

use rigless::cpu::armv7m::Window;
use rigless::device::Level;
use rigless::emulator::{BitAlias, CoreBus, CoreSpec, DataModel, Error, Exit, HaltReason, HostCall, InterruptLine, Processor, Queued};
use rigless::machine::armv7m::{Core, Fpu, MpuRegions, Variant};
use rigless::soc::{Endian, Width};
use rigless::time::VirtualNanos;

/// The line that stands for the NMI.
pub const NMI_LINE: u16 = 1023;
/// ICSR and its bit NMIPENDSET (Armv7-M manual section B3.2.4).
const ICSR: u64 = 0xe000_ed04;
const NMIPENDSET: u64 = 1 << 31;

/// Instructions in a second of virtual time. The real core has 168 million cycles; with five wait states behind the flash accelerator it
/// spends about one and a third of them on an instruction. Eight nanoseconds each, so that time is in whole nanoseconds.
pub const INSTRUCTIONS_PER_SECOND: u64 = 125_000_000;

/// The STM32F405's core (PM0214 sections 2, 4.2 and 4.3); its SysTick runs at `clock_hz`, whatever the clock tree does.
pub fn spec(clock_hz: NonZeroU64, interrupt_lines: NonZeroU32, windows: &[Window]) -> CoreSpec {
    let core = Core {
        variant: Variant::M4,
        clock_hz,
        interrupt_lines,
        priority_bits: 4,
        refclk_divider: const { NonZeroU32::new(8).unwrap() },
        instructions_per_second: const { NonZeroU64::new(INSTRUCTIONS_PER_SECOND).unwrap() },
        boot: "flash",
    };
    let mut spec = core.spec_with_parts(windows, Fpu::FpV4Sp, MpuRegions::Eight);
    let make = Arc::clone(&spec.processor);
    spec.processor = Arc::new(move |endian| Ok(Box::new(WithNmi { core: make(endian)? }) as Box<dyn Processor>));
    spec
}

#[derive(Debug)]
struct WithNmi {
    core: Box<dyn Processor>,
}

#[allow(unsafe_code, reason = "the trait hands host memory through")]
impl Processor for WithNmi {
    fn ask(&mut self, queued: Queued) {
        match queued {
            Queued::Line(line, level) if line.index() == NMI_LINE => {
                if level == Level::High {
                    self.core.debugger_access(Some(NMIPENDSET), ICSR, Width::W32, VirtualNanos(0));
                }
            }
            other => self.core.ask(other),
        }
    }

    // Everything else is the core's.

    fn run(&mut self, budget: u32, bus: &mut dyn CoreBus) -> (Exit, u64) {
        self.core.run(budget, bus)
    }
    fn retired(&self) -> u64 {
        self.core.retired()
    }
    fn maps(&self, start: u64, length: u64) -> bool {
        self.core.maps(start, length)
    }
    fn page_size(&self) -> u64 {
        self.core.page_size()
    }
    unsafe fn map(&mut self, start: u64, length: u64, host: *mut u8, writable: bool) {
        // SAFETY: by the caller, whose contract is the same.
        unsafe { self.core.map(start, length, host, writable) };
    }
    fn boot(&mut self, table: u64, read: &dyn Fn(u64, Width) -> Option<u64>) {
        self.core.boot(table, read);
    }
    fn reset(&mut self) {
        self.core.reset();
    }
    fn take_reset_request(&mut self) -> bool {
        self.core.take_reset_request()
    }
    fn next_event(&self) -> Option<VirtualNanos> {
        self.core.next_event()
    }
    fn on_event(&mut self, now: VirtualNanos) {
        self.core.on_event(now);
    }
    fn waiting(&self) -> bool {
        self.core.waiting()
    }
    fn pc(&self) -> u64 {
        self.core.pc()
    }
    fn add_breakpoint(&mut self, address: u64) -> bool {
        self.core.add_breakpoint(address)
    }
    fn remove_breakpoint(&mut self, address: u64) {
        self.core.remove_breakpoint(address);
    }
    fn pass_breakpoint(&mut self, address: u64) {
        self.core.pass_breakpoint(address);
    }
    fn attach_debugger(&mut self, attached: bool) {
        self.core.attach_debugger(attached);
    }
    fn hold_interrupts(&mut self, held: bool) {
        self.core.hold_interrupts(held);
    }
    fn gdb_register(&self, number: usize) -> Option<Vec<u8>> {
        self.core.gdb_register(number)
    }
    fn set_gdb_register(&mut self, number: usize, bytes: &[u8]) -> bool {
        self.core.set_gdb_register(number, bytes)
    }
    fn debugger_access(&mut self, write: Option<u64>, address: u64, width: Width, now: VirtualNanos) -> Option<u64> {
        self.core.debugger_access(write, address, width, now)
    }
    fn take_debugger_trace(&mut self) -> Vec<u8> {
        self.core.take_debugger_trace()
    }
    fn target_xml(&self) -> &'static str {
        self.core.target_xml()
    }
    fn data_model(&self) -> DataModel {
        self.core.data_model()
    }
    fn byte_order(&self, address: u64) -> Endian {
        self.core.byte_order(address)
    }
    fn save(&self) -> Vec<u8> {
        self.core.save()
    }
    fn load(&mut self, bytes: &[u8]) -> Result<(), Error> {
        self.core.load(bytes)
    }
    fn monitor_command(&mut self, command: &str) -> Option<String> {
        self.core.monitor_command(command)
    }
    fn debugger_halted(&mut self, why: HaltReason) -> bool {
        self.core.debugger_halted(why)
    }
    fn bit_alias(&self, address: u64, width: Width) -> Option<BitAlias> {
        self.core.bit_alias(address, width)
    }
    fn own_ranges(&self) -> Vec<Range<u64>> {
        self.core.own_ranges()
    }
    fn check_reads(&mut self, every: bool) {
        self.core.check_reads(every);
    }
    fn check_words(&mut self, words: &[u64]) {
        self.core.check_words(words);
    }
    fn host_call(&self, read: &mut dyn FnMut(u64, Width) -> Option<u64>) -> Option<HostCall> {
        self.core.host_call(read)
    }
    fn answer_host_call(&mut self, answer: Option<u64>) {
        self.core.answer_host_call(answer);
    }
}

/// The line as the host lends it.
pub fn nmi() -> InterruptLine {
    const { InterruptLine::new(NMI_LINE).unwrap() }
}
