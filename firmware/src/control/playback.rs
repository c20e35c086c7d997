//! Playback: an experiment's pressures, sent ahead in chunks, one point each playback period.
//!
//! Each point is held for its period, which is how the paper's excitations were recorded. The first point waits for the beginning of a
//! window of the decimation filter, so that with equal periods every window sees one point and the model's input is exact.

use core::num::NonZeroU16;

use model_export::link::fault::{Notice, NoticeSet};
use model_export::link::message::Refusal;

use super::law::{Accepted, ControlInputs, ControlLaw, ControlOutput, Demand, SetPoint};
use super::points::PointBuffer;

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
    points_bar: PointBuffer,
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
        self.points_bar.clear();
        (self.index, self.in_force_bar, self.ticks_left, self.begun) = (0, 0.0, 0, false);
    }

    /// The points that were sent ahead.
    pub fn points(&self) -> &PointBuffer {
        &self.points_bar
    }

    /// Index of the point in force, counted from one; zero before the first.
    pub fn index(&self) -> u32 {
        self.index
    }
}

impl ControlLaw for Playback {
    type State = PlaybackState;

    fn start(&self, state: &mut PlaybackState, inputs: &ControlInputs<'_>) {
        state.in_force_bar = inputs.output_bar;
        state.ticks_left = 0;
        state.begun = false;
    }

    fn accept(&self, state: &mut PlaybackState, set_point: &SetPoint) -> Result<Accepted, Refusal> {
        match set_point {
            SetPoint::Chunk(chunk) => {
                state.points_bar.take(chunk)?;
                Ok(Accepted::Buffered { next_index: state.points_bar.next_index(), free: state.points_bar.free() })
            }
            SetPoint::Value(..) => Err(Refusal::WrongQuantity),
        }
    }

    fn is_ready(&self, state: &PlaybackState) -> bool {
        !state.points_bar.is_empty()
    }

    fn step(&self, state: &mut PlaybackState, inputs: &ControlInputs<'_>) -> ControlOutput {
        state.begun |= inputs.window_begins;
        let mut finished = false;
        let mut notices = NoticeSet::EMPTY;
        if state.begun {
            if state.ticks_left == 0 {
                if let Some(point_bar) = state.points_bar.pop() {
                    state.in_force_bar = point_bar;
                    state.index = state.index.saturating_add(1);
                    state.ticks_left = self.period_ticks;
                } else {
                    finished = state.points_bar.has_end();
                    notices.insert_if(!finished, Notice::PlaybackStarved);
                }
            }
            state.ticks_left = state.ticks_left.saturating_sub(1);
        }
        ControlOutput { demand: Demand::Pressure(state.in_force_bar), set_point: state.in_force_bar, finished, notices }
    }
}
