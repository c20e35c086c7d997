//! What the dashboard is told of the device's state.

use anyhow::Result;
use dashboard::{Account, Playing, RigState};
use model_export::link::message::Status;

use super::rig::OperatedRig;
use super::words;
use crate::experiment;

impl OperatedRig {
    /// A status as the dashboard has it.
    pub(super) fn told(&mut self, status: &Status) -> Result<RigState> {
        self.phase = words::phase(status.state);
        let mut faults: Vec<_> = status.faults.iter().map(|fault| words::explained('E', &fault.explanation())).collect();
        // The first one is what to look at.
        faults.sort_by_key(|fault| fault.number != status.first_fault);
        let fault_record =
            if status.first_fault == 0 { None } else { experiment::fault_record(&mut self.client)?.as_ref().map(words::record) };
        let account = self.client.account();
        let account = Account {
            received: account.received,
            dropped_by_device: account.dropped_by_device,
            lost_on_the_line: account.lost_on_the_line,
            damaged_frames: account.damaged_frames,
        };
        let has_model = self.client.hello().model_id != [0; 8];
        Ok(RigState {
            phase: self.phase,
            faults,
            fault_record,
            blockers: status.blockers.iter().map(|blocker| words::explained('B', &blocker.explanation())).collect(),
            notices: status.notices.iter().map(|notice| words::explained('N', &notice.explanation())).collect(),
            time_ms: status.time_ms,
            late_ticks: status.late_ticks,
            longest_tick_cycles: status.longest_tick_cycles,
            reset_cause: words::reset_cause(status.reset_cause).to_owned(),
            settings_unsaved: self.unsaved,
            mode: self.mode,
            ceiling_bar: self.limits.ceiling_bar,
            host_timeout_ms: self.limits.host_timeout_ms,
            bound_mm: has_model.then_some(self.limits.estimate_bound_mm),
            supply_v: self.supply.0,
            chip_celsius: self.supply.1,
            playing: self.play.as_ref().map(|play| Playing { points: play.feed.length(), sent: play.feed.confirmed() }),
            injected: self.injected.clone(),
            plant: self.plant.clone(),
            account,
            speed: self.client.transport().speed(),
            task: self.told_task(),
            revision: self.wizard.revision,
        })
    }
}
