//! What a control law is: what it sees, what it takes, what it asks for.

use model_export::link::fault::NoticeSet;
use model_export::link::message::{PlaybackChunk, Quantity, Refusal};

use super::compensator::Compensator;
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
