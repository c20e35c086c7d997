//! What runs by itself under the operator's lease: a step of the calibration, or a reference that a controller follows.
//!
//! A task collects samples while the session listens. Whatever energises the rig leaves only in [`OperatedRig::renew_task`], which is a sign of life of
//! the operator: a task whose operator is silent waits vented, or vents by the device's own time-to-live.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use calibration::step::{Instruction, Kind};
use dashboard::{Asked, Mode, Phase, RENEWAL_WINDOW, Task as Told};
use model_export::link::fault::Blocker;
use model_export::link::message::Request;
use model_export::link::settings::SettingValue;
use model_export::link::state::State;

use super::follow::Following;
use super::measure::Measuring;
use super::play::Play;
use super::rig::OperatedRig;
use super::task::{Stage, Task, What};
use super::{wizard, words};
use crate::calibrate::{self, BORNE_MISMATCH_BAR, Question};
use crate::device_settings;
use crate::energise::VENTED_WITHIN;
use crate::experiment;
use crate::link::LinkError;

/// What passes by itself has passed by then.
const READY_WITHIN: Duration = Duration::from_secs(5);
/// Time between two looks whether the pressure is gone.
const LOOK: Duration = Duration::from_millis(50);

impl OperatedRig {
    /// Begins a step of the calibration.
    pub(super) fn begin_step(&mut self, name: &str) -> Result<()> {
        let kind = wizard::kind(name)?;
        ensure!(self.phase == Phase::Idle, "a step begins with a rig that is vented and idle: vent first");
        let plan = calibrate::plan(&mut self.client, self.wizard.choices(), self.wizard.highest_command_bar())?;
        self.wizard.begin(kind, &plan);
        self.plan = Some(plan);
        // The courses of a step have a sample each 2 ms.
        let begun = self.lend("telemetry.period_ms", SettingValue::Integer(1)).and_then(|()| self.next_instruction(kind));
        begun.inspect_err(|error| self.end_task(&format!("{error:#}")))
    }

    fn next_instruction(&mut self, kind: Kind) -> Result<()> {
        let Some(instruction) = self.wizard.step()?.next() else {
            self.wizard.complete()?;
            self.leave_task();
            return Ok(());
        };
        let mismatch_bar = |rig: &mut Self| -> Result<SettingValue> {
            let name = "mismatch.pressure_bar";
            let SettingValue::Float(now_bar) = device_settings::setting(&mut rig.client, name)? else { bail!("{name} is no pressure") };
            Ok(SettingValue::Float(now_bar.max(BORNE_MISMATCH_BAR)))
        };
        match &instruction {
            Instruction::HoldPressure { command_bar, .. } if *command_bar > 0.0 => {
                let borne = mismatch_bar(self)?;
                self.lend("mismatch.pressure_bar", borne)?;
                self.borrowed.borrow(&mut self.client, "control.law", SettingValue::Integer(1))?;
                (self.mode, self.plays, self.set_point) = (Mode::Pressure, false, *command_bar as f32);
            }
            Instruction::Play { period_ms, commands_bar } => {
                let borne = mismatch_bar(self)?;
                self.lend("mismatch.pressure_bar", borne)?;
                let points = commands_bar.iter().map(|bar| *bar as f32).collect();
                self.give_to_play(Mode::Playback, points, *period_ms)?;
            }
            _ => {}
        }
        let measuring = Measuring::new(instruction);
        let energises = measuring.energises();
        self.task = Some(Task::new(What::Measure(kind, measuring), energises));
        Ok(())
    }

    /// Loads points for the task, in place of what the operator has loaded.
    fn give_to_play(&mut self, mode: Mode, points: Vec<f32>, period_ms: u32) -> Result<()> {
        let law = if mode == Mode::Displacement { 2 } else { 0 };
        self.borrowed.borrow(&mut self.client, "control.law", SettingValue::Integer(law))?;
        let loaded = self.play.replace(Play::new(points, period_ms));
        if !self.task_plays {
            (self.loaded, self.task_plays) = (loaded, true);
        }
        (self.mode, self.plays) = (mode, true);
        self.send_ahead()
    }

