//! Control laws: what pressure to ask for, given set-points and measurements.
//!
//! A control law knows no clock, no HAL and no limits: the limiter behind it does not trust it, and the supervisor decides whether it runs at
//! all. Every law implements [`ControlLaw`]; [`Controller`] is the one in use, chosen by the settings. To add a law: implement the
//! trait in its own file, add a variant here and a number to the setting `control.law`.

mod playback;
mod set_point;

pub use playback::{PLAYBACK_CAPACITY, Playback, PlaybackConfig, PlaybackState};
pub use set_point::{PressureSetPoint, PressureSetPointState};

use model_export::link::fault::NoticeSet;
use model_export::link::message::{PlaybackChunk, Quantity, Refusal};

/// What a control law sees at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControlInputs {
    /// The output in force, after the limiter, bar.
    pub output_bar: f32,
    /// Whether the limiter changed the last demand: integrators must not wind up.
    pub limited: bool,
    /// Measured pressure of this tick, bar; `None` while not plausible.
    pub pressure_bar: Option<f32>,
    /// Measured displacement of this tick, mm; `None` while not plausible.
    pub displacement_mm: Option<f32>,
    /// The model's latest estimate, mm.
    pub estimate_mm: Option<f32>,
    /// Whether a window of the decimation filter begins with this tick; a law at the model's rate acts on these.
    pub window_begins: bool,
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
    fn start(&self, state: &mut Self::State, inputs: &ControlInputs);

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
    fn step(&self, state: &mut Self::State, inputs: &ControlInputs) -> ControlOutput;
}

/// The control law in use.
#[derive(Clone, Debug, PartialEq)]
pub enum Controller {
    /// Pressures from a buffer, one each playback period.
    Playback(Playback),
    /// The latest pressure set-point.
    PressureSetPoint(PressureSetPoint),
}

/// Memories of all control laws, so that one can be exchanged for another in place.
#[derive(Clone, Debug, Default)]
pub struct ControllerState {
    /// Of [`Playback`].
    pub playback: PlaybackState,
    /// Of [`PressureSetPoint`].
    pub set_point: PressureSetPointState,
}

impl ControllerState {
    /// Forgets everything, in place.
    pub fn clear(&mut self) {
        let Self { playback, set_point } = self;
        playback.clear();
        *set_point = PressureSetPointState::default();
    }
}

impl ControlLaw for Controller {
    type State = ControllerState;

    fn start(&self, state: &mut ControllerState, inputs: &ControlInputs) {
        match self {
            Self::Playback(law) => law.start(&mut state.playback, inputs),
            Self::PressureSetPoint(law) => law.start(&mut state.set_point, inputs),
        }
    }

    fn accept(&self, state: &mut ControllerState, set_point: &SetPoint) -> Result<Accepted, Refusal> {
        match self {
            Self::Playback(law) => law.accept(&mut state.playback, set_point),
            Self::PressureSetPoint(law) => law.accept(&mut state.set_point, set_point),
        }
    }

    fn needs_model(&self) -> bool {
        match self {
            Self::Playback(law) => law.needs_model(),
            Self::PressureSetPoint(law) => law.needs_model(),
        }
    }

    fn is_ready(&self, state: &ControllerState) -> bool {
        match self {
            Self::Playback(law) => law.is_ready(&state.playback),
            Self::PressureSetPoint(law) => law.is_ready(&state.set_point),
        }
    }

    fn step(&self, state: &mut ControllerState, inputs: &ControlInputs) -> ControlOutput {
        match self {
            Self::Playback(law) => law.step(&mut state.playback, inputs),
            Self::PressureSetPoint(law) => law.step(&mut state.set_point, inputs),
        }
    }
}
