//! A line to the host whose bytes a transfer controller moves, both ways.
//!
//! A byte comes every 11 us and a receiver holds few, so nobody may be late. The processor would have to interrupt the tick for that. So the
//! controller takes the bytes and writes them round and round into a buffer of a tick's worth eleven times, where the background reads them:
//! no host can cost the tick anything but single cycles of the memory. What waits to be sent goes in pieces by the same controller; its
//! interrupt, below the tick, begins the next one.

use core::convert::Infallible;
use core::sync::atomic::{AtomicU8, Ordering, fence};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use heapless::spsc::{Consumer, Producer, Queue};

use super::background_task::{RECEIVE_QUEUE, TRANSMIT_QUEUE};
use super::circular::CircularReader;
use super::contract::LineInterrupt;
use super::shared_atomics;

/// Bytes that are sent in one piece.
const PIECE: usize = 256;

/// Bytes to the line.
pub type TransmitQueue = Queue<u8, TRANSMIT_QUEUE>;

/// What the controller reads and writes; it must reach this memory, and no cache may stand before it.
#[repr(align(4))]
pub struct Buffers {
    received: [AtomicU8; RECEIVE_QUEUE],
    piece: [AtomicU8; PIECE],
}

impl Buffers {
    /// Empty.
    pub const fn new() -> Self {
        Self { received: [const { AtomicU8::new(0) }; RECEIVE_QUEUE], piece: [const { AtomicU8::new(0) }; PIECE] }
    }
}

impl Default for Buffers {
    fn default() -> Self {
        Self::new()
    }
}

/// A serial port and the controller's two streams for it, as the chip's registers show them.
pub trait TransferController {
    /// Lets the controller write what comes into `memory`, round and round.
    fn begin_to_receive(&self, memory: &'static [AtomicU8]);
    /// Whether it does; only an error of the bus ends it.
    fn is_receiving(&self) -> bool;
    /// Bytes that are left of the round.
    fn remaining(&self) -> usize;
    /// Lets it send the first `bytes` of `memory`.
    fn begin_to_send(&self, memory: &'static [AtomicU8], bytes: u32);
    /// Whether it does.
    fn is_sending(&self) -> bool;
    /// Whether it has sent everything since [`Self::forget_sent`].
    fn is_sent(&self) -> bool;
    /// Clears what it says of the last piece.
    fn forget_sent(&self);
    /// Makes the end of a piece happen now, for the interrupt.
    fn pend(&self);
    /// A byte from the receiver itself. A controller that does not begin costs bytes and time, not the line; the emulated chip has none.
    fn received_byte(&self) -> Option<u8>;
    /// The same the other way, in the time of a byte.
    fn send_byte(&self, byte: u8);
}

/// The interrupt's side.
pub struct Port<C> {
    controller: C,
    piece: &'static [AtomicU8; PIECE],
    to_send: Consumer<'static, u8>,
}

/// The background's side.
pub struct SerialLine<C> {
    controller: C,
    received: &'static [AtomicU8; RECEIVE_QUEUE],
    reader: CircularReader,
    /// What was looked at and not yet read.
    next: Option<u8>,
    to_send: Producer<'static, u8>,
}

/// Both sides of a line that is set up but for its reception, which begins here.
pub fn start<C: TransferController + Clone>(
    controller: C,
    buffers: &'static Buffers,
    transmit: &'static mut TransmitQueue,
) -> (Port<C>, SerialLine<C>) {
    let Buffers { received, piece } = buffers;
    controller.begin_to_receive(received);
    let (filled, to_send) = transmit.split();
    let line = SerialLine { controller: controller.clone(), received, reader: CircularReader::default(), next: None, to_send: filled };
    (Port { controller, piece, to_send }, line)
}

impl<C: TransferController> LineInterrupt for Port<C> {
    fn interrupt(&mut self) {
        if self.controller.is_sending() {
            return;
        }
        self.controller.forget_sent();
        let mut bytes = 0;
        for place in self.piece {
            let Some(byte) = shared_atomics::take(&mut self.to_send) else { break };
            place.store(byte, Ordering::Relaxed);
            bytes += 1;
        }
        if bytes > 0 {
            // What was written into the piece is there before the controller reads it.
            fence(Ordering::Release);
            self.controller.begin_to_send(self.piece, bytes);
            if !self.controller.is_sending() && !self.controller.is_sent() {
                self.piece.iter().zip(0..bytes).for_each(|(byte, _)| self.controller.send_byte(byte.load(Ordering::Relaxed)));
                // What came meanwhile.
                self.controller.pend();
            }
        }
    }
}

impl<C: TransferController> SerialLine<C> {
    /// The next byte that came.
    fn receive(&mut self) -> Option<u8> {
        if !self.controller.is_receiving() {
            self.reader.restart();
            self.controller.begin_to_receive(self.received);
            if !self.controller.is_receiving() {
                return self.controller.received_byte();
            }
        }
        let place = self.reader.take(RECEIVE_QUEUE, self.controller.remaining())?;
        // The byte is read after the count that says it is there.
        fence(Ordering::Acquire);
        self.received.get(place).map(|byte| byte.load(Ordering::Relaxed))
    }
}

impl<C> ErrorType for SerialLine<C> {
    type Error = Infallible;
}

impl<C: TransferController> ReadReady for SerialLine<C> {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        if self.next.is_none() {
            self.next = self.receive();
        }
        Ok(self.next.is_some())
    }
}

impl<C: TransferController> Read for SerialLine<C> {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        while !bytes.is_empty() && !matches!(self.read_ready(), Ok(true)) {}
        let received = core::iter::from_fn(|| self.next.take().or_else(|| self.receive()));
        Ok(bytes.iter_mut().zip(received).map(|(byte, new)| *byte = new).count())
    }
}

