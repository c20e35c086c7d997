//! The line to the host: USART3 by interrupt, with its queues of 16 bytes (RM0433 section 48.7).

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use heapless::spsc::{Consumer, Producer, Queue};
use stm32h7::stm32h743v::{Interrupt, RCC, USART3};

use crate::board::background_task::{RECEIVE_QUEUE, TRANSMIT_QUEUE};
use crate::board::contract::LineInterrupt;
use crate::board::exchange;
use crate::board::rates::Rates;

/// Bytes from the line.
pub type ReceiveQueue = Queue<u8, RECEIVE_QUEUE>;
/// Bytes to the line.
pub type TransmitQueue = Queue<u8, TRANSMIT_QUEUE>;
/// Bits of USART_CR1 with the queues on (RM0433 section 48.7.2).
const ON: u32 = 1;
const RECEIVER: u32 = 1 << 2;
const TRANSMITTER: u32 = 1 << 3;
const RECEIVED: u32 = 1 << 5;
const ROOM: u32 = 1 << 7;
const QUEUES: u32 = 1 << 29;
/// Bits of USART_ISR and USART_ICR: overrun, noise, framing and parity errors; a byte is there; there is room for one (sections 48.7.10, 48.7.12).
const ERRORS: u32 = 0b1111;
const IS_RECEIVED: u32 = 1 << 5;
const IS_ROOM: u32 = 1 << 7;
/// Bytes moved at one go each way: a queue's length, so that no host can hold the interrupt up.
const AT_ONCE: usize = 16;

/// The queues' places.
pub struct Memory {
    receive: ReceiveQueue,
    transmit: TransmitQueue,
}

impl Memory {
    /// Empty.
    pub const fn new() -> Self {
        Self { receive: ReceiveQueue::new(), transmit: TransmitQueue::new() }
    }
}

impl Default for Memory {
    fn default() -> Self {
        Self::new()
    }
}

/// The interrupt's side.
pub struct Port {
    registers: USART3,
    received: Producer<'static, u8>,
    to_send: Consumer<'static, u8>,
}

/// The background's side.
pub struct SerialLine {
    received: Consumer<'static, u8>,
    to_send: Producer<'static, u8>,
}

/// Sets up the line.
pub fn start(rcc: &RCC, registers: USART3, rates: Rates, memory: &'static mut Memory) -> (Port, SerialLine) {
    enable_clock!(rcc.apb1lenr: usart3en);
    // SAFETY: the divider that the rates make of the line's speed; the queues before the port, as the manual wants.
    unsafe {
        registers.brr().write(|w| w.bits(u32::from(rates.link_divider())));
        registers.cr1().write(|w| w.bits(QUEUES));
        registers.cr1().write(|w| w.bits(QUEUES | ON | RECEIVER | TRANSMITTER | RECEIVED));
    }
    let (received, taken) = memory.receive.split();
    let (filled, to_send) = memory.transmit.split();
    (Port { registers, received, to_send }, SerialLine { received: taken, to_send: filled })
}

impl LineInterrupt for Port {
    fn interrupt(&mut self) {
        // Damaged and lost bytes end in a wrong checksum, a full queue as well.
        // SAFETY: flags are cleared by writing ones.
        self.registers.icr().write(|w| unsafe { w.bits(ERRORS) });
        for _ in 0..AT_ONCE {
            if self.registers.isr().read().bits() & IS_RECEIVED == 0 {
                break;
            }
            let [byte, ..] = self.registers.rdr().read().bits().to_le_bytes();
            let _ = exchange::put(&mut self.received, byte);
        }
        for _ in 0..AT_ONCE {
            if self.registers.isr().read().bits() & IS_ROOM == 0 {
                break;
            }
            let Some(byte) = exchange::take(&mut self.to_send) else { break };
            // SAFETY: eight bits of data.
            self.registers.tdr().write(|w| unsafe { w.bits(u32::from(byte)) });
        }
        let more = if self.to_send.ready() { ROOM } else { 0 };
        // SAFETY: the one bit.
        self.registers.cr1().modify(|r, w| unsafe { w.bits(r.bits() & !ROOM | more) });
    }
}

impl ErrorType for SerialLine {
    type Error = Infallible;
}

impl ReadReady for SerialLine {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.received.ready())
    }
}

impl Read for SerialLine {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        while !bytes.is_empty() && !self.received.ready() {}
        let received = core::iter::from_fn(|| self.received.dequeue());
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
        cortex_m::peripheral::NVIC::pend(Interrupt::USART3);
        Ok(taken)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        while !self.to_send.is_empty() {}
        Ok(())
    }
}
