//! The reference: where the tip shall be, now and a little later.
//!
//! Terms. Points of an experiment lie one playback period apart and are joined by straight lines. The **look-ahead** is how far into the
//! points a law may see; it needs points that were sent that much ahead. A **live** set-point has no future: it is taken to stay.

use core::num::NonZeroU16;

use model_export::link::message::{Quantity, Refusal};

use super::law::{Accepted, SetPoint};
use super::points::PointBuffer;

/// The time base of a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    period_ticks: u16,
    reciprocal: f32,
}

/// Points and the place in them.
#[derive(Clone, Debug, Default)]
pub struct ReferenceState {
    points_mm: PointBuffer,
    index: u32,
    tick: u16,
    begun: bool,
    live_mm: Option<f32>,
}

/// What a tick of the reference gives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// The last point was passed.
    pub finished: bool,
    /// The points ran out before the end.
    pub starved: bool,
}

impl Reference {
    /// A reference with one point each period.
    pub fn new(period_ms: NonZeroU16) -> Self {
        Self { period_ticks: period_ms.get(), reciprocal: 1.0 / f32::from(period_ms.get()) }
    }

    /// Takes a set-point in mm.
    ///
    /// # Errors
    /// The refusal to send to the host.
    pub fn accept(&self, state: &mut ReferenceState, set_point: &SetPoint) -> Result<Accepted, Refusal> {
        match set_point {
            SetPoint::Chunk(chunk) => {
                state.points_mm.take(chunk)?;
                Ok(Accepted::Buffered { next_index: state.points_mm.next_index(), free: state.points_mm.free() })
            }
            SetPoint::Value(Quantity::Displacement, value) if value.is_finite() => {
                state.clear();
                state.live_mm = Some(*value);
                Ok(Accepted::InForce)
            }
            SetPoint::Value(Quantity::Displacement, _) => Err(Refusal::NotFinite),
            SetPoint::Value(..) => Err(Refusal::WrongQuantity),
        }
    }

    /// Goes on by a tick; the first point waits for the beginning of a window, so that windows and points stay in step.
    pub fn step(&self, state: &mut ReferenceState, window_begins: bool) -> Progress {
        let mut progress = Progress::default();
        if state.live_mm.is_some() {
            return progress;
        }
        if !state.begun {
            state.begun = window_begins;
            state.index = u32::from(state.begun);
            return progress;
        }
        state.tick = state.tick.saturating_add(1);
        if state.tick >= self.period_ticks {
            if state.points_mm.len() > 1 {
                let _ = state.points_mm.pop();
                state.index = state.index.saturating_add(1);
                state.tick = 0;
            } else {
                state.tick = self.period_ticks;
                progress.finished = state.points_mm.has_end();
                progress.starved = !progress.finished;
            }
        }
        progress
    }

    /// The reference so many ticks from now, mm; `None` before anything was sent.
    pub fn ahead(&self, state: &ReferenceState, ticks: u16) -> Option<f32> {
        if state.live_mm.is_some() {
            return state.live_mm;
        }
        let place = state.tick.saturating_add(ticks);
        let index = place.checked_div(self.period_ticks)?;
        let rest = place.checked_rem(self.period_ticks)?;
        let before = state.points_mm.at(usize::from(index))?;
        let after = state.points_mm.at(usize::from(index).saturating_add(1))?;
        Some(before + (after - before) * (f32::from(rest) * self.reciprocal))
    }
}

impl ReferenceState {
    /// Forgets everything.
    pub fn clear(&mut self) {
        self.points_mm.clear();
        (self.index, self.tick, self.begun, self.live_mm) = (0, 0, false, None);
    }

    /// The experiment begins with the next window; a live set-point from before may be hours old.
    pub fn start(&mut self) {
        self.begun = false;
        self.tick = 0;
        self.live_mm = None;
    }

    /// Whether there is a point to begin with.
    pub fn is_empty(&self) -> bool {
        self.points_mm.is_empty()
    }

    /// The points that were sent ahead.
    pub fn points(&self) -> &PointBuffer {
        &self.points_mm
    }

    /// Index of the point in force, counted from one; zero before the first.
    pub fn index(&self) -> u32 {
        self.index
    }
}
