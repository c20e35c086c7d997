//! The model's step and the comparisons of what should agree: estimate and laser, command and pressure.

use model_export::link::fault::{Fault, FaultSet, Notice};

use super::ports::{Direction, ModelStep};
use super::state::Rig;
use crate::number::MicroBar;
use crate::plausibility::ResidualState;

impl Rig {
    pub(super) fn step_model(
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
            if let (Some(monitor), Some(estimate_mm), Some(displacement_mm)) =
                (&self.tick.model_residual, state.estimate_mm, displacement_mm)
            {
                let mismatch = monitor.step(&mut state.model_residual, estimate_mm, displacement_mm);
                faults.insert_if(mismatch, Fault::ModelMismatch);
            }
        }
        state.notices.insert_if(state.estimate_mm.is_none(), Notice::EstimateMissing);
        faults
    }

    pub(super) fn judge_pressure(&mut self, in_force: MicroBar, pressure_bar: Option<f32>) -> bool {
        match pressure_bar {
            Some(pressure_bar) if self.state.is_energised() => {
                self.tick.pressure_residual.step(&mut self.state.pressure_residual, in_force.bar(), pressure_bar)
            }
            _ => {
                self.state.pressure_residual = ResidualState::default();
                false
            }
        }
    }
}
