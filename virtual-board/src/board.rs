//! The board: the part, its core, and a line to the host.

use std::collections::VecDeque;
use std::num::NonZeroU64;
use std::sync::{Arc, Mutex, PoisonError};

use rigless::chip::Timeline;
use rigless::chip::uart::Peer;
use rigless::machine::{Board, Target};
use rigless::mcu::Mcu;
use rigless::snapshot::Store;
use rigless::time::VirtualNanos;

use crate::part::RigPart;

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

/// The part on its board.
#[derive(Debug)]
pub struct RigBoard<P> {
    /// The part.
    pub part: P,
    core_hz: NonZeroU64,
}

impl<P: RigPart> RigBoard<P> {
    /// The board, and the rate of the core's own timer; the line's far end beside it.
    pub fn new(mut part: P, core_hz: Option<NonZeroU64>) -> (Self, FarEnd) {
        let far_end = FarEnd::default();
        part.attach(far_end.clone());
        (Self { part, core_hz: core_hz.unwrap_or(P::CORE_HZ) }, far_end)
    }
}

impl<P> Store for RigBoard<P> {}

impl<P: RigPart> Board for RigBoard<P> {
    fn name(&self) -> &'static str {
        self.part.board()
    }

    fn target_names(&self) -> Vec<&'static str> {
        vec![P::NAME]
    }

    fn mcu(&mut self, target: usize) -> Option<&mut dyn Mcu> {
        (target == 0).then_some(&mut self.part as &mut dyn Mcu)
    }

    fn targets(&mut self) -> Vec<Target<'_>> {
        let spec = self.part.core(self.core_hz);
        vec![Target::new(P::NAME, &mut self.part, spec)]
    }
}
