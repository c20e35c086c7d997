//! What stands in the way of arming and starting.

use model_export::link::fault::{Blocker, BlockerSet};

use super::ports::{Direction, ModelStep};
use super::state::Rig;
use super::timing::BACKGROUND_TICKS_ENERGISED;
use crate::certificate::WINDOW_MS;
use crate::control::{Compensator, ControlLaw, Controller};
use crate::plausibility::Verdict;

impl Rig {
    /// Whether adaptation's certificate was computed for a loop at least as slow as the one with this model.
    pub(super) fn has_certified_model(&self, model: &impl ModelStep) -> bool {
        let Some(certified_ms) = self.tick.certified_delay_ms else { return true };
        let window = self.state.decimator.factor();
        let delay = model.compensator().map_or(0, Compensator::look_ahead_ticks).saturating_add(window);
        window == WINDOW_MS && delay <= certified_ms
    }

    pub(super) fn arm_blockers(&self, model: &impl ModelStep, laser: Verdict, pressure: Verdict, emergency_stop: bool) -> BlockerSet {
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
    pub(super) fn has_wanted_model(&self) -> bool {
        let state = &self.state;
        let controller = &self.tick.controller;
        let Controller::Tracking(law) = controller else { return state.has_model || !controller.needs_model() };
        let inverse = state.has_model && state.direction == Direction::Inverse;
        let compensates = !law.needs_compensator() || (state.has_model && state.has_compensator);
        let learned = !law.uses_learned_inverse() || inverse;
        (state.has_model || !law.needs_model()) && compensates && learned
    }

    pub(super) fn start_blockers(&self) -> BlockerSet {
        let mut blockers = BlockerSet::EMPTY;
        blockers.insert_if(!self.tick.controller.is_ready(&self.state.controller), Blocker::PlaybackEmpty);
        blockers
    }
}
