//! The line to the host: USART3 with DMA1 both ways, through DMAMUX1 (RM0433 sections 15.5, 17.3.2, 48.5.19, 48.8).
//!
//! DMA1 does not reach the data TCM (RM0433 table 3), so the buffers lie in SRAM1, which no cache stands before (`stm32h743::regions`).

use core::ptr;
use core::sync::atomic::AtomicU8;

use stm32h7::stm32h743v::{DMA1, DMAMUX1, Interrupt, RCC, USART3, dma1};

use crate::board::clock::wait;
use crate::board::rates::Rates;
use crate::board::transfer_line::{self, Buffers, TransferController, TransmitQueue};

/// Streams of the controller; each hears the multiplexer's channel of its number (RM0433 section 17.3.2).
const RECEIVE_STREAM: usize = 0;
const TRANSMIT_STREAM: usize = 1;
/// The multiplexer's inputs `usart3_rx_dma` and `usart3_tx_dma` (RM0433 table 124).
const RECEIVE_REQUEST: u32 = 45;
const TRANSMIT_REQUEST: u32 = 46;
/// SxCR: TRBUFF, without which a stream that serves a USART may lock (ES0392 section 2.20.4), memory address counts up, medium priority
/// (RM0433 section 15.5.5).
const CONTROL: u32 = 1 << 20 | 0b01 << 16 | 1 << 10;
const CIRCULAR: u32 = 1 << 8;
const FROM_MEMORY: u32 = 0b01 << 6;
const WHEN_COMPLETE: u32 = 1 << 4;
const ENABLE: u32 = 1 << 0;
/// All flags of the streams, in LIFCR (RM0433 section 15.5.3), and TCIF1 in LISR (section 15.5.1).
const RECEIVE_FLAGS: u32 = 0b11_1101;
const TRANSMIT_FLAGS: u32 = 0b11_1101 << 6;
const TRANSMIT_COMPLETE: u32 = 1 << 11;
/// Bits of USART_CR1: on, receiver, transmitter, queues (RM0433 section 48.8.1), and of USART_CR3: transfers both ways (section 48.8.4). No
/// error holds reception up, since DDRE is off: a damaged byte ends in a wrong checksum.
const ON: u32 = 1;
const RECEIVER: u32 = 1 << 2;
const TRANSMITTER: u32 = 1 << 3;
const QUEUES: u32 = 1 << 29;
const TRANSFERS: u32 = 1 << 6 | 1 << 7;
/// Bits of USART_ISR: a byte is there; there is room for one (RM0433 section 48.8.9).
const IS_RECEIVED: u32 = 1 << 5;
const IS_ROOM: u32 = 1 << 7;
/// Polls of the sender that are surely longer than a byte.
const LONGEST_POLLS: u32 = 16_384;

/// The interrupt's side.
pub type Port = transfer_line::Port<Controller>;
/// The background's side.
pub type SerialLine = transfer_line::SerialLine<Controller>;
/// The queue's place.
pub type Memory = TransmitQueue;

/// Nothing sets this memory up but [`start`].
#[unsafe(link_section = ".shared")]
static BUFFERS: Buffers = Buffers::new();

/// Port and streams; each stream has one side that writes it, once [`start`] has returned.
#[derive(Clone, Copy, Debug)]
pub struct Controller(());

/// Sets up the line.
pub fn start(
    rcc: &RCC,
    registers: USART3,
    _controller: DMA1,
    multiplexer: &DMAMUX1,
    rates: Rates,
    memory: &'static mut Memory,
) -> (Port, SerialLine) {
    enable_clock!(rcc.ahb2enr: sram1en);
    enable_clock!(rcc.ahb1enr: dma1en);
    enable_clock!(rcc.apb1lenr: usart3en);
    let place = ptr::from_ref(&BUFFERS).cast::<u32>().cast_mut();
    for word in 0..size_of::<Buffers>() / size_of::<u32>() {
        // SAFETY: whole words of the buffers, which nobody knows yet. They are atomics, which may be written through a shared reference; the
        // memory has a checksum for each word, so it is written before it is read.
        unsafe { place.add(word).write_volatile(0) };
    }
    // SAFETY: the inputs of the two channels; the divider that the rates make of the line's speed; queues before the port, as the manual wants.
    unsafe {
        multiplexer.ccr(RECEIVE_STREAM).write(|w| w.bits(RECEIVE_REQUEST));
        multiplexer.ccr(TRANSMIT_STREAM).write(|w| w.bits(TRANSMIT_REQUEST));
        registers.brr().write(|w| w.bits(u32::from(rates.link_divider())));
        registers.cr3().write(|w| w.bits(TRANSFERS));
        registers.cr1().write(|w| w.bits(QUEUES));
    }
    let sides = transfer_line::start(Controller(()), &BUFFERS, memory);
    // SAFETY: the bits above.
    unsafe { registers.cr1().write(|w| w.bits(QUEUES | ON | RECEIVER | TRANSMITTER)) };
    sides
}

