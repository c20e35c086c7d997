//! Everything of the rig that changes, at its start.

use core::num::NonZeroU16;

use model_export::link::fault::{Fault, FaultSet, NoticeSet};
use model_export::link::state::ResetCause;

use super::config::Tick;
use super::ports::{BootReport, Direction};
use crate::adaptation::{AdaptationState, WindowWatch};
use crate::control::ControllerState;
use crate::decimate::{Decimator, DecimatorConfig, DecimatorState};
use crate::limiter::LimiterState;
use crate::plausibility::{ResidualState, SensorState};
use crate::supervisor::SupervisorState;

/// Decimation without a model: the paper's 50 Hz.
pub const DEFAULT_MODEL_PERIOD: NonZeroU16 = NonZeroU16::new(20).unwrap();

/// The channels of the decimation filter: command, measured pressure, displacement.
pub(super) const FILTERED: usize = 3;

/// Whether a trace runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Tracing {
    /// It does not.
    #[default]
    Off,
    /// It begins with the next tick.
    First,
    /// With the CRC-32 over the outputs so far.
    On(u32),
    /// It ends with this tick.
    Ending,
}

/// Everything mutable that a tick needs.
#[derive(Clone, Debug)]
pub struct TickState {
    pub(super) time_ms: u64,
    pub(super) boot_faults: FaultSet,
    pub(super) laser: SensorState,
    pub(super) pressure: SensorState,
    pub(super) pressure_residual: ResidualState,
    pub(super) model_residual: ResidualState,
    pub(super) decimator: Decimator<FILTERED>,
    pub(super) decimator_state: DecimatorState<FILTERED>,
    pub(super) has_model: bool,
    pub(super) filtered: [Option<f32>; FILTERED],
    pub(super) estimate_mm: Option<f32>,
    pub(super) inverse_bar: Option<f32>,
    pub(super) has_compensator: bool,
    pub(super) direction: Direction,
    pub(super) controller: ControllerState,
    pub(super) adaptation: AdaptationState,
    pub(super) window_watch: WindowWatch,
    /// The model that adaptation belongs to.
    pub(super) model_identity: [u8; 8],
    pub(super) supervisor: SupervisorState,
    pub(super) limiter: LimiterState,
    pub(super) limited: bool,
    pub(super) set_point: f32,
    pub(super) notices: NoticeSet,
    pub(super) host_age_ticks: u16,
    pub(super) late_in_a_row: u16,
    pub(super) late_ticks: u32,
    pub(super) background_beat: u32,
    pub(super) background_age_ticks: u16,
    pub(super) telemetry_sequence: u32,
    pub(super) telemetry_countdown: u16,
    pub(super) reset_cause: ResetCause,
    pub(super) tracing: Tracing,
}

impl TickState {
    #[inline(always)]
    fn new(tick: &Tick, boot: BootReport) -> Self {
        let mut boot_faults = boot.faults;
        boot_faults.insert_if(boot.reset_cause == ResetCause::Watchdog, Fault::WatchdogReset);
        boot_faults.insert_if(boot.reset_cause == ResetCause::BrownOut, Fault::BrownOut);
        Self {
            time_ms: 0,
            boot_faults,
            laser: SensorState::default(),
            pressure: SensorState::default(),
            pressure_residual: ResidualState::default(),
            model_residual: ResidualState::default(),
            decimator: DecimatorConfig { factor: DEFAULT_MODEL_PERIOD }.build(),
            decimator_state: DecimatorState::default(),
            has_model: false,
            filtered: [None; FILTERED],
            estimate_mm: None,
            inverse_bar: None,
            has_compensator: false,
            direction: Direction::Estimator,
            controller: ControllerState::default(),
            adaptation: AdaptationState::default(),
            window_watch: WindowWatch::default(),
            model_identity: [0; 8],
            supervisor: SupervisorState::default(),
            limiter: LimiterState::default(),
            limited: false,
            set_point: 0.0,
            notices: NoticeSet::EMPTY,
            host_age_ticks: 0,
            late_in_a_row: 0,
            late_ticks: 0,
            background_beat: 0,
            background_age_ticks: 0,
            telemetry_sequence: 0,
            telemetry_countdown: tick.telemetry_period_ticks,
            reset_cause: boot.reset_cause,
            tracing: Tracing::Off,
        }
    }

    pub(super) fn is_energised(&self) -> bool {
        self.supervisor.state().is_energised()
    }
}

/// The rig: what is built and what changes, together.
#[derive(Clone, Debug)]
pub struct Rig {
    pub(super) tick: Tick,
    pub(super) state: TickState,
}

impl Rig {
    /// A rig that has just started: vented, in [`State::Boot`](model_export::link::state::State::Boot).
    #[inline(always)]
    pub fn new(tick: Tick, boot: BootReport) -> Self {
        let state = TickState::new(&tick, boot);
        Self { tick, state }
    }

    /// What is built.
    pub fn built(&self) -> &Tick {
        &self.tick
    }

    /// The state machine, the fault record and the vent watch.
    pub fn supervisor(&self) -> &SupervisorState {
        &self.state.supervisor
    }
}
