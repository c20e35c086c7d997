//! What a rig tells of itself: answers, status, telemetry, the context of a fault, and what a simulation may look at.

use model_export::link::fault::{BlockerSet, NoticeSet};
use model_export::link::history::HistoryRow;
use model_export::link::message::{FaultRecord, Refusal, Reply, Status, Telemetry};

use super::commands::Pending;
use super::ports::{Answer, TickInputs, TickOutputs};
use super::state::Rig;
use crate::control::Controller;
use crate::drivers::RawSample;
use crate::history::thousandths;
use crate::number::MicroBar;
use crate::plausibility::SensorState;
use crate::supervisor::{Decision, Observation};

/// What a tick saw and did, for whoever asks why: more than the outputs tell, and never sent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Insight {
    /// Ticks since the start.
    pub time_ms: u64,
    /// What was limited or degraded.
    pub notices: NoticeSet,
    /// Set-point in force, in the control law's quantity.
    pub set_point: f32,
    /// Number of the playback point in force, counted from one; zero before the first.
    pub playback_index: u32,
    /// What the feedback adds to the reference, mm, if the law tracks one.
    pub correction_mm: Option<f32>,
    /// Measured pressure, if the sensor is believed.
    pub pressure_bar: Option<f32>,
    /// Measured displacement, if the laser is believed.
    pub displacement_mm: Option<f32>,
    /// The model's estimate.
    pub estimate_mm: Option<f32>,
    /// How long ago the host last sent a set-point while running, in ms.
    pub host_age_ms: u16,
}

/// What of a tick's inputs the history keeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TakenIn {
    /// The sample.
    pub sample: RawSample,
    /// Whether the emergency stop was pressed.
    pub emergency_stop: bool,
    /// Whether ticks were lost before it, or the one before took too long.
    pub late: bool,
}

impl From<&TickInputs> for TakenIn {
    fn from(inputs: &TickInputs) -> Self {
        Self { sample: inputs.sample, emergency_stop: inputs.emergency_stop, late: inputs.overran || inputs.lost_ticks > 0 }
    }
}

impl Rig {
    /// What the last tick saw and did.
    pub fn insight(&self) -> Insight {
        let state = &self.state;
        let believed = |sensor: &SensorState| sensor.is_believed().then(|| sensor.last_value());
        Insight {
            time_ms: state.time_ms,
            notices: state.notices,
            set_point: state.set_point,
            playback_index: self.tick.controller.point_index(&state.controller),
            correction_mm: matches!(self.tick.controller, Controller::Tracking(_))
                .then(|| state.controller.tracking.report().correction_mm),
            pressure_bar: believed(&state.pressure),
            displacement_mm: believed(&state.laser),
            estimate_mm: self.estimate_mm(),
            host_age_ms: state.host_age_ticks,
        }
    }

    /// What the tick that has just been leaves in the history.
    pub fn history_row(&self, taken: TakenIn, outputs: &TickOutputs) -> HistoryRow {
        let TakenIn { sample, emergency_stop, late } = taken;
        HistoryRow {
            laser_code: sample.laser_code,
            pressure_code: sample.pressure_code,
            valve_share: outputs.valve_share,
            set_point_thousandths: thousandths(Some(self.state.set_point)),
            estimate_thousandths: thousandths(self.estimate_mm()),
            state: outputs.state,
            emergency_stop,
            late,
            energised: outputs.energised,
        }
    }

    /// The estimate in use, adapted if adaptation is on: what the control law listens to, or else the model's.
    pub(super) fn estimate_mm(&self) -> Option<f32> {
        let state = &self.state;
        let adapted = |raw_mm: f32| match &self.tick.adaptation {
            Some(adaptation) => adaptation.correction(&state.adaptation).apply(raw_mm),
            None => raw_mm,
        };
        self.tick.controller.estimate_mm(&state.controller).or(state.estimate_mm.map(adapted))
    }

    pub(super) fn context(&self, sample: RawSample, in_force: MicroBar) -> FaultRecord {
        FaultRecord {
            time_ms: self.state.time_ms,
            output_ubar: in_force.0,
            pressure_code: sample.pressure_code,
            laser_code: sample.laser_code,
            pressure_bar: self.state.pressure.last_value(),
            displacement_mm: self.state.laser.last_value(),
            estimate_mm: self.state.estimate_mm.unwrap_or(f32::NAN),
            set_point: self.state.set_point,
            late_ticks: self.state.late_ticks,
            ..FaultRecord::default()
        }
    }

    pub(super) fn answer(&self, pending: Pending, observation: &Observation, decision: &Decision) -> Option<Answer> {
        let token = pending.token?;
        let blockers = self.state.supervisor.blockers(BlockerSet::EMPTY);
        let reply = if pending.wants_trace && !blockers.is_empty() {
            Reply::Refused(Refusal::Blocked(blockers))
        } else if pending.wants_status || pending.wants_trace {
            Reply::Status(self.status(observation.arm_blockers))
        } else if pending.wants_record {
            let record = *self.state.supervisor.record();
            if record.first == 0 { Reply::Refused(Refusal::NoRecord) } else { Reply::FaultRecord(record) }
        } else if let Some(reply) = pending.reply {
            reply
        } else {
            decision.refusal.map_or(Reply::Done, Reply::Refused)
        };
        Some(Answer { token, reply })
    }

    /// The part of the status that the tick knows.
    fn status(&self, arm_blockers: BlockerSet) -> Status {
        let record = self.state.supervisor.record();
        Status {
            state: self.state.supervisor.state(),
            first_fault: record.first,
            faults: record.all,
            blockers: self.state.supervisor.blockers(arm_blockers),
            notices: self.state.notices,
            time_ms: self.state.time_ms,
            late_ticks: self.state.late_ticks,
            reset_cause: self.state.reset_cause,
            playback_next_index: self.tick.controller.points(&self.state.controller).next_index(),
            playback_free: self.tick.controller.points(&self.state.controller).free(),
            ..Status::default()
        }
    }

    pub(super) fn telemetry(&mut self, sample: RawSample, output: MicroBar, dropped: u32) -> Option<Telemetry> {
        let state = &mut self.state;
        state.telemetry_countdown = state.telemetry_countdown.saturating_sub(1);
        if state.telemetry_countdown > 0 {
            return None;
        }
        let estimate_mm = self.estimate_mm();
        let state = &mut self.state;
        state.telemetry_countdown = self.tick.telemetry_period_ticks;
        let sequence = state.telemetry_sequence;
        state.telemetry_sequence = sequence.wrapping_add(1);
        let [command_bar, pressure_bar, displacement_mm] = state.filtered;
        Some(Telemetry {
            sequence,
            time_ms: state.time_ms,
            dropped,
            state: state.supervisor.state(),
            first_fault: state.supervisor.record().first,
            notices: state.notices,
            laser_code: sample.laser_code,
            pressure_code: sample.pressure_code,
            output_ubar: output.0,
            command_bar: command_bar.unwrap_or(0.0),
            set_point: state.set_point,
            pressure_bar,
            displacement_mm,
            estimate_mm,
            playback_index: self.tick.controller.point_index(&state.controller),
            late_ticks: state.late_ticks,
            ..Telemetry::default()
        })
    }
}
