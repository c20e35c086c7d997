//! One millisecond, from inputs to outputs, in its order.

use model_export::link::fault::{BlockerSet, Fault, FaultSet, Notice, NoticeSet};
use model_export::link::message::{Refusal, Reply};
use model_export::link::state::State;

use super::ports::{ModelStep, TickInputs, TickOutputs};
use super::state::Rig;
use super::trace::Taken;
use crate::adaptation::TickFacts;
use crate::number::MicroBar;
use crate::plausibility::{Rejection, Verdict};
use crate::supervisor::{Event, Observation, Vent};

impl Rig {
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
        let mismatch = self.judge_pressure(in_force, pressure.value());

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