fn stream(number: usize) -> &'static dma1::ST {
    // SAFETY: the registers are always there, and who writes them stands at `Controller`.
    unsafe { (*DMA1::ptr()).st(number) }
}

fn is_on(number: usize) -> bool {
    stream(number).cr().read().bits() & ENABLE != 0
}

/// Lets a stream move bytes between the line and memory.
fn begin(number: usize, control: u32, register: u32, memory: &'static [AtomicU8], bytes: u32) {
    let registers = stream(number);
    // SAFETY: a data register of the line, and bytes of a buffer that lives for ever and that the program knows to change by itself.
    unsafe {
        registers.par().write(|w| w.bits(register));
        registers.m0ar().write(|w| w.bits(address(memory.as_ptr())));
        registers.ndtr().write(|w| w.bits(bytes));
        registers.cr().write(|w| w.bits(CONTROL | control | ENABLE));
    }
}

/// An address as the controller takes it: 32 bits, as all of them here.
fn address<T>(place: *const T) -> u32 {
    u32::try_from(place.addr()).unwrap_or(0)
}

/// The line's registers. To take the address of one has no effect.
fn line() -> &'static stm32h7::stm32h743v::usart1::RegisterBlock {
    // SAFETY: they are always there and have no other owner once `start` has returned.
    unsafe { &*USART3::ptr() }
}

impl TransferController for Controller {
    fn begin_to_receive(&self, memory: &'static [AtomicU8]) {
        // SAFETY: a flag is cleared by a one, and no other flag is touched.
        unsafe { (*DMA1::ptr()).lifcr().write(|w| w.bits(RECEIVE_FLAGS)) };
        begin(RECEIVE_STREAM, CIRCULAR, address(line().rdr().as_ptr()), memory, u32::try_from(memory.len()).unwrap_or(0));
    }

    fn is_receiving(&self) -> bool {
        is_on(RECEIVE_STREAM)
    }

    fn remaining(&self) -> usize {
        usize::try_from(stream(RECEIVE_STREAM).ndtr().read().bits()).unwrap_or(0)
    }

    fn begin_to_send(&self, memory: &'static [AtomicU8], bytes: u32) {
        begin(TRANSMIT_STREAM, FROM_MEMORY | WHEN_COMPLETE, address(line().tdr().as_ptr()), memory, bytes);
    }

    fn is_sending(&self) -> bool {
        is_on(TRANSMIT_STREAM)
    }

    fn is_sent(&self) -> bool {
        // SAFETY: reading flags has no effect.
        unsafe { (*DMA1::ptr()).lisr().read().bits() & TRANSMIT_COMPLETE != 0 }
    }

    fn forget_sent(&self) {
        // SAFETY: as in `begin_to_receive`.
        unsafe { (*DMA1::ptr()).lifcr().write(|w| w.bits(TRANSMIT_FLAGS)) };
    }

    fn pend(&self) {
        cortex_m::peripheral::NVIC::pend(Interrupt::DMA_STR1);
    }

    fn received_byte(&self) -> Option<u8> {
        (line().isr().read().bits() & IS_RECEIVED != 0).then(|| {
            let [byte, ..] = line().rdr().read().bits().to_le_bytes();
            byte
        })
    }

    fn send_byte(&self, byte: u8) {
        let _ = wait(LONGEST_POLLS, || line().isr().read().bits() & IS_ROOM != 0);
        // SAFETY: eight bits of data.
        line().tdr().write(|w| unsafe { w.bits(u32::from(byte)) });
    }
}
