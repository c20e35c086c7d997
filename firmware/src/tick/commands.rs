//! What the background wants of a tick: taken in, and what is left to do or to answer.

use model_export::link::adaptation::AdaptationReport;
use model_export::link::fault::FaultSet;
use model_export::link::message::{Refusal, Reply};
use model_export::link::state::State;

use super::config::Tick;
use super::ports::{Action, Command, ModelStep};
use super::state::{DEFAULT_MODEL_PERIOD, Rig, Tracing};
use crate::adaptation::WindowWatch;
use crate::control::{Accepted, ControlLaw};
use crate::decimate::{DecimatorConfig, DecimatorState};
use crate::plausibility::SensorState;
use crate::supervisor::Event;

/// What a command left to do in its tick.
#[derive(Default)]
pub(super) struct Pending {
    pub(super) token: Option<u32>,
    pub(super) request: Option<Event>,
    pub(super) reply: Option<Reply>,
    pub(super) wants_status: bool,
    pub(super) wants_record: bool,
    pub(super) wants_trace: bool,
    pub(super) faults: FaultSet,
}

impl Rig {
    pub(super) fn take_command(&mut self, model: &mut impl ModelStep, command: Option<Command>) -> Pending {
        let Some(Command { token, action }) = command else { return Pending::default() };
        let mut pending = Pending { token, ..Pending::default() };
        match action {
            // The self-test's verdict comes by its own action, with the model's period.
            Action::Request(Event::SelfTestPassed) => pending.reply = Some(Reply::Refused(Refusal::NotUnderstood)),
            Action::Request(event) => pending.request = Some(event),
            Action::SetPoint(set_point) => {
                let accepted = self.tick.controller.accept(&mut self.state.controller, &set_point);
                // A buffer that is full has its points from this host, which is there to send more.
                if matches!(accepted, Ok(_) | Err(Refusal::PlaybackFull(_))) {
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
    pub(super) fn configure(&mut self, tick: Tick) {
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
    pub(super) fn realign(&mut self) {
        self.state.decimator_state = DecimatorState::default();
        self.state.window_watch = WindowWatch::default();
        self.state.telemetry_countdown = self.tick.telemetry_period_ticks;
    }
}
