//! The line to the host: USART1 with DMA2 both ways (RM0090 sections 10.3, 10.5, 30.3.13, 30.6).

use core::sync::atomic::AtomicU8;

use stm32f4::stm32f405::{DMA2, Interrupt, RCC, USART1, dma2};

use crate::board::clock::wait;
use crate::board::rates::Rates;
use crate::board::transfer_line::{self, Buffers, TransferController, TransmitQueue};

/// Streams of the controller that USART1's requests reach, on [`CHANNEL`] (RM0090 table 43).
const RECEIVE_STREAM: usize = 2;
const TRANSMIT_STREAM: usize = 7;
const CHANNEL: u32 = 4;
/// SxCR: channel, memory address counts up, medium priority (RM0090 section 10.5.5).
const CONTROL: u32 = CHANNEL << 25 | 0b01 << 16 | 1 << 10;
const CIRCULAR: u32 = 1 << 8;
const FROM_MEMORY: u32 = 0b01 << 6;
const WHEN_COMPLETE: u32 = 1 << 4;
const ENABLE: u32 = 1 << 0;
/// All flags of the streams, in LIFCR and HIFCR (RM0090 sections 10.5.3 and 10.5.4).
const RECEIVE_FLAGS: u32 = 0b11_1101 << 16;
const TRANSMIT_FLAGS: u32 = 0b11_1101 << 22;
/// TCIF7 in HISR (RM0090 section 10.5.2).
const TRANSMIT_COMPLETE: u32 = 1 << 27;
/// Polls of the sender that are surely longer than a byte.
const LONGEST_POLLS: u32 = 4096;

/// The interrupt's side.
pub type Port = transfer_line::Port<Controller>;
/// The background's side.
pub type SerialLine = transfer_line::SerialLine<Controller>;

/// The places of queue and buffers. The controller does not reach the core-coupled memory (RM0090 section 2.3.1).
#[derive(Default)]
pub struct Memory {
    buffers: Buffers,
    transmit: TransmitQueue,
}

impl Memory {
    /// Empty.
    pub const fn new() -> Self {
        Self { buffers: Buffers::new(), transmit: TransmitQueue::new() }
    }
}

/// Port and streams; each stream has one side that writes it, once [`start`] has returned.
#[derive(Clone, Copy, Debug)]
pub struct Controller(());

/// Sets up the line.
pub fn start(rcc: &RCC, registers: USART1, _controller: DMA2, rates: Rates, memory: &'static mut Memory) -> (Port, SerialLine) {
    enable_clock!(rcc.apb2enr: usart1en);
    enable_clock!(rcc.ahb1enr: dma2en);
    let Memory { buffers, transmit } = memory;
    let sides = transfer_line::start(Controller(()), buffers, transmit);
    // SAFETY: the divider that the rates make of the line's speed.
    registers.brr().write(|w| unsafe { w.bits(rates.link_divider()) });
    registers.cr3().write(|w| w.dmar().set_bit().dmat().set_bit());
    registers.cr1().write(|w| w.ue().set_bit().te().set_bit().re().set_bit());
    sides
}

fn stream(number: usize) -> &'static dma2::ST {
    // SAFETY: the registers are always there, and who writes them stands at `Controller`.
    unsafe { (*DMA2::ptr()).st(number) }
}

fn is_on(number: usize) -> bool {
    stream(number).cr().read().bits() & ENABLE != 0
}

/// Lets a stream move bytes between the line and memory.
fn begin(number: usize, control: u32, memory: &'static [AtomicU8], bytes: u32) {
    let registers = stream(number);
    // SAFETY: the line's data register, and bytes of a buffer that lives for ever and that the program knows to change by itself. To take the
    // register's address has no effect.
    unsafe {
        registers.par().write(|w| w.bits(address((*USART1::ptr()).dr().as_ptr())));
        registers.m0ar().write(|w| w.bits(address(memory.as_ptr())));
        registers.ndtr().write(|w| w.bits(bytes));
        registers.cr().write(|w| w.bits(CONTROL | control | ENABLE));
    }
}

/// An address as the controller takes it: 32 bits, as all of them here.
fn address<T>(place: *const T) -> u32 {
    u32::try_from(place.addr()).unwrap_or(0)
}

impl TransferController for Controller {
    fn begin_to_receive(&self, memory: &'static [AtomicU8]) {
        // SAFETY: a flag is cleared by a one, and no other flag is touched.
        unsafe { (*DMA2::ptr()).lifcr().write(|w| w.bits(RECEIVE_FLAGS)) };
        begin(RECEIVE_STREAM, CIRCULAR, memory, u32::try_from(memory.len()).unwrap_or(0));
    }

    fn is_receiving(&self) -> bool {
        is_on(RECEIVE_STREAM)
    }

    fn remaining(&self) -> usize {
        usize::try_from(stream(RECEIVE_STREAM).ndtr().read().bits()).unwrap_or(0)
    }

    fn begin_to_send(&self, memory: &'static [AtomicU8], bytes: u32) {
        begin(TRANSMIT_STREAM, FROM_MEMORY | WHEN_COMPLETE, memory, bytes);
    }

    fn is_sending(&self) -> bool {
        is_on(TRANSMIT_STREAM)
    }

    fn is_sent(&self) -> bool {
        // SAFETY: reading flags has no effect.
        unsafe { (*DMA2::ptr()).hisr().read().bits() & TRANSMIT_COMPLETE != 0 }
    }

    fn forget_sent(&self) {
        // SAFETY: as in `begin_to_receive`.
        unsafe { (*DMA2::ptr()).hifcr().write(|w| w.bits(TRANSMIT_FLAGS)) };
    }

    fn pend(&self) {
        cortex_m::peripheral::NVIC::pend(Interrupt::DMA2_STREAM7);
    }

    fn received_byte(&self) -> Option<u8> {
        // SAFETY: the line's registers have no other owner. Reading status and then data clears the flags.
        let registers = unsafe { &*USART1::ptr() };
        let status = registers.sr().read();
        (status.rxne().bit_is_set() || status.ore().bit_is_set()).then(|| {
            let [byte, _] = registers.dr().read().dr().bits().to_le_bytes();
            byte
        })
    }

    fn send_byte(&self, byte: u8) {
        // SAFETY: as above.
        let registers = unsafe { &*USART1::ptr() };
        let _ = wait(LONGEST_POLLS, || registers.sr().read().txe().bit_is_set());
        // SAFETY: eight bits of data.
        registers.dr().write(|w| unsafe { w.bits(u16::from(byte)) });
    }
}
