//! The rig as the dashboard's session has it.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use dashboard::{Action, Identity, Phase, Preview, Problem, RENEWAL_WINDOW, Rig, RigState, Sample, Setting};
use model_export::blob;
use model_export::link::fault::Fault;
use model_export::link::message::Request;
use serde_json::{Value, json};
use simulation::excitation;

use super::pace::Paced;
use super::rig::OperatedRig;
use super::{follow, simulated, words};
use crate::experiment;
use crate::link::{Client, LinkError, refusal_in_words, version};

/// Cycles of a tick at 168 MHz.
const CYCLES_PER_TICK: u32 = 168_000;

/// A problem as the dashboard tells it; what the device refuses is no reason to give the rig up.
fn problem(error: anyhow::Error) -> Problem {
    match error.downcast_ref::<LinkError>() {
        Some(LinkError::Refused(refusal)) => {
            let context = if error.chain().len() > 1 { format!("{error}: ") } else { String::new() };
            Problem::Refused(format!("{context}{}", refusal_in_words(refusal)))
        }
        Some(_) => Problem::Gone(format!("{error:#}")),
        None => Problem::Refused(format!("{error:#}")),
    }
}

fn gone(error: LinkError) -> Problem {
    problem(error.into())
}

impl OperatedRig {
    /// What a task did: what the device refuses ends the task, not the session.
    fn outlive(&mut self, done: Result<()>) -> Result<(), Problem> {
        match done.map_err(problem) {
            Err(Problem::Refused(why)) => {
                self.end_task(&why);
                Ok(())
            }
            other => other,
        }
    }
}

impl Rig for OperatedRig {
    fn identity(&self) -> Identity {
        let hello = self.client.hello();
        let simulated = self.plant.is_some();
        let id = hello.model_id;
        Identity {
            place: self.place.clone(),
            board: hello.board.to_string(),
            firmware: version(hello.firmware),
            model_id: (id != [0; 8]).then(|| id.iter().map(|byte| format!("{byte:02x}")).collect()),
            simulated,
            plant: self.plant.clone(),
            plants: if simulated { simulated::plants(&self.given_plant) } else { Vec::new() },
            faults: if simulated { simulated::faults() } else { Vec::new() },
            cycles_per_tick: if hello.build.chip == 0 { 0 } else { CYCLES_PER_TICK },
            notices: words::notice_table(),
            fault_table: words::fault_table(),
        }
    }

    fn listen(&mut self, limit: Duration, into: &mut Vec<Sample>) -> Result<(), Problem> {
        let listened = self.listen_to_all(limit, into);
        self.outlive(listened)
    }

    fn state(&mut self) -> Result<RigState, Problem> {
        experiment::status(&mut self.client).map_err(anyhow::Error::from).and_then(|status| self.told(&status)).map_err(problem)
    }

    fn renew(&mut self) -> Result<(), Problem> {
        let begun = self.renew_task();
        self.outlive(begun)?;
        if self.phase != Phase::Running {
            return Ok(());
        }
        self.window_until = Instant::now() + RENEWAL_WINDOW;
        if self.plays { self.send_points() } else { self.send_set_point() }.map_err(gone)
    }

    fn act(&mut self, action: &Action) -> Result<(), Problem> {
        self.carry_out(action).map_err(problem)
    }

    fn settings(&mut self) -> Result<Vec<Setting>, Problem> {
        Ok(self.settings.clone())
    }

    fn preview(&mut self, excitation: &Value) -> Result<Preview, Problem> {
        let (config, pressure_bar, problem) = self.sampled(excitation).map_err(problem)?;
        Ok(Preview {
            period_s: config.sample_period_s,
            pressure_bar,
            ceiling_bar: self.limits.ceiling_bar.into(),
            problem,
            file: excitation::to_toml(&config),
        })
    }

    fn upload(&mut self, bytes: &[u8]) -> Result<(), Problem> {
        let upload = |rig: &mut Client<Paced>| -> Result<()> {
            blob::decode(bytes).map_err(|error| anyhow::anyhow!("this is no blob that this program knows: {error}"))?;
            let id = blob::content_id(bytes).context("this is no blob")?;
            experiment::upload(rig, bytes, &mut |_| {})?;
            rig.command(&Request::ModelActivate { id })?;
            let status = experiment::settle_after_change(rig)?;
            if let Some(fault) = Fault::from_number(status.first_fault) {
                bail!("the device is in the fault state: {} {}", fault.explanation().meaning, fault.explanation().remedy);
            }
            rig.greet_again()?;
            Ok(())
        };
        upload(&mut self.client).map_err(problem)
    }

    fn abandon(&mut self, why: &str) -> Result<(), Problem> {
        let vented = if self.phase.is_energised() { self.client.command(&Request::Vent).map_err(gone) } else { Ok(()) };
        if self.task.is_some() {
            self.end_task(why);
        }
        vented
    }

    fn calibration(&mut self) -> Result<Value, Problem> {
        let plan = self.plan.as_ref().ok_or_else(|| Problem::Refused("the settings of the rig are not known yet".to_owned()))?;
        Ok(self.wizard.describe(plan))
    }

    fn calibration_page(&mut self) -> Result<String, Problem> {
        let (findings, changes) = self.wizard.result().map_err(problem)?;
        let hello = self.client.hello();
        Ok((self.offers.calibration_page)(&hello.board, &version(hello.firmware), !self.unsaved, findings, &changes))
    }

    fn controllers(&mut self) -> Result<Value, Problem> {
        let named: Vec<&str> = self.offers.controllers.iter().map(|controller| controller.name).collect();
        Ok(json!({ "controllers": named, "references": self.offers.references, "followed": self.followed, "reach": self.reach().told() }))
    }

    fn reference(&mut self, reference: &Value) -> Result<Value, Problem> {
        follow::preview(&self.offers, &self.reach(), reference).map_err(problem)
    }

    fn close(&mut self) {
        // As much as still works: the device vents by itself anyway.
        let _ = self.client.command(&Request::Vent);
        let _ = self.borrowed.give_back(&mut self.client);
    }
}
