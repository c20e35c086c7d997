//! The tick: everything the rig does in one millisecond, as one function without hardware.
//!
//! ```text
//! command ─► host and self-test requests
//! codes ─► calibration ─► plausibility ─► decimation ─► model ─► control law ─► supervisor ─► LIMITER ─► valve, dump valve
//!                              └─ faults ─────────────────────────────────────────┘             telemetry
//! ```
//!
//! Between model and control law stands [`crate::adaptation`], while it is switched on. The comparison of laser and model
//! ([`Fault::ModelMismatch`]) sees the model's own estimate, so that adaptation hides nothing from it.
//!
//! # How a board drives it
//!
//! Once, at the start: build a [`Rig`] with [`Rig::new`] from the settings, the board's [`RigFacts`] and a [`BootReport`]. Keep the dump
//! valve released until the first tick says otherwise.
//!
//! Every millisecond, in the interrupt of the end of the ADC's conversion:
//!
//! 1. fill [`TickInputs`]: the two codes, the emergency stop, ticks lost since the last call, the background's beat counter, the flag that
//!    wants a vent, and at most one [`Command`] from the queue that the link fills (queue places: at least as many for answers as for
//!    commands, since every command with a token gets exactly one answer and none may be dropped);
//! 2. call [`Rig::tick`] with the model (or [`NoModel`]);
//! 3. apply [`TickOutputs`] in this order: dump valve, valve drive, then feed the watchdog if told so; push the answer and the telemetry
//!    sample into their queues without waiting (a full telemetry queue drops the sample; count it and hand the count to the link). A trace
//!    record goes before the answer, and where it does not fit the trace ends ([`Rig::end_trace`]).
//!
//! The background (link, storage, self-test) never touches the rig; it sends commands. When [`TickOutputs::self_test_wanted`] is set it runs
//! the self-test once and sends [`Action::SelfTestReport`]. It must advance the beat counter at least every
//! [`BACKGROUND_TICKS_ENERGISED`] ms while energised. When the fault record changed, copy it to the RAM that survives a reset (`retain`).
//!
//! The watchdog's period must stay below 50 ms while [`TickOutputs::energised`]; while vented it may be longer than a flash erase.

mod config;
mod ports;
mod reports;
mod trace;

use core::num::NonZeroU16;

use model_export::link::adaptation::{AdaptationReport, Adapting};
use model_export::link::fault::{Blocker, BlockerSet, Fault, FaultSet, Notice, NoticeSet};
use model_export::link::message::{Refusal, Reply};
use model_export::link::state::{ResetCause, State};

use crate::adaptation::certificate::WINDOW_MS;
use crate::adaptation::{AdaptationState, TickFacts, WindowWatch};
use crate::control::{Accepted, Compensator, ControlInputs, ControlLaw, Controller, ControllerState, Demand};
use crate::decimate::{Decimator, DecimatorConfig, DecimatorState};
use crate::limiter::LimiterState;
use crate::number::MicroBar;
use crate::plausibility::{FollowerState, Rejection, SensorState, Verdict};
use crate::supervisor::{Decision, Event, Observation, SupervisorState, Vent};

pub use crate::time::{TICKS_IN_A_SECOND, TICKS_PER_S};
pub use config::{Inconsistent, Tick, TickConfig};
pub use ports::{Action, Answer, BootReport, Command, Direction, ModelStep, NoModel, RigFacts, TickInputs, TickOutputs, ValveOutput};
pub use reports::Insight;
pub use trace::Origin;
use trace::{Taken, Tracing};

/// The background must show life this often while energised.
pub const BACKGROUND_TICKS_ENERGISED: u16 = 40;
/// And this often while vented, where a flash erase may take its time.
pub const BACKGROUND_TICKS_VENTED: u16 = 4000;
/// Ticks lost at once that are a fault however few in a row are tolerated.
pub const LOST_AT_ONCE: u16 = 20;
/// Decimation without a model: the paper's 50 Hz.
pub const DEFAULT_MODEL_PERIOD: NonZeroU16 = NonZeroU16::new(20).unwrap();

/// The channels of the decimation filter: command, measured pressure, displacement.
const FILTERED: usize = 3;

