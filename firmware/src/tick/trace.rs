//! The tick's own account of itself, for a host that wants to do the same ticks again: [`TickOutputs::trace`].
//!
//! A trace cannot begin in the middle of things, since nobody could send all that a rig remembers. So the rig begins again: it forgets what it
//! remembers but the clock, and goes the way of every start, from [`State::Boot`] through the self-test. It does so only while idle with
//! the vent verified and no fault latched, so there is nothing that could get lost with it; and what it watched, it watches anew.

use model_export::blob::crc32;
use model_export::link::fault::FaultSet;
use model_export::link::state::{ResetCause, State};
use model_export::link::trace::{TraceCommand, TraceExtra, TraceFlags, TraceRecord};

use super::config::Tick;
use super::ports::{Action, BootReport, Command, Direction, ModelStep, NoModel, TickInputs, TickOutputs};
use super::state::{DEFAULT_MODEL_PERIOD, Rig, TickState, Tracing};
use crate::adaptation::WindowWatch;
use crate::decimate::{DecimatorConfig, DecimatorState};
use crate::limiter::LimiterState;
use crate::plausibility::{ResidualState, SensorState};
use crate::supervisor::Event;

/// What a rig that begins again keeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// Ticks since the start.
    pub time_ms: u64,
    /// Ticks of them that came late or were lost.
    pub late_ticks: u32,
    /// Why the device started.
    pub reset_cause: ResetCause,
}

/// What of a tick's inputs is gone when its outputs are there.
pub(super) struct Taken {
    flags: TraceFlags,
    laser_code: u16,
    pressure_code: u16,
    extra: Option<TraceExtra>,
}

impl Taken {
    /// Of these inputs, before the tick has looked at them.
    pub(super) fn new(state: &TickState, inputs: &TickInputs, model: &impl ModelStep) -> Self {
        let mut flags = TraceFlags::default();
        flags.insert_if(inputs.emergency_stop, TraceFlags::EMERGENCY_STOP);
        flags.insert_if(inputs.overran, TraceFlags::OVERRAN);
        flags.insert_if(inputs.background_beat != state.background_beat, TraceFlags::BEAT);
        flags.insert_if(inputs.vent, TraceFlags::VENT);
        flags.insert_if(model.is_present(), TraceFlags::MODEL);
        flags.insert_if(state.tracing == Tracing::First, TraceFlags::FIRST);
        let command = inputs.command.as_ref().map_or(TraceCommand::None, named);
        let extra = TraceExtra { lost_ticks: inputs.lost_ticks, command };
        Self {
            flags,
            laser_code: inputs.sample.laser_code,
            pressure_code: inputs.sample.pressure_code,
            extra: Some(extra).filter(|extra| *extra != TraceExtra::default()),
        }
    }
}

/// A command's name in the trace.
fn named(command: &Command) -> TraceCommand {
    match (command.token, &command.action) {
        (Some(token), _) => TraceCommand::Request(token),
        (None, Action::SelfTestReport { faults, model_period }) => {
            TraceCommand::SelfTestReport { faults: *faults, model_period: model_period.map_or(0, core::num::NonZeroU16::get) }
        }
        (None, Action::Raise(fault)) => TraceCommand::Raise(fault.number()),
        (None, Action::Request(Event::Retest)) => TraceCommand::Retest,
        // The background sends nothing else by itself.
        _ => TraceCommand::None,
    }
}

impl Rig {
    /// A rig as one that has just begun again, with its trace running: what a replay starts from.
    pub fn begun_again(tick: Tick, origin: Origin) -> Self {
        let mut rig = Self::new(tick, BootReport::default());
        rig.state.time_ms = origin.time_ms;
        rig.state.late_ticks = origin.late_ticks;
        rig.state.reset_cause = origin.reset_cause;
        rig.begin_again(&mut NoModel);
        rig
    }

    /// Tells no more ticks, until a trace begins anew.
    pub fn end_trace(&mut self) {
        self.state.tracing = Tracing::Off;
    }

