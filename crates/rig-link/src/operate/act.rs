//! What an operator asks the rig to do.

use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use dashboard::{Action, Mode, Phase};
use model_export::link::message::{Baseline, Request};
use model_export::link::settings::SettingValue;
use model_export::link::state::State;

use super::rig::OperatedRig;
use super::simulated;
use crate::experiment;
use crate::link::Transport;

/// How long arming may wait for a blocker that passes by itself.
const PASSING: Duration = Duration::from_millis(500);

impl OperatedRig {
    fn arm(&mut self, mode: Mode) -> Result<()> {
        let status = experiment::status(&mut self.client)?;
        if status.state == State::Idle {
            let law = match mode {
                Mode::Playback => 0,
                Mode::Pressure => 1,
                Mode::Displacement => 2,
            };
            self.borrowed.borrow(&mut self.client, "control.law", SettingValue::Integer(law))?;
            (self.mode, self.plays) = (mode, mode == Mode::Playback);
            if self.plays {
                self.send_ahead()?;
            }
            self.wait_for_what_passes()?;
        }
        Ok(self.client.command(&Request::Arm)?)
    }

    /// Changed settings and a fresh vent make the device ask for a moment.
    fn wait_for_what_passes(&mut self) -> Result<()> {
        // By the rig's own time, for a simulation may be slower than real time.
        let until = self.client.transport().elapsed() + PASSING;
        loop {
            let blockers = experiment::status(&mut self.client)?.blockers;
            if blockers.iter().all(|blocker| !experiment::PASSING.contains(&blocker)) || self.client.transport().elapsed() >= until {
                return Ok(());
            }
            self.client.listen_for(Duration::from_millis(10))?;
        }
    }

    fn start(&mut self, value: Option<f32>) -> Result<()> {
        if self.mode == Mode::Playback {
            return Ok(self.client.command(&Request::Start)?);
        }
        // A set-point of the last run may be far from where the rig is now.
        let value = value.unwrap_or(0.0);
        self.check_set_point(value)?;
        self.client.command(&Request::Start)?;
        self.set_point = value;
        Ok(self.send_set_point()?)
    }

    fn check_set_point(&self, value: f32) -> Result<()> {
        ensure!(value.is_finite(), "the set-point is not a number");
        let ceiling_bar = self.limits.ceiling_bar;
        ensure!(
            self.mode != Mode::Pressure || (0.0..=ceiling_bar).contains(&value),
            "{value} bar is outside of 0 to {ceiling_bar} bar (limits.ceiling_bar)"
        );
        Ok(())
    }

    fn hold(&mut self, value: f32) -> Result<()> {
        ensure!(self.mode != Mode::Playback, "an excitation is loaded; disarm, and arm for a set-point");
        self.check_set_point(value)?;
        self.set_point = value;
        // In force at once; from then on each sign of life repeats it.
        if self.phase == Phase::Running {
            self.send_set_point()?;
        }
        Ok(())
    }

    fn inject(&mut self, fault: Option<&str>) -> Result<()> {
        let breakage = fault.map(simulated::breakage).transpose()?;
        let hardware = self.client.transport().line().hardware().context("only a simulated rig can be broken")?;
        hardware.set_breakage(breakage);
        self.injected = fault.map(str::to_owned);
        Ok(())
    }

    fn change_plant(&mut self, name: &str) -> Result<()> {
        ensure!(!self.phase.is_energised(), "not while the rig is armed: vent first");
        let plant = simulated::plant(name, &self.given_plant)?;
        let hardware = self.client.transport().line().hardware().context("only a simulated rig has a plant of choice")?;
        hardware.set_muscle(Box::new(plant.start(0.0)));
        self.plant = Some(name.to_owned());
        self.stroke.forget();
        self.ask_the_plant();
        self.wizard.revision += 1;
        Ok(())
    }

    pub(super) fn carry_out(&mut self, action: &Action) -> Result<()> {
        let beside = matches!(action, Action::Vent | Action::Answer { .. } | Action::Inject { .. });
        ensure!(beside || self.task.is_none(), "something runs by itself; vent ends it");
        match action {
            Action::Vent => {
                self.client.command(&Request::Vent)?;
                if self.task.is_some() {
                    self.end_task("it was vented");
                }
            }
            Action::Calibrate { step } => self.begin_step(step)?,
            Action::Answer { value } => self.answer(*value)?,
            Action::Accept => self.accept()?,
            Action::Follow { controller, reference } => self.begin_to_follow(controller, reference)?,
            Action::Arm { mode } => self.arm(*mode)?,
            Action::Disarm => self.client.command(&Request::Disarm)?,
            Action::Start { value } => self.start(*value)?,
            Action::Stop => self.client.command(&Request::Stop)?,
            Action::Hold { value } => self.hold(*value)?,
            Action::Load { excitation } => self.load(excitation)?,
            Action::Acknowledge => self.client.command(&Request::Acknowledge)?,
            Action::Set { name, value } => {
                self.borrowed.set(&mut self.client, name, value)?;
                self.changed_settings()?;
            }
            Action::Save => {
                self.borrowed.without(&mut self.client, |rig| Ok(rig.command(&Request::SettingsSave)?))?;
                self.changed_settings()?;
            }
            Action::Revert { defaults } => {
                let baseline = if *defaults { Baseline::Defaults } else { Baseline::Saved };
                self.borrowed.without(&mut self.client, |rig| Ok(rig.command(&Request::SettingsRevert(baseline))?))?;
                self.wizard.forget();
                self.changed_settings()?;
            }
            Action::Inject { fault } => self.inject(fault.as_deref())?,
            Action::Plant { name } => self.change_plant(name)?,
            Action::Record { .. } | Action::EndRecord => bail!("recordings are the session's"),
        }
        Ok(())
    }
}