/// Everything mutable that a tick needs.
#[derive(Clone, Debug)]
pub struct TickState {
    time_ms: u64,
    boot_faults: FaultSet,
    laser: SensorState,
    pressure: SensorState,
    pressure_follower: FollowerState,
    model_follower: FollowerState,
    decimator: Decimator<FILTERED>,
    decimator_state: DecimatorState<FILTERED>,
    has_model: bool,
    filtered: [Option<f32>; FILTERED],
    estimate_mm: Option<f32>,
    inverse_bar: Option<f32>,
    has_compensator: bool,
    direction: Direction,
    controller: ControllerState,
    adaptation: AdaptationState,
    window_watch: WindowWatch,
    /// The model that adaptation belongs to.
    model_identity: [u8; 8],
    supervisor: SupervisorState,
    limiter: LimiterState,
    limited: bool,
    set_point: f32,
    notices: NoticeSet,
    host_age_ticks: u16,
    late_in_a_row: u16,
    late_ticks: u32,
    background_beat: u32,
    background_age_ticks: u16,
    telemetry_sequence: u32,
    telemetry_countdown: u16,
    reset_cause: ResetCause,
    tracing: Tracing,
}

impl TickState {
    fn new(tick: &Tick, boot: BootReport) -> Self {
        let mut boot_faults = boot.faults;
        boot_faults.insert_if(boot.reset_cause == ResetCause::Watchdog, Fault::WatchdogReset);
        boot_faults.insert_if(boot.reset_cause == ResetCause::BrownOut, Fault::BrownOut);
        Self {
            time_ms: 0,
            boot_faults,
            laser: SensorState::default(),
            pressure: SensorState::default(),
            pressure_follower: FollowerState::default(),
            model_follower: FollowerState::default(),
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

    fn is_energised(&self) -> bool {
        self.supervisor.state().is_energised()
    }
}

/// The rig: what is built and what changes, together.
#[derive(Clone, Debug)]
pub struct Rig {
    tick: Tick,
    state: TickState,
}

/// What a command left to do in its tick.
#[derive(Default)]
struct Pending {
    token: Option<u32>,
    request: Option<Event>,
    reply: Option<Reply>,
    wants_status: bool,
    wants_record: bool,
    wants_trace: bool,
    faults: FaultSet,
}

impl Rig {
    /// A rig that has just started: vented, in [`State::Boot`].
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

    /// Everything the rig does in one millisecond.
    ///
    /// # Deadline
    /// 1 ms, of which the model's step takes most. No loop depends on data except over the features and units of the model.
    pub fn tick(&mut self, model: &mut impl ModelStep, inputs: TickInputs) -> TickOutputs {
        let taken = Taken::new(&self.state, &inputs, model);
        let TickInputs { sample, emergency_stop, overran, lost_ticks, background_beat, vent, command, telemetry_dropped } = inputs;
        let elapsed = lost_ticks.saturating_add(1);
        self.state.notices = NoticeSet::EMPTY;
        self.advance(elapsed, overran || lost_ticks > 0, background_beat);
        let mut pending = self.take_command(model, command);
        if vent {
            if pending.request.is_some() {
                pending.reply = Some(Reply::Refused(Refusal::Busy));
            }
            pending.request = Some(Event::Vent);
        }

        // Measurements. The output in force is the one the sample was taken under.
        let in_force = self.state.limiter.output();
        self.state.laser.miss(lost_ticks);
        self.state.pressure.miss(lost_ticks);
        let laser = self.tick.laser.step(&mut self.state.laser, sample.laser_code, in_force);
        let pressure = self.tick.pressure.step(&mut self.state.pressure, sample.pressure_code, in_force);
        self.state.notices.insert_if(matches!(laser, Verdict::Held(..)), Notice::LaserHeld);
        self.state.notices.insert_if(matches!(pressure, Verdict::Held(..)), Notice::PressureHeld);
        self.state.notices.insert_if(laser.value().is_none() && !self.tick.laser_required, Notice::LaserLost);

        let window_begins = self.state.decimator_state.is_between_windows();
        let model_faults = self.step_model(model, in_force, pressure.value(), laser.value());
        let mismatch = self.follow_pressure(in_force, pressure.value());

        // What is wrong, acted on while energised and otherwise only in the way of arming and acknowledging.
        let mut causes = sensor_faults(laser, [Fault::LaserRange, Fault::LaserRate, Fault::LaserStuck]);
        if !self.tick.laser_required {
            causes = FaultSet::EMPTY;
        }
        causes = causes.union(sensor_faults(pressure, [Fault::PressureRange, Fault::PressureRate, Fault::PressureStuck]));
        causes.insert_if(emergency_stop, Fault::EmergencyStop);
        causes.insert_if(pressure.value().is_some_and(|bar| bar > self.tick.over_pressure_bar), Fault::OverPressure);
        let mut faults = pending.faults.union(core::mem::take(&mut self.state.boot_faults));
        if self.state.is_energised() {
            faults = faults.union(causes).union(model_faults).union(self.timing_faults(lost_ticks));
            faults.insert_if(mismatch, Fault::PressureMismatch);
        }

        let control = self.step_control(model, in_force, pressure.value(), laser.value(), window_begins);
        let context = self.context(sample, in_force);
        let observation = Observation {
            elapsed_ticks: elapsed,
            faults,
            causes,
            arm_blockers: self.arm_blockers(model, laser, pressure, emergency_stop),
            start_blockers: self.start_blockers(),
            pressure_bar: pressure.value(),
            finished: control.1,
            request: pending.request,
            context,
        };
        let mut decision = self.tick.supervisor.step(&mut self.state.supervisor, &observation);
        self.state.notices.insert_if(decision.arm_expired, Notice::ArmExpired);

        let limited = self.tick.limiter.step(&mut self.state.limiter, decision.energised, control.0);
        let output = match limited.fault {
            None => limited.output,
            Some(fault) => {
                self.tick.supervisor.raise(&mut self.state.supervisor, fault, &context, &mut decision);
                MicroBar::ZERO
            }
        };
        self.state.notices = self.state.notices.union(limited.notices);
        self.state.limited = !limited.notices.is_empty();
        if self.tick.adaptation.is_some() {
            let running = decision.state == State::Running;
            let facts =
                TickFacts { running, limited: self.state.limited, outside_domain: model.is_outside_domain(), lost: lost_ticks > 0, laser };
            self.state.window_watch.tick(&facts);
        }
        self.follow_state(model, decision, window_begins);

        // With everything known that this tick brought.
        let begins_again = pending.wants_trace && self.state.supervisor.blockers(BlockerSet::EMPTY).is_empty();
        let answer = self.answer(pending, &observation, &decision);
        let telemetry = self.telemetry(sample, output, telemetry_dropped);
        let mut outputs = TickOutputs {
            energised: decision.energised,
            valve_share: self.tick.valve_share(output),
            output,
            vent_verified: self.state.supervisor.vent() == Vent::Verified,
            feed_watchdog: self.state.background_age_ticks < self.background_limit(),
            state: decision.state,
            self_test_wanted: decision.state == State::SelfTest,
            record_changed: decision.record_changed,
            answer,
            telemetry,
            trace: None,
        };
        outputs.trace = self.record(taken, &outputs);
        if begins_again {
            self.begin_again(model);
        }
        outputs
    }

    /// Time, lateness and the background's life.
    fn advance(&mut self, elapsed: u16, late: bool, background_beat: u32) {
        let state = &mut self.state;
        state.time_ms = state.time_ms.saturating_add(u64::from(elapsed));
        state.late_in_a_row = if late { state.late_in_a_row.saturating_add(1) } else { 0 };
        state.late_ticks = state.late_ticks.saturating_add(if late { u32::from(elapsed.saturating_sub(1)).max(1) } else { 0 });
        state.notices.insert_if(late, Notice::TickLate);
        if background_beat == state.background_beat {
            state.background_age_ticks = state.background_age_ticks.saturating_add(elapsed);
        } else {
            state.background_beat = background_beat;
            state.background_age_ticks = 0;
        }
        if state.supervisor.state() == State::Running {
            state.host_age_ticks = state.host_age_ticks.saturating_add(elapsed);
        }
    }

    fn background_limit(&self) -> u16 {
        if self.state.is_energised() { BACKGROUND_TICKS_ENERGISED } else { BACKGROUND_TICKS_VENTED }
    }

    /// Faults of time itself; they count only while energised.
    fn timing_faults(&self, lost_ticks: u16) -> FaultSet {
        let state = &self.state;
        let mut faults = FaultSet::EMPTY;
        faults.insert_if(state.late_in_a_row > self.tick.maximum_late_ticks || lost_ticks >= LOST_AT_ONCE, Fault::DeadlineMissed);
        faults.insert_if(state.background_age_ticks >= BACKGROUND_TICKS_ENERGISED, Fault::BackgroundStalled);
        let running = state.supervisor.state() == State::Running;
        faults.insert_if(running && state.host_age_ticks > self.tick.host_timeout_ticks, Fault::HostLost);
        faults
    }

    fn take_command(&mut self, model: &mut impl ModelStep, command: Option<Command>) -> Pending {
        let Some(Command { token, action }) = command else { return Pending::default() };
        let mut pending = Pending { token, ..Pending::default() };
        match action {
            // The self-test's verdict comes by its own action, with the model's period.
            Action::Request(Event::SelfTestPassed) => pending.reply = Some(Reply::Refused(Refusal::NotUnderstood)),
            Action::Request(event) => pending.request = Some(event),
            Action::SetPoint(set_point) => {
                let accepted = self.tick.controller.accept(&mut self.state.controller, &set_point);
                if accepted.is_ok() {
                    self.state.host_age_ticks = 0;
                }
                pending.reply = Some(match accepted {
                    Ok(Accepted::InForce) => Reply::Done,
                    Ok(Accepted::Buffered { next_index, free }) => Reply::Playback { next_index, free },
                    Err(refusal) => Reply::Refused(refusal),
                });
            }
            Action::PlaybackClear => {
                let running = self.state.supervisor.state() == State::Running;
                pending.reply = Some(if running {
                    Reply::Refused(Refusal::State(State::Running))
                } else {
                    self.state.controller.clear_points();
                    Reply::Done
                });
            }
            Action::Configure(tick) => {
                let state = self.state.supervisor.state();
                pending.reply = Some(if state.is_energised() {
                    Reply::Refused(Refusal::State(state))
                } else {
                    self.configure(tick);
                    Reply::Done
                });
            }
            Action::SelfTestReport { faults, model_period } => {
                pending.faults = faults;
                if self.state.supervisor.state() == State::SelfTest {
                    self.state.decimator = DecimatorConfig { factor: model_period.unwrap_or(DEFAULT_MODEL_PERIOD) }.build();
                    self.realign();
                    self.state.has_model = model_period.is_some() && faults.is_empty();
                    self.state.estimate_mm = None;
                    model.reset();
                    if model.identity() != self.state.model_identity {
                        self.state.model_identity = model.identity();
                        self.state.adaptation.reset();
                    }
                    if faults.is_empty() {
                        pending.request = Some(Event::SelfTestPassed);
                    }
                }
            }
            Action::Raise(fault) => pending.faults.insert(fault),
            Action::Status => pending.wants_status = true,
            Action::FaultRecord => pending.wants_record = true,
            Action::TraceBegin if self.state.tracing == Tracing::Off => pending.wants_trace = true,
            Action::TraceBegin => pending.reply = Some(Reply::Refused(Refusal::Traced)),
            Action::TraceEnd => {
                if self.state.tracing != Tracing::Off {
                    self.state.tracing = Tracing::Ending;
                }
                pending.reply = Some(Reply::Done);
            }
            Action::AdaptationReport => {
                let nothing = AdaptationReport { gain: 1.0, ..AdaptationReport::default() };
                let report = self.tick.adaptation.as_ref().map_or(nothing, |adaptation| adaptation.report(&self.state.adaptation));
                pending.reply = Some(Reply::AdaptationReport(report));
            }
            Action::ControlReport => pending.reply = Some(Reply::ControlReport(*self.state.controller.tracking.report())),
        }
        pending
    }

    /// Puts new settings into force. The sensors must prove themselves again: their calibration may have changed.
    fn configure(&mut self, tick: Tick) {
        if !self.tick.adapts_alike(&tick) {
            self.state.adaptation.reset();
        }
        self.tick = tick;
        self.state.laser = SensorState::default();
        self.state.pressure = SensorState::default();
        self.state.controller.clear();
        self.realign();
    }

    /// Begins a window of the decimation filter and a telemetry period with this tick: with equal periods each sample then carries the
    /// window that has just ended.
    fn realign(&mut self) {
        self.state.decimator_state = DecimatorState::default();
        self.state.window_watch = WindowWatch::default();
        self.state.telemetry_countdown = self.tick.telemetry_period_ticks;
    }

    fn step_model(
        &mut self,
        model: &mut impl ModelStep,
        in_force: MicroBar,
        pressure_bar: Option<f32>,
        displacement_mm: Option<f32>,
    ) -> FaultSet {
        let mut faults = FaultSet::EMPTY;
        let state = &mut self.state;
        let samples = [Some(in_force.bar()), pressure_bar, displacement_mm];
        state.direction = model.direction();
        state.has_compensator = model.compensator().is_some();
        if let Some(filtered) = state.decimator.step(&mut state.decimator_state, samples) {
            state.filtered = filtered;
            if state.direction == Direction::Inverse {
                state.estimate_mm = None;
                let wanted = Some(state.controller.tracking.learned_wanted_mm()).filter(|_| state.has_model);
                state.inverse_bar = wanted.map(|wanted_mm| model.step(wanted_mm)).filter(|bar| bar.is_finite());
                return faults;
            }
            state.inverse_bar = None;
            let [command_bar, pressure_bar, displacement_mm] = filtered;
            let input_bar = if self.tick.model_sees_measured { pressure_bar } else { command_bar };
            state.estimate_mm = match input_bar {
                Some(input_bar) if state.has_model => {
                    let estimate_mm = model.step(input_bar);
                    faults.insert_if(!estimate_mm.is_finite(), Fault::EstimatorNotFinite);
                    Some(estimate_mm).filter(|estimate_mm| estimate_mm.is_finite())
                }
                _ => None,
            };
            if let (Some(follower), Some(estimate_mm), Some(displacement_mm)) =
                (&self.tick.model_follower, state.estimate_mm, displacement_mm)
            {
                let mismatch = follower.step(&mut state.model_follower, estimate_mm, displacement_mm);
                faults.insert_if(mismatch, Fault::ModelMismatch);
            }
        }
        state.notices.insert_if(state.estimate_mm.is_none(), Notice::EstimateMissing);
        faults
    }

    fn follow_pressure(&mut self, in_force: MicroBar, pressure_bar: Option<f32>) -> bool {
        match pressure_bar {
            Some(pressure_bar) if self.state.is_energised() => {
                self.tick.pressure_follower.step(&mut self.state.pressure_follower, in_force.bar(), pressure_bar)
            }
            _ => {
                self.state.pressure_follower = FollowerState::default();
                false
            }
        }
    }

    /// The demand and whether the experiment is over. Armed means zero, whatever the control law would like.
    fn step_control(
        &mut self,
        model: &impl ModelStep,
        in_force: MicroBar,
        pressure_bar: Option<f32>,
        displacement_mm: Option<f32>,
        window_begins: bool,
    ) -> (Demand, bool) {
        let inputs = self.control_inputs(model, in_force, pressure_bar, displacement_mm, window_begins);
        if let Controller::Tracking(law) = &self.tick.controller {
            law.follow(&mut self.state.controller.tracking, &inputs);
        }
        if window_begins {
            self.adapt();
        }
        if self.state.supervisor.state() != State::Running {
            self.state.set_point = 0.0;
            return (Demand::Pressure(0.0), false);
        }
        let output = self.tick.controller.step(&mut self.state.controller, &inputs);
        self.state.set_point = output.set_point;
        self.state.notices = self.state.notices.union(output.notices);
        (output.demand, output.finished)
    }

    /// Learns from the window that ended last.
    fn adapt(&mut self) {
        let Some(adaptation) = &self.tick.adaptation else { return };
        let state = &mut self.state;
        let [.., laser_mm] = state.filtered;
        let raw_mm = self.tick.controller.raw_estimate_mm(&state.controller).or(state.estimate_mm).filter(|_| state.has_model);
        let ticks = state.decimator.factor();
        let hindrance = state.window_watch.end(ticks, &state.laser);
        adaptation.step(&mut state.adaptation, raw_mm, laser_mm, hindrance, f32::from(ticks) / TICKS_PER_S);
        let learns = matches!(state.adaptation.adapting(), Adapting::Both | Adapting::ZeroOnly | Adapting::NotRunning);
        state.notices.insert_if(!learns, Notice::AdaptationFrozen);
        state.notices.insert_if(adaptation.is_at_limit(&state.adaptation), Notice::AdaptationLimited);
    }

    fn control_inputs<'a>(
        &self,
        model: &'a impl ModelStep,
        in_force: MicroBar,
        pressure_bar: Option<f32>,
        displacement_mm: Option<f32>,
        window_begins: bool,
    ) -> ControlInputs<'a> {
        let [.., window_displacement_mm] = self.state.filtered;
        ControlInputs {
            output_bar: in_force.bar(),
            limited: self.state.limited,
            pressure_bar,
            displacement_mm,
            estimate_mm: self.state.estimate_mm,
            correction: self.tick.adaptation.as_ref().map(|adaptation| adaptation.correction(&self.state.adaptation)),
            window_begins,
            window_s: f32::from(self.state.decimator.factor()) / TICKS_PER_S,
            window_displacement_mm,
            inverse_bar: self.state.inverse_bar,
            outside_domain: self.state.has_model && model.is_outside_domain(),
            compensator: model.compensator().filter(|_| self.state.has_model),
        }
    }

