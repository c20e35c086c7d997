//! The line to the simulated hardware: the semihosting console, which QEMU connects to a socket.
//!
//! A frame each way a tick costs two calls there; on a serial port it would cost the emulator a round of its main loop for every byte.

use cortex_m_semihosting::nr::open::{R_BINARY, W_TRUNC_BINARY};
use cortex_m_semihosting::{debug, syscall};
use firmware::device::exchange::{FRAME_BYTES, Frame};

const CONSOLE: &[u8] = b":tt\0";

/// The line.
pub struct Hardware {
    input: usize,
    output: usize,
}

impl Hardware {
    /// Opens the console.
    pub fn open() -> Self {
        // SAFETY: a name with its length, as the operation wants it.
        let open = |mode: usize| unsafe { syscall!(OPEN, CONSOLE.as_ptr(), mode, CONSOLE.len() - 1) };
        Self { input: open(R_BINARY), output: open(W_TRUNC_BINARY) }
    }

    /// Waits for a frame. A console that has ended has nobody left behind it: the emulator ends, too, and is no orphan.
    pub fn read(&mut self) -> Frame {
        let mut frame = [0u8; FRAME_BYTES];
        let mut missing = FRAME_BYTES;
        while missing > 0 {
            let rest = &mut frame[FRAME_BYTES - missing..];
            // SAFETY: an open handle and a buffer with its length; gives the number of bytes that are still missing.
            let left = unsafe { syscall!(READ, self.input, rest.as_mut_ptr(), rest.len()) };
            if left >= missing {
                debug::exit(debug::EXIT_FAILURE);
            }
            missing = left;
        }
        frame
    }

    /// Sends a frame.
    pub fn write(&mut self, frame: &Frame) {
        // SAFETY: an open handle and a buffer with its length.
        let missing = unsafe { syscall!(WRITE, self.output, frame.as_ptr(), frame.len()) };
        if missing != 0 {
            panic!("the console takes no frame");
        }
    }
}
