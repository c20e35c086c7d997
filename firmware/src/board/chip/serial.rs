//! The line to the host: USART1 by interrupt (RM0090 section 30.6).
//!
//! The interrupt stands above the tick: a byte comes every 11 us, and the receiver holds two. It moves one byte and is gone after half a
//! microsecond; at the full rate of the line that is 5 % of the tick's time each way, and no host can make it more.

use heapless::spsc::{Consumer, Producer, Queue};
use stm32f4::stm32f405::{Interrupt, RCC, USART1};

use crate::board::background_task::Line;
use crate::board::exchange;
use crate::board::hardware::{RECEIVE_QUEUE, Rates, TRANSMIT_QUEUE};

/// Bytes from the line.
pub type ReceiveQueue = Queue<u8, RECEIVE_QUEUE>;
/// Bytes to the line.
pub type TransmitQueue = Queue<u8, TRANSMIT_QUEUE>;

/// The interrupt's side.
pub struct Port {
    registers: USART1,
    received: Producer<'static, u8>,
    to_send: Consumer<'static, u8>,
}

/// The background's side.
pub struct SerialLine {
    received: Consumer<'static, u8>,
    to_send: Producer<'static, u8>,
}

/// Sets up the line.
pub fn start(
    rcc: &RCC,
    registers: USART1,
    rates: Rates,
    receive: &'static mut ReceiveQueue,
    transmit: &'static mut TransmitQueue,
) -> (Port, SerialLine) {
    enable_clock!(rcc.apb2enr: usart1en);
    // SAFETY: the divider that the rates make of the line's speed.
    registers.brr().write(|w| unsafe { w.bits(rates.link_divider()) });
    registers.cr1().write(|w| w.ue().set_bit().te().set_bit().re().set_bit().rxneie().set_bit());
    let (received, taken) = receive.split();
    let (filled, to_send) = transmit.split();
    (Port { registers, received, to_send }, SerialLine { received: taken, to_send: filled })
}

impl Port {
    /// Moves what there is to move.
    pub fn interrupt(&mut self) {
        let status = self.registers.sr().read();
        if status.rxne().bit_is_set() || status.ore().bit_is_set() {
            // Reading status and then data clears both flags. Damaged and lost bytes end in a wrong checksum, a full queue as well.
            let [byte, _] = self.registers.dr().read().dr().bits().to_le_bytes();
            let _ = exchange::put(&mut self.received, byte);
        }
        while self.registers.sr().read().txe().bit_is_set() {
            let Some(byte) = exchange::take(&mut self.to_send) else { break };
            // SAFETY: eight bits of data.
            self.registers.dr().write(|w| unsafe { w.bits(u16::from(byte)) });
        }
        let more = self.to_send.ready();
        self.registers.cr1().modify(|_, w| w.txeie().bit(more));
    }
}

impl Line for SerialLine {
    fn receive(&mut self) -> Option<u8> {
        self.received.dequeue()
    }

    fn room(&self) -> usize {
        self.to_send.capacity() - self.to_send.len()
    }

    fn send(&mut self, bytes: &[u8]) {
        for byte in bytes {
            // The caller has looked at the room.
            let _ = self.to_send.enqueue(*byte);
        }
        // The interrupt begins to send, and goes on by itself.
        cortex_m::peripheral::NVIC::pend(Interrupt::USART1);
    }
}
