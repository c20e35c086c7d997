//! The control law's step, with adaptation between model and law.

use model_export::link::adaptation::Adapting;
use model_export::link::fault::Notice;
use model_export::link::state::State;

use super::ports::ModelStep;
use super::state::Rig;
use crate::control::{ControlInputs, ControlLaw, Controller, Demand};
use crate::number::MicroBar;
use crate::plausibility::ResidualState;
use crate::supervisor::Decision;
use crate::time::TICKS_PER_S;

impl Rig {
    /// The demand and whether the experiment is over. Armed means zero, whatever the control law would like.
    pub(super) fn step_control(
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
    pub(super) fn adapt(&mut self) {
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

    pub(super) fn control_inputs<'a>(
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

    /// What follows from a change of state.
    pub(super) fn follow_state(&mut self, model: &impl ModelStep, decision: Decision, window_begins: bool) {
        if decision.started {
            self.state.host_age_ticks = 0;
            let inputs = self.control_inputs(model, self.state.limiter.output(), None, None, window_begins);
            self.tick.controller.start(&mut self.state.controller, &inputs);
        }
        if !decision.energised {
            self.state.pressure_residual = ResidualState::default();
            self.state.model_residual = ResidualState::default();
            self.state.set_point = 0.0;
        }
    }
}