    /// Whether adaptation's certificate was computed for a loop at least as slow as the one with this model.
    fn has_certified_model(&self, model: &impl ModelStep) -> bool {
        let Some(certified_ms) = self.tick.certified_delay_ms else { return true };
        let window = self.state.decimator.factor();
        let delay = model.compensator().map_or(0, Compensator::look_ahead_ticks).saturating_add(window);
        window == WINDOW_MS && delay <= certified_ms
    }

    fn arm_blockers(&self, model: &impl ModelStep, laser: Verdict, pressure: Verdict, emergency_stop: bool) -> BlockerSet {
        let mut blockers = BlockerSet::EMPTY;
        blockers.insert_if(emergency_stop, Blocker::EmergencyStopPressed);
        blockers.insert_if(self.tick.laser_required && laser.value().is_none(), Blocker::LaserNotPlausible);
        blockers.insert_if(pressure.value().is_none(), Blocker::PressureNotPlausible);
        blockers.insert_if(!self.has_wanted_model(), Blocker::ModelMissing);
        blockers.insert_if(!self.has_certified_model(model), Blocker::AdaptationUncertified);
        blockers.insert_if(self.state.late_in_a_row > 0, Blocker::LoopLate);
        blockers.insert_if(self.state.background_age_ticks >= BACKGROUND_TICKS_ENERGISED, Blocker::BackgroundSilent);
        blockers
    }

