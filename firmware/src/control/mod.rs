//! Control laws: what pressure to ask for, given set-points and measurements.
//!
//! A control law knows no clock, no HAL and no limits: the limiter behind it does not trust it, and the supervisor decides whether it runs at
//! all. Every law implements [`ControlLaw`]; [`Controller`] is the one in use, chosen by the settings. To add a law: implement the
//! trait in its own file, add a variant here and a number to the setting `control.law`.

mod actuator;
mod compensator;
mod observer;
mod pid;
mod playback;
mod points;
mod reference;
mod set_point;
mod tracking;

#[cfg(test)]
mod tests;

pub use actuator::{Actuator, ActuatorState, TICK_S};
pub use compensator::{CATCH_UP_S, Compensator, CompensatorState};
pub use observer::{Blend, ObserverConfig, ObserverState};
pub use pid::{Pid, PidConfig, PidState};
pub use playback::{Playback, PlaybackConfig, PlaybackState};
pub use points::{PLAYBACK_CAPACITY, PointBuffer};
pub use reference::{Progress, Reference, ReferenceState};
pub use set_point::{PressureSetPoint, PressureSetPointState};
pub use tracking::{FeedForward, FeedbackSensor, OutsideDomain, Tracking, TrackingConfig, TrackingState};

use model_export::link::fault::NoticeSet;
use model_export::link::message::{PlaybackChunk, Quantity, Refusal};

use crate::adaptation::Correction;

/// What a control law sees at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControlInputs<'a> {
    /// The output in force, after the limiter, bar.
    pub output_bar: f32,
    /// Whether the limiter changed the last demand: integrators must not wind up.
    pub limited: bool,
    /// Measured pressure of this tick, bar; `None` while not plausible.
    pub pressure_bar: Option<f32>,
    /// Measured displacement of this tick, mm; `None` while not plausible.
    pub displacement_mm: Option<f32>,
    /// The model's latest estimate, mm, as the model gives it.
    pub estimate_mm: Option<f32>,
    /// What adaptation makes of an estimate; absent while it is switched off.
    pub correction: Option<Correction>,
    /// Whether a window of the decimation filter begins with this tick; a law at the model's rate acts on these.
    pub window_begins: bool,
    /// Length of a window, s.
    pub window_s: f32,
    /// Mean displacement of the window that ended last, mm; `None` while not plausible.
    pub window_displacement_mm: Option<f32>,
    /// The pressure that a learned inverse asks for, bar.
    pub inverse_bar: Option<f32>,
    /// Whether the model sees what it was not trained on.
    pub outside_domain: bool,
    /// The inverses of the actuator that came with the model.
    pub compensator: Option<&'a Compensator>,
}

/// What a control law asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Demand {
    /// This pressure, bar; renews the output's time-to-live.
    Pressure(f32),
    /// Nothing new; the last demand ages.
    Hold,
}

/// What a control law gives at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlOutput {
    /// What it asks for.
    pub demand: Demand,
    /// The set-point in force, in the law's quantity, for the record.
    pub set_point: f32,
    /// The experiment is over: the device goes back to armed.
    pub finished: bool,
    /// What is degraded.
    pub notices: NoticeSet,
}

/// A set-point as it comes from the host.
#[derive(Clone, Debug, PartialEq)]
pub enum SetPoint {
    /// One value.
    Value(Quantity, f32),
    /// A piece of an experiment.
    Chunk(PlaybackChunk),
}

/// How a set-point was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Accepted {
    /// In force.
    InForce,
    /// In the buffer.
    Buffered {
        /// Index the next chunk must begin with.
        next_index: u32,
        /// Points there is room for.
        free: u16,
    },
}

/// A control law.
pub trait ControlLaw {
    /// Its memory.
    type State;

    /// Prepares for running from the present output without a bump.
    fn start(&self, state: &mut Self::State, inputs: &ControlInputs<'_>);

    /// Takes a set-point.
    ///
    /// # Errors
    /// The refusal to send to the host; the law goes on as before.
    fn accept(&self, state: &mut Self::State, set_point: &SetPoint) -> Result<Accepted, Refusal>;

    /// Whether the law cannot do without a model; arming is refused without one then.
    fn needs_model(&self) -> bool {
        false
    }

    /// Whether there is something to start with.
    fn is_ready(&self, state: &Self::State) -> bool;

    /// The demand for this tick.
    ///
    /// # Deadline
    /// Called every 1 ms tick while running.
    fn step(&self, state: &mut Self::State, inputs: &ControlInputs<'_>) -> ControlOutput;
}

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
