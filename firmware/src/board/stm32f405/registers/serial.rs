//! The line to the host: USART1 with DMA2 both ways (RM0090 sections 10.3, 10.5, 30.3.13, 30.6).
//!
//! A byte comes every 11 us and the receiver holds two, so nobody may be late. The processor would have to interrupt the tick for that. So the
//! controller takes the bytes and writes them round and round into a buffer of a tick's worth eleven times, where the background reads them: no host can
//! cost the tick anything but single cycles of the memory. What waits to be sent goes in pieces by the same controller; its interrupt, below
//! the tick, begins the next one.

use core::convert::Infallible;
use core::sync::atomic::{AtomicU8, Ordering};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use heapless::spsc::{Consumer, Producer, Queue};
use stm32f4::stm32f405::{DMA2, Interrupt, RCC, USART1, dma2};

use crate::board::background_task::{RECEIVE_QUEUE, TRANSMIT_QUEUE};
use crate::board::circular::CircularReader;
use crate::board::clock::wait;
use crate::board::contract::LineInterrupt;
use crate::board::exchange;
use crate::board::rates::Rates;

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
/// Bytes that are sent in one piece.
const PIECE: usize = 256;

/// Bytes to the line.
pub type TransmitQueue = Queue<u8, TRANSMIT_QUEUE>;

/// The places of queue and buffers. The controller does not reach the core-coupled memory (RM0090 section 2.3.1).
pub struct Memory {
    received: [AtomicU8; RECEIVE_QUEUE],
    piece: [AtomicU8; PIECE],
    transmit: TransmitQueue,
}

impl Memory {
    /// Empty.
    pub const fn new() -> Self {
        Self {
            received: [const { AtomicU8::new(0) }; RECEIVE_QUEUE],
            piece: [const { AtomicU8::new(0) }; PIECE],
            transmit: TransmitQueue::new(),
        }
    }
}

impl Default for Memory {
    fn default() -> Self {
        Self::new()
    }
}

/// A stream's registers.
fn stream(number: usize) -> &'static dma2::ST {
    // SAFETY: they are always there. Each of the two streams has one side that writes it, once [`start`] has returned.
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
    }
    // What was written into the buffer is there before the controller reads it.
    cortex_m::asm::dmb();
    // SAFETY: the bits above.
    registers.cr().write(|w| unsafe { w.bits(CONTROL | control | ENABLE) });
}

fn begin_to_receive(memory: &'static [AtomicU8; RECEIVE_QUEUE]) {
    // SAFETY: a flag is cleared by a one, and no other flag is touched.
    unsafe { (*DMA2::ptr()).lifcr().write(|w| w.bits(RECEIVE_FLAGS)) };
    begin(RECEIVE_STREAM, CIRCULAR, memory, u32::try_from(RECEIVE_QUEUE).unwrap_or(0));
}

/// A byte from the receiver itself. A controller that does not begin costs bytes and time, not the line; the emulated chip has none.
fn received_without_controller() -> Option<u8> {
    // SAFETY: the line's registers have no other owner. Reading status and then data clears the flags.
    let registers = unsafe { &*USART1::ptr() };
    let status = registers.sr().read();
    (status.rxne().bit_is_set() || status.ore().bit_is_set()).then(|| {
        let [byte, _] = registers.dr().read().dr().bits().to_le_bytes();
        byte
    })
}

/// The same the other way, in the time of a byte.
fn send_without_controller(byte: u8) {
    // SAFETY: as above; eight bits of data.
    let registers = unsafe { &*USART1::ptr() };
    let _ = wait(LONGEST_POLLS, || registers.sr().read().txe().bit_is_set());
    // SAFETY: eight bits of data.
    registers.dr().write(|w| unsafe { w.bits(u16::from(byte)) });
}

/// An address as the controller takes it: 32 bits, as all of them here.
fn address<T>(place: *const T) -> u32 {
    u32::try_from(place.addr()).unwrap_or(0)
}

/// The interrupt's side.
pub struct Port {
    piece: &'static [AtomicU8; PIECE],
    to_send: Consumer<'static, u8>,
}

