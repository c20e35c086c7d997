//! What crosses the boundary of a tick: what the board knows, the model, commands and answers, inputs and outputs.

use core::num::NonZeroU16;

use model_export::link::fault::{Fault, FaultSet};
use model_export::link::message::{Reply, Telemetry};
use model_export::link::state::{ResetCause, State};
use model_export::link::trace::TraceRecord;

use super::config::Tick;
use crate::control::{Compensator, SetPoint};
use crate::drivers::RawSample;
use crate::number::MicroBar;
use crate::supervisor::Event;

/// What the board found when it started.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BootReport {
    /// Why it started.
    pub reset_cause: ResetCause,
    /// Faults found before the first tick: no HSE, damaged settings, a crash before the reset.
    pub faults: FaultSet,
}

/// Which way a model runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Direction {
    /// From pressure in bar to displacement in mm: a virtual sensor.
    #[default]
    Estimator,
    /// From displacement in mm to pressure in bar: a feed-forward.
    Inverse,
}

/// A model, one step each model period.
pub trait ModelStep {
    /// Displacement in mm for the filtered pressure of the last window in bar; for an inverse the other way round.
    fn step(&mut self, input: f32) -> f32;

    /// Forgets everything: the next step starts from its equilibrium.
    fn reset(&mut self);

    /// Whether there is one.
    fn is_present(&self) -> bool;

    /// Which way it runs.
    fn direction(&self) -> Direction {
        Direction::Estimator
    }

    /// The inverses of the actuator that came with it.
    fn compensator(&self) -> Option<&Compensator> {
        None
    }

    /// Whether its last input was outside of what it was trained on.
    fn is_outside_domain(&self) -> bool {
        false
    }

    /// What tells it from other models: the first bytes of its blob's content hash.
    fn identity(&self) -> [u8; 8] {
        [0; 8]
    }
}

/// For a rig without a model.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoModel;

impl ModelStep for NoModel {
    fn step(&mut self, _pressure_bar: f32) -> f32 {
        f32::NAN
    }

    fn reset(&mut self) {}

    fn is_present(&self) -> bool {
        false
    }
}

/// What the background wants from the tick.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    /// Token of the request that asked for it; `None` if nobody waits for an answer.
    pub token: Option<u32>,
    /// What to do.
    pub action: Action,
}

/// What a command does.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Move the state machine; events other than the host's are refused.
    Request(Event),
    /// A set-point for the control law.
    SetPoint(SetPoint),
    /// Forget the playback buffer.
    PlaybackClear,
    /// Put new settings into force; refused while energised. Empties the playback buffer, and the sensors must prove themselves again.
    Configure(Tick),
    /// What the self-test found, and the period of the model that may run from now on.
    SelfTestReport {
        /// Empty if all is well.
        faults: FaultSet,
        /// Ticks from one model step to the next; `None` without a model.
        model_period: Option<NonZeroU16>,
    },
    /// A fault that the background found.
    Raise(Fault),
    /// Tell the state.
    Status,
    /// Tell the fault record.
    FaultRecord,
    /// Tell what the controllers did.
    ControlReport,
    /// Tell what adaptation learned.
    AdaptationReport,
    /// Begin again and tell every tick from the next one on; refused unless idle and vented.
    TraceBegin,
    /// Tell no more ticks.
    TraceEnd,
}

/// Answer to a command that carried a token.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// The command's token.
    pub token: u32,
    /// What to tell the host.
    pub reply: Reply,
}

/// What goes into a tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TickInputs {
    /// The newest sample of both channels.
    pub sample: RawSample,
    /// Whether the emergency stop is pressed or its wire broken.
    pub emergency_stop: bool,
    /// Whether the last tick ran longer than its millisecond.
    pub overran: bool,
    /// Ticks that were lost since the last call.
    pub lost_ticks: u16,
    /// Counter that the background advances.
    pub background_beat: u32,
    /// Vent, whatever else is asked for. The board clears its flag when it copies it here.
    pub vent: bool,
    /// At most one command.
    pub command: Option<Command>,
    /// Telemetry samples dropped so far, for the next sample.
    pub telemetry_dropped: u32,
}

/// What comes out of a tick.
#[derive(Clone, Debug, PartialEq)]
pub struct TickOutputs {
    /// Whether to energise (close) the dump valve.
    pub energised: bool,
    /// Drive of the valve, share of full scale out of 65535.
    pub valve_share: u16,
    /// What that drive means.
    pub output: MicroBar,
    /// The pressure was seen to be gone, and nothing put it in doubt since: flash may be erased.
    pub vent_verified: bool,
    /// Whether to feed the watchdog.
    pub feed_watchdog: bool,
    /// The state after this tick.
    pub state: State,
    /// The background should run the self-test and report.
    pub self_test_wanted: bool,
    /// The fault record changed: keep a copy where a reset does not reach.
    pub record_changed: bool,
    /// Answer to this tick's command.
    pub answer: Option<Answer>,
    /// A sample for the host.
    pub telemetry: Option<Telemetry>,
    /// This tick for the host, while a trace runs. Where it does not fit, the trace ends: [`Rig::end_trace`](super::state::Rig::end_trace).
    pub trace: Option<TraceRecord>,
}