    /// Begins to follow a reference.
    pub(super) fn begin_to_follow(&mut self, controller: &str, reference: &serde_json::Value) -> Result<()> {
        ensure!(self.phase == Phase::Idle, "a reference begins with a rig that is vented and idle: vent first");
        let known = self.offers.controllers.iter().find(|known| known.name == controller);
        let known = *known.with_context(|| format!("there is no controller {controller}"))?;
        let following = Following::new(&self.offers, &self.reach(), controller, reference)?;
        let points = following.points_mm.iter().map(|point| *point as f32).collect();
        let prepared = self
            .lend("control.feed_forward", SettingValue::Integer(known.feed_forward))
            .and_then(|()| self.lend("control.sensor", SettingValue::Integer(known.sensor)))
            .and_then(|()| self.give_to_play(Mode::Displacement, points, following.period_ms));
        if let Err(error) = prepared {
            self.leave_task();
            return Err(error);
        }
        self.task = Some(Task::new(What::Follow(following), true));
        Ok(())
    }

    /// An answer of the person at the page.
    pub(super) fn answer(&mut self, value: f64) -> Result<()> {
        let Some(Task { what: What::Measure(_, measuring), .. }) = &mut self.task else { bail!("nothing is asked now") };
        let asked = measuring.asks();
        measuring.answer(value)?;
        if let (Some(Question::Target { .. }), Some(hardware)) = (asked, self.client.transport().line().hardware()) {
            hardware.place_target(Some(value));
        }
        Ok(())
    }

    /// Puts what the step found into use.
    pub(super) fn accept(&mut self) -> Result<()> {
        ensure!(self.task.is_none() && self.phase == Phase::Idle, "not while something runs: vent first");
        let changes = calibrate::apply(&mut self.client, self.wizard.found()?)?;
        self.wizard.take(changes)?;
        self.changed_settings()
    }

    /// A sign of life: what waits to be energised begins now.
    pub(super) fn renew_task(&mut self) -> Result<()> {
        let Some(Task { stage: Stage::Waits(since), .. }) = &self.task else { return Ok(()) };
        let since = *since;
        let status = experiment::status(&mut self.client)?;
        if !status.blockers.is_empty() {
            if experiment::blocked_for_long(&status) || since.elapsed() > READY_WITHIN {
                let reasons: Vec<_> = status.blockers.iter().map(|blocker| blocker.explanation()).collect();
                let reasons: Vec<_> = reasons.iter().map(|reason| format!("{} {}", reason.meaning, reason.remedy)).collect();
                self.end_task(&format!("the rig does not arm: {}", reasons.join(" ")));
            }
            return Ok(());
        }
        let begun = self.client.command(&Request::Arm).and_then(|()| self.client.command(&Request::Start));
        if let Err(error) = begun {
            self.end_task(&format!("the rig does not start: {error}"));
            return Ok(());
        }
        if let Some(task) = &mut self.task {
            task.stage = Stage::Runs;
        }
        self.window_until = Instant::now() + RENEWAL_WINDOW;
        Ok(if self.plays { self.send_points() } else { self.send_set_point() }?)
    }