impl<C: TransferController> WriteReady for SerialLine<C> {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.to_send.ready())
    }
}

impl<C: TransferController> Write for SerialLine<C> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        while !bytes.is_empty() && !self.to_send.ready() {}
        let taken = bytes.iter().take_while(|byte| self.to_send.enqueue(**byte).is_ok()).count();
        // The interrupt begins to send, and goes on by itself.
        self.controller.pend();
        Ok(taken)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        while !self.to_send.is_empty() {}
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::boxed::Box;
    use std::cell::{Cell, RefCell};
    use std::rc::Rc;
    use std::vec::Vec;

    use super::*;

    /// A controller that moves bytes when it is told to.
    #[derive(Default)]
    struct Streams {
        is_broken: Cell<bool>,
        receiving: Cell<Option<&'static [AtomicU8]>>,
        place: Cell<usize>,
        sending: Cell<Option<(&'static [AtomicU8], u32)>>,
        is_sent: Cell<bool>,
        pended: Cell<u32>,
        in_receiver: Cell<Option<u8>>,
        sent: RefCell<Vec<u8>>,
    }

    impl Streams {
        fn arrive(&self, byte: u8) {
            match self.receiving.get() {
                Some(memory) => {
                    memory[self.place.get()].store(byte, Ordering::Relaxed);
                    self.place.set((self.place.get() + 1) % memory.len());
                }
                None => self.in_receiver.set(Some(byte)),
            }
        }

        fn finish_piece(&self) {
            if let Some((memory, bytes)) = self.sending.take() {
                self.sent.borrow_mut().extend(memory.iter().zip(0..bytes).map(|(byte, _)| byte.load(Ordering::Relaxed)));
                self.is_sent.set(true);
                self.pended.set(self.pended.get() + 1);
            }
        }
    }

    impl TransferController for Rc<Streams> {
        fn begin_to_receive(&self, memory: &'static [AtomicU8]) {
            self.place.set(0);
            self.place.set(0);
            self.receiving.set((!self.is_broken.get()).then_some(memory));
        }
        fn is_receiving(&self) -> bool {
            self.receiving.get().is_some()
        }
        fn remaining(&self) -> usize {
            RECEIVE_QUEUE - self.place.get()
        }
        fn begin_to_send(&self, memory: &'static [AtomicU8], bytes: u32) {
            self.sending.set((!self.is_broken.get()).then_some((memory, bytes)));
        }
        fn is_sending(&self) -> bool {
            self.sending.get().is_some()
        }
        fn is_sent(&self) -> bool {
            self.is_sent.get()
        }
        fn forget_sent(&self) {
            self.is_sent.set(false);
        }
        fn pend(&self) {
            self.pended.set(self.pended.get() + 1);
        }
        fn received_byte(&self) -> Option<u8> {
            self.in_receiver.take()
        }
        fn send_byte(&self, byte: u8) {
            self.sent.borrow_mut().push(byte);
        }
    }

    fn line() -> (Rc<Streams>, Port<Rc<Streams>>, SerialLine<Rc<Streams>>) {
        let streams = Rc::new(Streams::default());
        let (port, line) = start(Rc::clone(&streams), Box::leak(Box::default()), Box::leak(Box::new(TransmitQueue::new())));
        (streams, port, line)
    }

    /// Serves every interrupt there is; the controller finishes a piece between two.
    fn serve(streams: &Streams, port: &mut Port<Rc<Streams>>) {
        while streams.pended.take() > 0 {
            port.interrupt();
            streams.finish_piece();
        }
    }

    #[test]
    fn bytes_come_in_order_over_many_rounds() {
        let (streams, _port, mut line) = line();
        let (mut came, mut expected) = (Vec::<u8>::new(), Vec::new());
        for round in 0..50u8 {
            for byte in 0..100u8 {
                streams.arrive(byte ^ round);
                expected.push(byte ^ round);
            }
            let mut bytes = [0; 77];
            while line.read_ready() == Ok(true) {
                let count = line.read(&mut bytes).unwrap();
                came.extend(&bytes[..count]);
            }
        }
        assert_eq!(came, expected);
    }

    #[test]
    fn all_that_is_written_is_sent_once_and_in_order_a_piece_after_the_other() {
        let (streams, mut port, mut line) = line();
        let text: Vec<u8> = (0..TRANSMIT_QUEUE - 1).map(|byte| byte.to_le_bytes()[0]).collect();
        assert_eq!(line.write(&text), Ok(text.len()));
        assert_eq!(line.write_ready(), Ok(false));
        port.interrupt();
        // A second interrupt while a piece is under way begins no other.
        port.interrupt();
        assert!(streams.is_sending() && streams.sent.borrow().is_empty());
        streams.finish_piece();
        assert_eq!(*streams.sent.borrow(), text[..PIECE]);
        serve(&streams, &mut port);
        assert_eq!(*streams.sent.borrow(), text);
        assert_eq!(line.write_ready(), Ok(true));
    }

    #[test]
    fn a_line_without_a_controller_still_carries_bytes() {
        let (streams, mut port, mut line) = line();
        streams.is_broken.set(true);
        streams.receiving.set(None);
        streams.arrive(7);
        assert_eq!((line.read_ready(), line.receive()), (Ok(true), None));
        assert_eq!(line.read(&mut [0]), Ok(1));
        assert_eq!(line.write(b"hello"), Ok(5));
        serve(&streams, &mut port);
        assert_eq!(*streams.sent.borrow(), b"hello");
        // It begins again as soon as it can, at the first byte.
        streams.is_broken.set(false);
        assert_eq!(line.read_ready(), Ok(false));
        streams.arrive(9);
        let mut byte = [0];
        assert_eq!((line.read(&mut byte), byte), (Ok(1), [9]));
    }
}