    /// Forgets, in place, everything but the clock and why the device started. The trace begins with the next tick.
    pub(super) fn begin_again(&mut self, model: &mut impl ModelStep) {
        // Every field by its name, so that no new one is left out.
        let TickState {
            time_ms: _,
            boot_faults,
            laser,
            pressure,
            pressure_residual,
            model_residual,
            decimator,
            decimator_state,
            has_model,
            filtered,
            estimate_mm,
            inverse_bar,
            has_compensator,
            direction,
            controller,
            adaptation,
            window_watch,
            model_identity,
            supervisor,
            limiter,
            limited,
            set_point,
            notices: _,
            host_age_ticks,
            late_in_a_row,
            late_ticks: _,
            background_beat: _,
            background_age_ticks,
            telemetry_sequence,
            telemetry_countdown,
            reset_cause: _,
            tracing,
        } = &mut self.state;
        *boot_faults = FaultSet::EMPTY;
        (*laser, *pressure) = (SensorState::default(), SensorState::default());
        (*pressure_residual, *model_residual) = (ResidualState::default(), ResidualState::default());
        *decimator = DecimatorConfig { factor: DEFAULT_MODEL_PERIOD }.build();
        *decimator_state = DecimatorState::default();
        (*has_model, *has_compensator, *limited) = (false, false, false);
        *filtered = Default::default();
        (*estimate_mm, *inverse_bar) = (None, None);
        *direction = Direction::default();
        controller.clear();
        adaptation.reset();
        (*window_watch, *model_identity) = (WindowWatch::default(), [0; 8]);
        supervisor.begin_again();
        *limiter = LimiterState::default();
        *set_point = 0.0;
        (*host_age_ticks, *late_in_a_row, *background_age_ticks) = (0, 0, 0);
        (*telemetry_sequence, *telemetry_countdown) = (0, self.tick.telemetry_period_ticks);
        *tracing = Tracing::First;
        model.reset();
    }

    /// The record of a tick, if it is traced.
    pub(super) fn record(&mut self, taken: Taken, outputs: &TickOutputs) -> Option<TraceRecord> {
        let crc = match self.state.tracing {
            Tracing::Off => return None,
            Tracing::Ending => {
                self.state.tracing = Tracing::Off;
                return Some(TraceRecord::end(false));
            }
            Tracing::First => 0,
            Tracing::On(crc) => crc,
        };
        let crc = self.check(crc, outputs);
        self.state.tracing = Tracing::On(crc);
        let Taken { flags, laser_code, pressure_code, extra } = taken;
        let [low, high, ..] = crc.to_le_bytes();
        Some(TraceRecord { flags, laser_code, pressure_code, extra, check: u16::from_le_bytes([low, high]) })
    }

