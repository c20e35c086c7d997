//! A rig that people operate through the dashboard: the link's client behind [`dashboard::Rig`].
//!
//! What keeps a running device running leaves only in [`OperatedRig::renew`] and within [`RENEWAL_WINDOW`] of it, so that a device whose operator is
//! silent is silent for the device too. Settings that a session needs (telemetry at the full rate, the control law, the playback's period) are
//! borrowed: never saved, and set back at its end.

mod borrow;
mod excite;
mod follow;
mod measure;
mod pace;
mod play;
mod simulated;
mod task;
#[cfg(test)]
mod tests;
mod told;
mod wizard;
mod words;

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use calibration::step::{Finding, Plan};
use dashboard::{Action, Identity, Mode, Phase, Preview, Problem, RENEWAL_WINDOW, Rig, RigState, Sample, Setting};
use model_export::blob;
use model_export::link::fault::Fault;
use model_export::link::message::{Baseline, Quantity, Request};
use model_export::link::settings::SettingValue;
use model_export::link::state::State;
use serde_json::{Value, json};

pub use pace::Line;

use self::borrow::Borrowed;
use self::excite::KnownLimits;
use self::pace::Paced;
use self::play::Play;
use self::task::Task;
use self::wizard::Wizard;
use crate::calibrate::{self, Change};
use crate::experiment;
use crate::link::{Client, LinkError, Transport, refusal_in_words, version};
use simulation::excitation;

/// How long arming may wait for a blocker that passes by itself.
const PASSING: Duration = Duration::from_millis(500);
/// Cycles of a tick at 168 MHz.
const CYCLES_PER_TICK: u32 = 168_000;

/// A controller that can be chosen.
#[derive(Clone, Copy, Debug)]
pub struct Controller {
    /// Its name.
    pub name: &'static str,
    /// `control.feed_forward`.
    pub feed_forward: u32,
    /// `control.sensor`.
    pub sensor: u32,
}

/// What a session offers beyond the link; it comes from whoever opens it.
#[derive(Clone, Copy)]
pub struct Offers {
    /// Controllers.
    pub controllers: &'static [Controller],
    /// Names of the references.
    pub references: &'static [&'static str],
    /// Time between two points of a reference, s; whole milliseconds.
    pub reference_period_s: f64,
    /// Points of a reference by name, within a lowest and a highest displacement, mm, with a seed.
    pub reference: fn(&str, [f64; 2], u64) -> Option<Vec<f64>>,
    /// The printable page of a calibration: board, firmware, whether it is saved, findings and changed settings.
    pub calibration_page: fn(&str, &str, bool, &[Finding], &[Change]) -> String,
}

/// A rig, opened, with what a session knows of it.
pub struct OperatedRig {
    client: Client<Paced>,
    place: String,
    /// What the command line chose to move the tip.
    given_plant: String,
    plant: Option<String>,
    injected: Option<String>,
    borrowed: Borrowed,
    mode: Mode,
    phase: Phase,
    /// Set-point in the mode's unit.
    set_point: f32,
    play: Option<Play>,
    /// Whether what runs, or is about to, is played by the device's own clock.
    plays: bool,
    offers: Offers,
    wizard: Wizard,
    /// What the steps of the calibration would do with the settings in use.
    plan: Option<Plan>,
    task: Option<Task>,
    /// Whether a task's points have taken the place of the operator's excitation, which is kept.
    task_plays: bool,
    loaded: Option<Play>,
    /// Settings that a task changed, with what the session had there.
    lent: Vec<(&'static str, SettingValue)>,
    /// How the last reference was followed.
    followed: Option<Value>,
    /// Something more may follow the last sign of life until then.
    window_until: Instant,
    limits: KnownLimits,
    unsaved: bool,
    /// Settings as the operator has them: while the rig is energised none can change, and reading all of them takes longer than heartbeats may wait.
    settings: Vec<Setting>,
    supply: (Option<f32>, Option<f32>),
}

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
    /// Meets the device behind a line; `telemetry_ms` is the time from one sample to the next.
    ///
    /// # Errors
    /// When it does not answer, or speaks another protocol.
    pub fn new(line: Line, plant: &str, telemetry_ms: u32, offers: Offers) -> Result<Self> {
        let simulated = line.is_simulated();
        let mut client = Client::connect(Paced::new(line))?;
        // A rig that has just been switched on tests itself; one that has run for long is asked once.
        let ready = experiment::settle(&mut client)?;
        let limits = KnownLimits::read(&mut client)?;
        let place = client.transport().place().to_owned();
        let mut rig = Self {
            client,
            place,
            given_plant: plant.to_owned(),
            plant: simulated.then(|| plant.to_owned()),
            injected: None,
            borrowed: Borrowed::default(),
            mode: Mode::default(),
            phase: words::phase(ready.state),
            set_point: 0.0,
            play: None,
            plays: false,
            offers,
            wizard: Wizard::default(),
            plan: None,
            task: None,
            task_plays: false,
            loaded: None,
            lent: Vec::new(),
            followed: None,
            window_until: Instant::now(),
            limits,
            unsaved: false,
            settings: Vec::new(),
            supply: (None, None),
        };
        // Somebody else may have left it armed: then it tells as slowly as it does.
        if !ready.state.is_energised() {
            rig.borrowed.borrow(&mut rig.client, "telemetry.period_ms", SettingValue::Integer(telemetry_ms))?;
            rig.unsaved = rig.borrowed.are_unsaved(&mut rig.client)?;
        }
        rig.settings = rig.borrowed.list(&mut rig.client)?;
        rig.plan = Some(calibrate::plan(&mut rig.client, rig.wizard.choices(), None)?);
        rig.client.begin_account();
        Ok(rig)
    }

