//! The control law in use, and the memories of all of them.

use model_export::link::message::Refusal;

use super::law::{Accepted, ControlInputs, ControlLaw, ControlOutput, SetPoint};
use super::playback::{Playback, PlaybackState};
use super::points::PointBuffer;
use super::set_point::{PressureSetPoint, PressureSetPointState};
use super::tracking::{Tracking, TrackingState};

/// The control law in use.
#[derive(Clone, Debug, PartialEq)]
pub enum Controller {
    /// Pressures from a buffer, one each playback period.
    Playback(Playback),
    /// The latest pressure set-point.
    PressureSetPoint(PressureSetPoint),
    /// Displacements, by feed-forward and feedback.
    Tracking(Tracking),
}

/// Memories of all control laws, so that one can be exchanged for another in place.
#[derive(Clone, Debug, Default)]
pub struct ControllerState {
    /// Of [`Playback`].
    pub playback: PlaybackState,
    /// Of [`PressureSetPoint`].
    pub set_point: PressureSetPointState,
    /// Of [`Tracking`].
    pub tracking: TrackingState,
}

impl Controller {
    /// The points that were sent ahead to the law in use.
    pub fn points<'a>(&self, state: &'a ControllerState) -> &'a PointBuffer {
        match self {
            Self::Tracking(_) => state.tracking.reference().points(),
            _ => state.playback.points(),
        }
    }

    /// The estimate that a law which tracks listens to, mm.
    pub fn estimate_mm(&self, state: &ControllerState) -> Option<f32> {
        match self {
            Self::Tracking(_) => state.tracking.estimate_mm(),
            _ => None,
        }
    }

    /// The same before adaptation, mm.
    pub fn raw_estimate_mm(&self, state: &ControllerState) -> Option<f32> {
        match self {
            Self::Tracking(_) => state.tracking.raw_estimate_mm(),
            _ => None,
        }
    }

    /// Index of the point in force, counted from one; zero before the first.
    pub fn point_index(&self, state: &ControllerState) -> u32 {
        match self {
            Self::Tracking(_) => state.tracking.reference().index(),
            _ => state.playback.index(),
        }
    }
}

impl ControllerState {
    /// Forgets the points that were sent ahead.
    pub fn clear_points(&mut self) {
        self.playback.clear();
        self.tracking.clear_reference();
    }

    /// Forgets everything, in place.
    pub fn clear(&mut self) {
        let Self { playback, set_point, tracking } = self;
        playback.clear();
        tracking.clear();
        *set_point = PressureSetPointState::default();
    }
}

impl ControlLaw for Controller {
    type State = ControllerState;

    fn start(&self, state: &mut ControllerState, inputs: &ControlInputs<'_>) {
        match self {
            Self::Playback(law) => law.start(&mut state.playback, inputs),
            Self::PressureSetPoint(law) => law.start(&mut state.set_point, inputs),
            Self::Tracking(law) => law.start(&mut state.tracking, inputs),
        }
    }

    fn accept(&self, state: &mut ControllerState, set_point: &SetPoint) -> Result<Accepted, Refusal> {
        match self {
            Self::Playback(law) => law.accept(&mut state.playback, set_point),
            Self::PressureSetPoint(law) => law.accept(&mut state.set_point, set_point),
            Self::Tracking(law) => law.accept(&mut state.tracking, set_point),
        }
    }

    fn needs_model(&self) -> bool {
        match self {
            Self::Playback(law) => law.needs_model(),
            Self::PressureSetPoint(law) => law.needs_model(),
            Self::Tracking(law) => law.needs_model(),
        }
    }

    fn is_ready(&self, state: &ControllerState) -> bool {
        match self {
            Self::Playback(law) => law.is_ready(&state.playback),
            Self::PressureSetPoint(law) => law.is_ready(&state.set_point),
            Self::Tracking(law) => law.is_ready(&state.tracking),
        }
    }

    fn step(&self, state: &mut ControllerState, inputs: &ControlInputs<'_>) -> ControlOutput {
        match self {
            Self::Playback(law) => law.step(&mut state.playback, inputs),
            Self::PressureSetPoint(law) => law.step(&mut state.set_point, inputs),
            Self::Tracking(law) => law.step(&mut state.tracking, inputs),
        }
    }
}
