//! Processor in the loop: the whole device as ARM code in QEMU (`-M netduinoplus2`), its hardware and its host on the other end of two lines.
//!
//! The serial port USART1 is the link, with the bytes that a board's link carries. The semihosting console takes the place of converter, valve
//! and reset circuit: once a tick the host says what the sensors read and the device says what its pins do
//! (`firmware::device::exchange`). Both move in lock step, so nothing depends on how fast the emulator is. Flash lies in the chip's flash
//! memory and is kept in the file `flash.bin`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod crash;
#[cfg(target_os = "none")]
mod flash;
#[cfg(target_os = "none")]
mod hardware;
#[cfg(target_os = "none")]
mod place;
#[cfg(target_os = "none")]
mod uart;

#[cfg(target_os = "none")]
mod target {
    use core::mem::MaybeUninit;
    use core::ptr;

    use cortex_m_rt::entry;
    use firmware::calibration::ConverterConfig;
    use firmware::crash_record::CrashRecord;
    use firmware::device::exchange::{DeviceOutputs, FromDevice, FromHost, InjectedFault};
    use firmware::device::{Device, DeviceConfig};
    use firmware::tick::{RigFacts, TickOutputs};
    use model_export::link::state::ResetCause;

    use crate::crash;
    use crate::flash::{Memory, SlotPair};
    use crate::hardware::Hardware;
    use crate::place::Buffer;
    use crate::uart::Uart;

    /// The board's converter: two conversions of 12 bits summed, 3.3 V reference.
    const FACTS: RigFacts = RigFacts { converter: ConverterConfig { full_scale_code: 8190, full_scale_v: 3.3 } };

    type Emulated = Device<SlotPair, SlotPair, Buffer>;

    #[entry]
    fn main() -> ! {
        let mut link = Uart::usart1();
        let mut hardware = Hardware::open();
        let crash_record = crash::crash_record();
        hardware.write(&FromDevice::BootRequest { crash: crash_record.and_then(|crash_record| crash_record.crash) }.encode());
        let (reset_cause, line_bytes_per_tick) = loop {
            if let Some(FromHost::Boot { reset_cause, line_bytes_per_tick }) = FromHost::decode(&hardware.read()) {
                break (reset_cause, line_bytes_per_tick);
            }
        };
        run(&mut link, &mut hardware, crash_record, reset_cause, line_bytes_per_tick)
    }

    #[inline(never)]
    fn run(
        link: &mut Uart,
        hardware: &mut Hardware,
        crash_record: Option<CrashRecord>,
        reset_cause: ResetCause,
        line_bytes_per_tick: u16,
    ) -> ! {
        let board = heapless::String::try_from("qemu").unwrap_or_default();
        let config = DeviceConfig { firmware: firmware::VERSION, board, reset_cause, crash_record, facts: FACTS, line_bytes_per_tick };
        let memory = Memory::open();
        let device = settle(config, &memory);
        loop {
            // An empty frame only wakes the emulator.
            let Some(FromHost::Inputs { inputs, link_bytes, injected }) = FromHost::decode(&hardware.read()) else { continue };
            for _ in 0..link_bytes {
                device.receive(link.read_byte());
            }
            obey(injected);
            let outputs = device.tick(inputs);
            if outputs.record_changed {
                crash::keep(&CrashRecord { record: *device.record(), crash: None });
            }
            let bytes = device.transmit();
            let link_bytes = u16::try_from(bytes.len()).unwrap_or(u16::MAX);
            hardware.write(&FromDevice::Outputs(seen(&outputs, link_bytes)).encode());
            link.write(&bytes);
        }
    }

    /// The device in memory of its own: with the model's state it is too long for the stack.
    #[inline(never)]
    fn settle(config: DeviceConfig, memory: &Memory) -> &'static mut Emulated {
        static mut PLACE: MaybeUninit<Emulated> = MaybeUninit::uninit();
        let Ok(device) = Device::new(config, memory.settings(), memory.models(), Buffer::take()) else {
            panic!("the default settings do not go together");
        };
        // SAFETY: called once a start, and nothing else names the place.
        unsafe { (*ptr::addr_of_mut!(PLACE)).write(device) }
    }

    fn seen(outputs: &TickOutputs, link_bytes: u16) -> DeviceOutputs {
        DeviceOutputs {
            energised: outputs.energised,
            feed_watchdog: outputs.feed_watchdog,
            state: outputs.state,
            valve_share: outputs.valve_share,
            output_ubar: outputs.output.0,
            link_bytes,
        }
    }

    /// What a test of the safety net wants to go wrong.
    fn obey(injected: InjectedFault) {
        match injected {
            InjectedFault::None => {}
            InjectedFault::Hang => loop {
                cortex_m::asm::nop();
            },
            InjectedFault::StackOverflow => {
                core::hint::black_box(deeper(&[0; 64]));
            }
            InjectedFault::Panic => panic!("on purpose"),
        }
    }

    /// Calls itself for ever; the buffer and its use after the call keep the compiler from turning that into a loop.
    #[inline(never)]
    #[expect(unconditional_recursion, reason = "to fill the stack is what it is for")]
    fn deeper(above: &[u32; 64]) -> u32 {
        let mut here = *above;
        here[0] = here[0].wrapping_add(1);
        let below = deeper(core::hint::black_box(&here));
        below.wrapping_add(here[usize::from(below != 0)])
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this program runs in the emulator; build it with --target thumbv7em-none-eabihf, `catheter pil` starts it");
}