    fn send_set_point(&mut self) -> Result<(), LinkError> {
        let quantity = if self.mode == Mode::Displacement { Quantity::Displacement } else { Quantity::Pressure };
        self.client.send(&Request::SetPoint { quantity, value: self.set_point }).map(|_| ())
    }

    fn send_points(&mut self) -> Result<(), LinkError> {
        if let Some(play) = &mut self.play {
            let token = self.client.send(&Request::Playback(play.feed.chunk()))?;
            play.sent(token);
        }
        Ok(())
    }

    fn hear_of_points(&mut self) {
        if let Some(play) = &mut self.play
            && let Some(token) = play.waits_for()
            && let Some(reply) = self.client.take_reply(token)
        {
            play.take(&reply);
        }
    }

    fn listen_to_all(&mut self, limit: Duration, into: &mut Vec<Sample>) -> Result<()> {
        let until = Instant::now() + limit;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if self.client.transport().line().is_simulated() {
                // One nap instead of one for each millisecond.
                std::thread::sleep(left);
                self.client.listen(Duration::ZERO)?;
            } else {
                self.client.listen(left)?;
            }
            self.hear_of_points();
            let more = self.play.as_ref().is_some_and(|play| play.waits_for().is_none() && play.feed.has_room());
            if more && self.phase == Phase::Running && self.plays && Instant::now() < self.window_until {
                self.send_points()?;
            }
            while let Some(told) = self.client.take_telemetry() {
                let sample = words::sample(&told);
                self.supply = (told.supply_v, told.chip_celsius);
                let ended = self.phase == Phase::Running && sample.phase == Phase::Armed && self.plays;
                self.phase = sample.phase;
                into.push(sample);
                if let Some(task) = &mut self.task
                    && let Err(error) = task.see(&told)
                {
                    self.end_task(&format!("{error:#}"));
                }
                if ended && self.play.as_ref().is_some_and(|play| play.feed.is_sent()) {
                    // The experiment is over.
                    self.client.send(&Request::Disarm)?;
                }
            }
            self.go_on_with_task()?;
            if Instant::now() >= until {
                return Ok(());
            }
        }
    }

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
        let until = Instant::now() + PASSING;
        loop {
            let blockers = experiment::status(&mut self.client)?.blockers;
            if blockers.iter().all(|blocker| !experiment::PASSING.contains(&blocker)) || Instant::now() >= until {
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
        Ok(())
    }

    fn changed_settings(&mut self) -> Result<()> {
        self.limits = KnownLimits::read(&mut self.client)?;
        self.unsaved = self.borrowed.are_unsaved(&mut self.client)?;
        self.settings = self.borrowed.list(&mut self.client)?;
        self.plan = Some(calibrate::plan(&mut self.client, self.wizard.choices(), self.wizard.highest_command_bar())?);
        self.wizard.revision += 1;
        Ok(())
    }

    fn carry_out(&mut self, action: &Action) -> Result<()> {
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
        Ok(json!({ "controllers": named, "references": self.offers.references, "followed": self.followed }))
    }

    fn reference(&mut self, reference: &Value) -> Result<Value, Problem> {
        follow::preview(&self.offers, reference).map_err(problem)
    }

    fn close(&mut self) {
        // As much as still works: the device vents by itself anyway.
        let _ = self.client.command(&Request::Vent);
        let _ = self.borrowed.give_back(&mut self.client);
    }
}
