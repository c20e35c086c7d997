//! The line to the host: bytes on their way.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use rigless::chip::Timeline;
use rigless::chip::uart::Peer;
use rigless::snapshot::Store;
use rigless::time::VirtualNanos;

/// Bytes on their way, in both directions.
#[derive(Debug, Default)]
pub struct Wire {
    /// To the part.
    pub to_part: VecDeque<u8>,
    /// From it.
    pub from_part: Vec<u8>,
}

/// The far end of the line.
#[derive(Debug, Clone, Default)]
pub struct FarEnd(Arc<Mutex<Wire>>);

impl FarEnd {
    /// The bytes on their way.
    pub fn with<T>(&self, act: impl FnOnce(&mut Wire) -> T) -> T {
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Store for FarEnd {}

impl Peer for FarEnd {
    fn receive(&mut self, word: u16, _context: &mut Timeline<'_, '_>) {
        let [byte, _] = word.to_le_bytes();
        self.with(|wire| wire.from_part.push(byte));
    }

    fn transmit(&mut self, _now: VirtualNanos) -> Option<u16> {
        self.with(|wire| wire.to_part.pop_front()).map(u16::from)
    }
}
