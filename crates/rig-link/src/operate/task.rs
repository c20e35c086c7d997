//! A task, which runs by itself: what it does, where it is, and the samples that it collects.

use std::time::Instant;

use anyhow::{Result, bail, ensure};
use calibration::step::Kind;
use model_export::link::message::Telemetry;
use model_export::link::state::State;

use super::follow::Following;
use super::measure::Measuring;
use crate::link::fault_in_words;

/// Where a task is.
#[derive(Clone, Copy, Debug)]
pub enum Stage {
    /// Vented, for as long as it takes.
    Vented,
    /// Vented; begins with a sign of life, once nothing blocks it.
    Waits(Instant),
    /// Energised.
    Runs,
    /// Told to vent; looked at last.
    Vents(Instant, Instant),
}

/// What it does.
pub enum What {
    Measure(Kind, Measuring),
    Follow(Following),
}

/// What runs by itself under the lease.
pub struct Task {
    pub what: What,
    pub stage: Stage,
    has_run: bool,
}

impl Task {
    /// Nothing of it is done yet; one that energises the rig waits for a sign of life.
    pub fn new(what: What, energises: bool) -> Self {
        let stage = if energises { Stage::Waits(Instant::now()) } else { Stage::Vented };
        Self { what, stage, has_run: false }
    }

    /// Takes a sample; an error ends the task.
    pub fn see(&mut self, told: &Telemetry) -> Result<()> {
        match &mut self.what {
            What::Measure(_, measuring) => measuring.see(told),
            What::Follow(following) => following.see(told),
        }
        if !matches!(self.stage, Stage::Runs) {
            return Ok(());
        }
        match told.state {
            State::Running => self.has_run = true,
            State::Fault => bail!("the rig vented with {}", fault_in_words(told.first_fault)),
            State::Armed if self.has_run => match &mut self.what {
                What::Measure(_, measuring) => {
                    measuring.has_played();
                    ensure!(measuring.is_complete(), "the rig stopped by itself");
                }
                What::Follow(following) => following.has_played(),
            },
            // One from before the start may still have been on its way.
            _ if self.has_run => bail!("the rig stopped by itself"),
            _ => {}
        }
        Ok(())
    }

    /// Whether the end was reached.
    pub fn is_complete(&self) -> bool {
        match &self.what {
            What::Measure(_, measuring) => measuring.is_complete(),
            What::Follow(following) => following.is_complete(),
        }
    }
}