    /// Goes on with what the samples so far allow; called whenever the session has listened.
    pub(super) fn go_on_with_task(&mut self) -> Result<()> {
        self.give_back_what_was_lent()?;
        let Some(task) = &mut self.task else { return Ok(()) };
        match task.stage {
            Stage::Vented if task.is_complete() => self.take_measurement(),
            Stage::Runs if task.is_complete() => {
                task.stage = Stage::Vents(Instant::now(), Instant::now());
                self.client.command(&Request::Vent)?;
                Ok(())
            }
            Stage::Vents(since, looked) if looked.elapsed() >= LOOK => {
                task.stage = Stage::Vents(since, Instant::now());
                let status = experiment::status(&mut self.client)?;
                self.phase = words::phase(status.state);
                if status.state == State::Idle && !status.blockers.contains(Blocker::VentNotVerified) {
                    return self.take_measurement();
                }
                if since.elapsed() > VENTED_WITHIN {
                    self.end_task("the measured pressure was not seen below 0.1 bar after venting: close the supply by hand");
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn take_measurement(&mut self) -> Result<()> {
        let Some(Task { what, .. }) = self.task.take() else { return Ok(()) };
        let taken = match what {
            What::Measure(kind, measuring) => measuring
                .finish()
                .and_then(|measurement| Ok(self.wizard.step()?.take(measurement)?))
                .and_then(|()| self.next_instruction(kind)),
            What::Follow(following) => {
                self.followed = Some(following.result());
                self.wizard.revision += 1;
                self.leave_task();
                Ok(())
            }
        };
        match taken {
            // The device, or the line to it, is another matter than what was measured.
            Err(error) if error.downcast_ref::<LinkError>().is_none() => self.end_task(&format!("{error:#}")),
            other => return other,
        }
        Ok(())
    }

    /// Ends what runs, vented, without a finding.
    pub(super) fn end_task(&mut self, why: &str) {
        match self.task.take() {
            Some(Task { what: What::Follow(following), .. }) => {
                self.followed = Some(following.ended(why));
                self.wizard.revision += 1;
            }
            _ => self.wizard.fail(why),
        }
        // Whatever state it is in: a device that is vented vents again.
        let _ = self.client.command(&Request::Vent);
        self.leave_task();
    }

    /// Leaves the target and the operator's excitation as they were.
    fn leave_task(&mut self) {
        self.task = None;
        if let Some(hardware) = self.client.transport().line().hardware() {
            hardware.place_target(None);
        }
        if self.task_plays {
            (self.play, self.task_plays) = (self.loaded.take(), false);
        }
    }

    /// Changes a setting for the time of a task.
    fn lend(&mut self, name: &'static str, value: SettingValue) -> Result<()> {
        if !self.lent.iter().any(|(lent, _)| *lent == name) {
            self.lent.push((name, device_settings::setting(&mut self.client, name)?));
        }
        self.borrowed.borrow(&mut self.client, name, value)
    }

    /// Settings change while the rig is idle only.
    fn give_back_what_was_lent(&mut self) -> Result<()> {
        if self.task.is_some() || self.phase != Phase::Idle || self.lent.is_empty() {
            return Ok(());
        }
        for (name, value) in std::mem::take(&mut self.lent) {
            self.borrowed.restore(&mut self.client, name, value)?;
        }
        Ok(())
    }

    /// What runs, for people.
    pub(super) fn told_task(&mut self) -> Option<Told> {
        let task = self.task.as_ref()?;
        let (kind, name, share, asks) = match &task.what {
            What::Measure(kind, measuring) => ("calibrate", kind.name().to_owned(), measuring.share(), measuring.asks()),
            What::Follow(following) => ("follow", following.name(), following.share(), None),
        };
        let does = match (&task.stage, &task.what) {
            _ if asks.is_some() => "waits for you",
            (Stage::Waits(_), _) => "waits until the rig is ready",
            (Stage::Vents(..), _) => "vents",
            (Stage::Runs, What::Follow(_)) => "follows",
            (Stage::Vented | Stage::Runs, _) => "measures",
        };
        let asks = asks.map(|question| self.asked(&question));
        Some(Told { kind, name, does: does.to_owned(), share, asks })
    }

    /// A question with what is likely the answer: on a simulated rig the simulation places the target and reads the gauge.
    fn asked(&mut self, question: &Question) -> Asked {
        let hardware = self.client.transport().line().hardware();
        match question {
            Question::Target { distance_mm } => {
                Asked { text: format!("Place the target at {distance_mm} mm. Where is it?"), unit: "mm", value: Some(*distance_mm) }
            }
            Question::Gauge { command_bar } => Asked {
                text: format!("The device was asked for {command_bar:.3} bar. What does the gauge read?"),
                unit: "bar",
                // A gauge with three digits.
                value: hardware.map(|hardware| (hardware.pressure_bar() * 1e3).round() * 1e-3),
            },
        }
    }
}
