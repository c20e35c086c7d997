//! The board: the part and its core.

use std::num::NonZeroU64;

use rigless::machine::{Board, Target};
use rigless::mcu::Mcu;
use rigless::snapshot::Store;

use crate::line::FarEnd;
use crate::part::RigPart;

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
