//! Playback: an experiment's pressures, sent ahead in chunks, one point each playback period.
//!
//! Each point is held for its period, which is how the paper's excitations were recorded. The first point waits for the beginning of a
//! window of the decimation filter, so that with equal periods every window sees one point and the model's input is exact.
//!
//! Chunks carry the index of their first point. A chunk that was already taken is confirmed again and changes nothing, so a host that
//! missed a reply may repeat itself; a gap is refused with the index to go on from. A chunk without points is a host saying that it still
//! stands behind the experiment; after the last point was sent it keeps the host-loss timeout fed.

use core::num::NonZeroU16;

use heapless::Deque;
use model_export::link::fault::{Notice, NoticeSet};
use model_export::link::message::{PlaybackChunk, Refusal};

use super::{Accepted, ControlInputs, ControlLaw, ControlOutput, Demand, SetPoint};

/// Points the buffer holds: five seconds at the paper's 50 Hz.
pub const PLAYBACK_CAPACITY: usize = 256;

/// How fast to play back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlaybackConfig {
    /// Ticks of 1 ms from one point to the next.
    pub period_ms: NonZeroU16,
}

/// Playback, ready to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Playback {
    period_ticks: u16,
}

/// The buffer and the point in force.
#[derive(Clone, Debug, Default)]
pub struct PlaybackState {
    points_bar: Deque<f32, PLAYBACK_CAPACITY>,
    next_index: u32,
    has_end: bool,
    index: u32,
    in_force_bar: f32,
    ticks_left: u16,
    begun: bool,
}

impl PlaybackConfig {
    /// Builds the playback.
    pub fn build(&self) -> Playback {
        Playback { period_ticks: self.period_ms.get() }
    }
}

impl PlaybackState {
    /// Forgets buffer and index.
    pub fn clear(&mut self) {
        // In place: a fresh buffer would be built on the stack of the tick first.
        let Self { points_bar, next_index, has_end, index, in_force_bar, ticks_left, begun } = self;
        points_bar.clear();
        (*next_index, *has_end, *index) = (0, false, 0);
        (*in_force_bar, *ticks_left, *begun) = (0.0, 0, false);
    }

    /// Index the next chunk must begin with.
    pub fn next_index(&self) -> u32 {
        self.next_index
    }

    /// Points there is room for.
    pub fn free(&self) -> u16 {
        u16::try_from(PLAYBACK_CAPACITY.saturating_sub(self.points_bar.len())).unwrap_or(0)
    }

    /// Index of the point in force, counted from one; zero before the first.
    pub fn index(&self) -> u32 {
        self.index
    }

    fn take(&mut self, chunk: &PlaybackChunk) -> Result<(), Refusal> {
        if chunk.values_bar.iter().any(|value| !value.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        let length = u32::try_from(chunk.values_bar.len()).unwrap_or(u32::MAX);
        let end = chunk.first_index.checked_add(length).ok_or(Refusal::PlaybackIndex(self.next_index))?;
        if length > 0 && end <= self.next_index {
            return Ok(());
        }
        if chunk.first_index != self.next_index || (self.has_end && length > 0) {
            return Err(Refusal::PlaybackIndex(self.next_index));
        }
        if length > u32::from(self.free()) {
            return Err(Refusal::PlaybackFull(self.free()));
        }
        for value in &chunk.values_bar {
            // The room was checked above.
            let _ = self.points_bar.push_back(*value);
        }
        self.next_index = end;
        self.has_end |= chunk.last;
        Ok(())
    }
}

impl ControlLaw for Playback {
    type State = PlaybackState;

    fn start(&self, state: &mut PlaybackState, inputs: &ControlInputs) {
        state.in_force_bar = inputs.output_bar;
        state.ticks_left = 0;
        state.begun = false;
    }

    fn accept(&self, state: &mut PlaybackState, set_point: &SetPoint) -> Result<Accepted, Refusal> {
        match set_point {
            SetPoint::Chunk(chunk) => {
                state.take(chunk)?;
                Ok(Accepted::Buffered { next_index: state.next_index, free: state.free() })
            }
            SetPoint::Value(..) => Err(Refusal::WrongQuantity),
        }
    }

    fn is_ready(&self, state: &PlaybackState) -> bool {
        !state.points_bar.is_empty()
    }

    fn step(&self, state: &mut PlaybackState, inputs: &ControlInputs) -> ControlOutput {
        state.begun |= inputs.window_begins;
        let mut finished = false;
        let mut notices = NoticeSet::EMPTY;
        if state.begun {
            if state.ticks_left == 0 {
                if let Some(point_bar) = state.points_bar.pop_front() {
                    state.in_force_bar = point_bar;
                    state.index = state.index.saturating_add(1);
                    state.ticks_left = self.period_ticks;
                } else {
                    finished = state.has_end;
                    notices.insert_if(!finished, Notice::PlaybackStarved);
                }
            }
            state.ticks_left = state.ticks_left.saturating_sub(1);
        }
        ControlOutput { demand: Demand::Pressure(state.in_force_bar), set_point: state.in_force_bar, finished, notices }
    }
}
