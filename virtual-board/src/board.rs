//! The board: the part, its core, and a line to the host.

use std::collections::VecDeque;
use std::num::{NonZeroU32, NonZeroU64};
use std::sync::{Arc, Mutex, PoisonError};

use rigless::chip::Timeline;
use rigless::chip::uart::Peer;
use rigless::cpu::armv7m;
use rigless::machine::{Board, Target};
use rigless::mcu::{Mcu, Operate};
use rigless::snapshot::Store;
use rigless::soc::Error;
use rigless::time::VirtualNanos;

use crate::chip::part::{Pins, Stm32f405};
use crate::core;

/// Bytes on their way, in both directions.
#[derive(Debug, Default)]
pub struct Wire {
    /// To the part.
    pub to_part: VecDeque<u8>,
    /// From it.
    pub from_part: Vec<u8>,
}

/// The far end of USART1.
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
pub struct RigBoard {
    /// The part.
    pub part: Stm32f405,
    core_hz: NonZeroU64,
}

impl RigBoard {
    /// The board with what is on the pins, and the rate of the core's own timer; the line's far end beside it.
    ///
    /// # Errors
    /// When the part's description contradicts itself.
    pub fn new(pins: Pins, core_hz: NonZeroU64) -> Result<(Self, FarEnd), Error> {
        let mut part = Stm32f405::new(pins)?;
        let far_end = FarEnd::default();
        part.line.attach(far_end.clone());
        Ok((Self { part, core_hz }, far_end))
    }
}

impl Store for RigBoard {}

impl Board for RigBoard {
    fn name(&self) -> &'static str {
        "stm32f405-rig"
    }

    fn target_names(&self) -> Vec<&'static str> {
        vec!["stm32f405"]
    }

    fn mcu(&mut self, target: usize) -> Option<&mut dyn Mcu> {
        (target == 0).then_some(&mut self.part as &mut dyn Mcu)
    }

    fn targets(&mut self) -> Vec<Target<'_>> {
        let lines = NonZeroU32::new(u32::from(Operate::cpu(&self.part).interrupt_lines)).unwrap_or(NonZeroU32::MIN);
        let spec = core::spec(self.core_hz, lines, &armv7m::windows(self.part.bus()));
        vec![Target::new("stm32f405", &mut self.part, spec)]
    }
}