/// The background's side.
pub struct SerialLine {
    received: &'static [AtomicU8; RECEIVE_QUEUE],
    reader: CircularReader,
    /// What was looked at and not yet read.
    next: Option<u8>,
    to_send: Producer<'static, u8>,
}

/// Sets up the line.
pub fn start(rcc: &RCC, registers: USART1, _controller: DMA2, rates: Rates, memory: &'static mut Memory) -> (Port, SerialLine) {
    enable_clock!(rcc.apb2enr: usart1en);
    enable_clock!(rcc.ahb1enr: dma2en);
    let Memory { received, piece, transmit } = memory;
    let (received, piece) = (&*received, &*piece);
    begin_to_receive(received);
    // SAFETY: the divider that the rates make of the line's speed.
    registers.brr().write(|w| unsafe { w.bits(rates.link_divider()) });
    registers.cr3().write(|w| w.dmar().set_bit().dmat().set_bit());
    registers.cr1().write(|w| w.ue().set_bit().te().set_bit().re().set_bit());
    let (filled, to_send) = transmit.split();
    (Port { piece, to_send }, SerialLine { received, reader: CircularReader::default(), next: None, to_send: filled })
}

impl LineInterrupt for Port {
    fn interrupt(&mut self) {
        if is_on(TRANSMIT_STREAM) {
            return;
        }
        // SAFETY: as in `begin_to_receive`.
        unsafe { (*DMA2::ptr()).hifcr().write(|w| w.bits(TRANSMIT_FLAGS)) };
        let mut bytes = 0;
        for place in self.piece {
            let Some(byte) = exchange::take(&mut self.to_send) else { break };
            place.store(byte, Ordering::Relaxed);
            bytes += 1;
        }
        if bytes > 0 {
            begin(TRANSMIT_STREAM, FROM_MEMORY | WHEN_COMPLETE, self.piece, bytes);
            // SAFETY: reading flags has no effect.
            let is_done = unsafe { (*DMA2::ptr()).hisr().read().bits() } & TRANSMIT_COMPLETE != 0;
            if !is_on(TRANSMIT_STREAM) && !is_done {
                self.piece.iter().zip(0..bytes).for_each(|(byte, _)| send_without_controller(byte.load(Ordering::Relaxed)));
                // What came meanwhile.
                cortex_m::peripheral::NVIC::pend(Interrupt::DMA2_STREAM7);
            }
        }
    }
}

impl SerialLine {
    /// The next byte that came.
    fn receive(&mut self) -> Option<u8> {
        if !is_on(RECEIVE_STREAM) {
            // Only an error of the bus ends it.
            self.reader.restart();
            begin_to_receive(self.received);
            if !is_on(RECEIVE_STREAM) {
                return received_without_controller();
            }
        }
        let remaining = usize::try_from(stream(RECEIVE_STREAM).ndtr().read().bits()).unwrap_or(0);
        let place = self.reader.take(RECEIVE_QUEUE, remaining)?;
        self.received.get(place).map(|byte| byte.load(Ordering::Relaxed))
    }
}

impl ErrorType for SerialLine {
    type Error = Infallible;
}

impl ReadReady for SerialLine {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        if self.next.is_none() {
            self.next = self.receive();
        }
        Ok(self.next.is_some())
    }
}

impl Read for SerialLine {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        while !bytes.is_empty() && !matches!(self.read_ready(), Ok(true)) {}
        let received = core::iter::from_fn(|| self.next.take().or_else(|| self.receive()));
        Ok(bytes.iter_mut().zip(received).map(|(byte, new)| *byte = new).count())
    }
}

impl WriteReady for SerialLine {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.to_send.ready())
    }
}

impl Write for SerialLine {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        while !bytes.is_empty() && !self.to_send.ready() {}
        let taken = bytes.iter().take_while(|byte| self.to_send.enqueue(**byte).is_ok()).count();
        // The interrupt begins to send, and goes on by itself.
        cortex_m::peripheral::NVIC::pend(Interrupt::DMA2_STREAM7);
        Ok(taken)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        while !self.to_send.is_empty() {}
        Ok(())
    }
}