    /// Continues the checksum over the outputs of a tick, and over what led to them.
    #[inline(never)]
    fn check(&self, crc: u32, outputs: &TickOutputs) -> u32 {
        let state = &self.state;
        let number = State::ALL.iter().zip(0u8..).find(|(candidate, _)| **candidate == outputs.state).map_or(0, |(_, number)| number);
        let flags = u8::from(outputs.energised)
            | (u8::from(outputs.feed_watchdog) << 1)
            | (u8::from(outputs.self_test_wanted) << 2)
            | (u8::from(outputs.record_changed) << 3);
        let [share_low, share_high] = outputs.valve_share.to_le_bytes();
        let crc = crc32(crc, &[number, flags, share_low, share_high]);
        let crc = crc32(crc, &outputs.output.0.to_le_bytes());
        let crc = crc32(crc, &state.notices.0.to_le_bytes());
        let [command_bar, pressure_bar, displacement_mm] = state.filtered;
        let estimate_mm = self.estimate_mm();
        [Some(state.set_point), command_bar, pressure_bar, displacement_mm, estimate_mm]
            .iter()
            .fold(crc, |crc, value| crc32(crc, &value.unwrap_or(f32::NAN).to_bits().to_le_bytes()))
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::format;

    use model_export::link::message::Quantity;
    use model_export::link::settings::Settings;

    use super::super::config::{RigFacts, TickConfig};
    use super::*;
    use crate::calibration::ConverterConfig;
    use crate::control::SetPoint;
    use crate::drivers::RawSample;

    const FACTS: RigFacts = RigFacts { converter: ConverterConfig { full_scale_code: 8190, full_scale_v: 3.3 } };

    /// A rig with a past: a run to 1.5 bar and back, with late and lost ticks, now vented and idle.
    fn experienced(law: u32) -> Rig {
        let settings = Settings { control_law: law, mismatch_pressure_bar: 5.0, maximum_late_ticks: 100, ..Settings::default() };
        let tick = TickConfig { settings: &settings, facts: FACTS }.build().unwrap();
        let mut rig = Rig::new(tick, BootReport { reset_cause: ResetCause::Pin, faults: FaultSet::EMPTY });
        let quantity = if law == 1 { Quantity::Pressure } else { Quantity::Displacement };
        for round in 0..3000_u32 {
            let noise = u16::try_from(round * 7 % 5).unwrap();
            // The muscle follows the output at once.
            let pressure_code = rig.tick.pressure.calibration().code(rig.state.limiter.output().bar()) + noise;
            let sample = RawSample {
                laser_code: rig.tick.laser.calibration().code(5.0 + 2.0 * rig.state.limiter.output().bar()) + noise,
                pressure_code,
            };
            let action = match round {
                250 => Some(Action::SelfTestReport { faults: FaultSet::EMPTY, model_period: None }),
                400 => Some(Action::Request(Event::Arm)),
                410 => Some(Action::Request(Event::Start)),
                420..2000 if round % 50 == 0 => Some(Action::SetPoint(SetPoint::Value(quantity, 1.5))),
                2000 => Some(Action::Request(Event::Disarm)),
                _ => None,
            };
            let command = action.map(|action| Command { token: None, action });
            let lost_ticks = u16::from(round % 500 == 7);
            let inputs =
                TickInputs { sample, lost_ticks, overran: round % 700 == 3, background_beat: round, command, ..TickInputs::default() };
            rig.tick(&mut NoModel, inputs);
        }
        rig
    }

    #[test]
    fn a_rig_that_begins_again_is_in_everything_like_one_without_a_past() {
        for law in [1, 2] {
            let mut rig = experienced(law);
            assert_eq!(
                rig.state.supervisor.blockers(model_export::link::fault::BlockerSet::EMPTY).0,
                0,
                "law {law}: {:?}",
                rig.state.supervisor
            );
            assert!(rig.state.late_ticks > 5 && rig.state.telemetry_sequence > 100, "law {law}: it has a past");
            let origin = Origin { time_ms: rig.state.time_ms, late_ticks: rig.state.late_ticks, reset_cause: ResetCause::Pin };
            let mut fresh = Rig::begun_again(rig.tick.clone(), origin);
            // The counter of the background is what it is, and notices belong to the tick that is over.
            (fresh.state.background_beat, fresh.state.notices) = (rig.state.background_beat, rig.state.notices);
            assert_ne!(format!("{:?}", rig.state), format!("{:?}", fresh.state));
            rig.begin_again(&mut NoModel);
            assert_eq!(format!("{:?}", rig.state), format!("{:?}", fresh.state), "law {law}");
        }
    }

    #[test]
    fn a_trace_is_refused_while_energised_and_a_second_one_always() {
        let mut rig = experienced(1);
        let mut ask = |action| {
            let command = Some(Command { token: Some(1), action });
            let sample = RawSample { laser_code: 4000, pressure_code: rig.tick.pressure.calibration().code(0.0) };
            let outputs = rig.tick(&mut NoModel, TickInputs { sample, command, ..TickInputs::default() });
            (outputs.answer.unwrap().reply, outputs.trace)
        };
        use model_export::link::message::{Refusal, Reply};
        assert_eq!(ask(Action::Request(Event::Arm)).0, Reply::Done);
        assert!(matches!(ask(Action::TraceBegin).0, Reply::Refused(Refusal::Blocked(_))));
        assert_eq!(ask(Action::Request(Event::Disarm)).0, Reply::Done);
        // Five ticks below the limit verify the vent.
        for _ in 0..5 {
            ask(Action::Status);
        }
        let (reply, record) = ask(Action::TraceBegin);
        assert!(matches!(reply, Reply::Status(status) if status.state == State::Idle), "{reply:?}");
        assert_eq!(record, None, "the trace begins behind its request");
        let (reply, record) = ask(Action::TraceBegin);
        assert_eq!(reply, Reply::Refused(Refusal::Traced));
        assert!(record.unwrap().flags.contains(TraceFlags::FIRST));
        assert_eq!(ask(Action::TraceEnd), (Reply::Done, Some(TraceRecord::end(false))));
        assert_eq!(ask(Action::TraceEnd), (Reply::Done, None));
    }
}
