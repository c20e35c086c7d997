//! Time itself: late and lost ticks, the background's life, the host's.

use model_export::link::fault::{Fault, FaultSet, Notice};
use model_export::link::state::State;

use super::state::Rig;

/// The background must show life this often while energised.
pub const BACKGROUND_TICKS_ENERGISED: u16 = 40;
/// And this often while vented, where a flash erase may take its time.
pub const BACKGROUND_TICKS_VENTED: u16 = 4000;
/// Ticks lost at once that are a fault however few in a row are tolerated.
pub const LOST_AT_ONCE: u16 = 20;
impl Rig {
    /// Time, lateness and the background's life.
    pub(super) fn advance(&mut self, elapsed: u16, late: bool, background_beat: u32) {
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

    pub(super) fn background_limit(&self) -> u16 {
        if self.state.is_energised() { BACKGROUND_TICKS_ENERGISED } else { BACKGROUND_TICKS_VENTED }
    }

    /// Faults of time itself; they count only while energised.
    pub(super) fn timing_faults(&self, lost_ticks: u16) -> FaultSet {
        let state = &self.state;
        let mut faults = FaultSet::EMPTY;
        faults.insert_if(state.late_in_a_row > self.tick.maximum_late_ticks || lost_ticks >= LOST_AT_ONCE, Fault::DeadlineMissed);
        faults.insert_if(state.background_age_ticks >= BACKGROUND_TICKS_ENERGISED, Fault::BackgroundStalled);
        let running = state.supervisor.state() == State::Running;
        faults.insert_if(running && state.host_age_ticks > self.tick.host_timeout_ticks, Fault::HostLost);
        faults
    }
}