    /// Whether the model in use can do what the control law wants of it.
    fn has_wanted_model(&self) -> bool {
        let state = &self.state;
        let controller = &self.tick.controller;
        let Controller::Tracking(law) = controller else { return state.has_model || !controller.needs_model() };
        let inverse = state.has_model && state.direction == Direction::Inverse;
        let compensates = !law.needs_compensator() || (state.has_model && state.has_compensator);
        let learned = !law.uses_learned_inverse() || inverse;
        (state.has_model || !law.needs_model()) && compensates && learned
    }

    fn start_blockers(&self) -> BlockerSet {
        let mut blockers = BlockerSet::EMPTY;
        blockers.insert_if(!self.tick.controller.is_ready(&self.state.controller), Blocker::PlaybackEmpty);
        blockers
    }

    /// What follows from a change of state.
    fn follow_state(&mut self, model: &impl ModelStep, decision: Decision, window_begins: bool) {
        if decision.started {
            self.state.host_age_ticks = 0;
            let inputs = self.control_inputs(model, self.state.limiter.output(), None, None, window_begins);
            self.tick.controller.start(&mut self.state.controller, &inputs);
        }
        if !decision.energised {
            self.state.pressure_follower = FollowerState::default();
            self.state.model_follower = FollowerState::default();
            self.state.set_point = 0.0;
        }
    }
}

fn sensor_faults(verdict: Verdict, [range, rate, stuck]: [Fault; 3]) -> FaultSet {
    let mut faults = FaultSet::EMPTY;
    if let Verdict::Lost(reason) = verdict {
        faults.insert(match reason {
            Rejection::Range => range,
            Rejection::Rate => rate,
            Rejection::Stuck => stuck,
        });
    }
    faults
}
