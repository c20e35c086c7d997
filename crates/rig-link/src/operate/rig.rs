//! A rig with what a session knows of it: how it is met, and what keeps it running.

use std::time::Instant;

use anyhow::Result;
use calibration::step::Plan;
use dashboard::{Mode, Phase, Setting};
use model_export::link::message::{Quantity, Request};
use model_export::link::settings::SettingValue;
use serde_json::Value;

use super::borrow::Borrowed;
use super::limits::KnownLimits;
use super::offers::Offers;
use super::pace::{Line, Paced};
use super::play::Play;
use super::reach::{Reach, Stroke};
use super::task::Task;
use super::wizard::Wizard;
use super::{simulated, words};
use crate::calibrate;
use crate::experiment;
use crate::link::{Client, LinkError, Transport};

/// A rig, opened, with what a session knows of it.
pub struct OperatedRig {
    pub(super) client: Client<Paced>,
    pub(super) place: String,
    /// What the command line chose to move the tip.
    pub(super) given_plant: String,
    pub(super) plant: Option<String>,
    pub(super) injected: Option<String>,
    pub(super) borrowed: Borrowed,
    pub(super) mode: Mode,
    pub(super) phase: Phase,
    /// Set-point in the mode's unit.
    pub(super) set_point: f32,
    pub(super) play: Option<Play>,
    /// Whether what runs, or is about to, is played by the device's own clock.
    pub(super) plays: bool,
    pub(super) offers: Offers,
    pub(super) wizard: Wizard,
    /// What the steps of the calibration would do with the settings in use.
    pub(super) plan: Option<Plan>,
    pub(super) task: Option<Task>,
    /// Whether a task's points have taken the place of the operator's excitation, which is kept.
    pub(super) task_plays: bool,
    pub(super) loaded: Option<Play>,
    /// Settings that a task changed, with what the session had there.
    pub(super) lent: Vec<(&'static str, SettingValue)>,
    /// How far the tip went, and how far that of a simulated rig goes.
    pub(super) stroke: Stroke,
    pub(super) simulated_reach: Option<Reach>,
    /// How the last reference was followed.
    pub(super) followed: Option<Value>,
    /// Something more may follow the last sign of life until then.
    pub(super) window_until: Instant,
    pub(super) limits: KnownLimits,
    pub(super) unsaved: bool,
    /// Settings as the operator has them: while the rig is energised none can change, and reading all of them takes longer than heartbeats may wait.
    pub(super) settings: Vec<Setting>,
    pub(super) supply: (Option<f32>, Option<f32>),
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
            stroke: Stroke::default(),
            simulated_reach: None,
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
        rig.ask_the_plant();
        rig.client.begin_account();
        Ok(rig)
    }

    pub(super) fn send_set_point(&mut self) -> Result<(), LinkError> {
        let quantity = if self.mode == Mode::Displacement { Quantity::Displacement } else { Quantity::Pressure };
        self.client.send(&Request::SetPoint { quantity, value: self.set_point }).map(|_| ())
    }

    pub(super) fn send_points(&mut self) -> Result<(), LinkError> {
        if let Some(play) = &mut self.play {
            let token = self.client.send(&Request::Playback(play.feed.chunk()))?;
            play.sent(token);
        }
        Ok(())
    }

    /// How far the tip goes, by the best that is known.
    pub(super) fn reach(&self) -> Reach {
        let KnownLimits { ceiling_bar, linear_mm_per_bar, linear_offset_mm, .. } = self.limits;
        let line = Reach::of_line(linear_offset_mm.into(), linear_mm_per_bar.into(), ceiling_bar.into());
        Reach::best(self.stroke.reach(ceiling_bar.into()), self.simulated_reach, line)
    }

    /// Has the plant of a simulated rig, which is new or has new limits, say how far its tip goes.
    pub(super) fn ask_the_plant(&mut self) {
        let hardware = self.client.transport().line().hardware();
        self.simulated_reach = self.plant.as_deref().zip(hardware).and_then(|(name, hardware)| {
            let (plant, config) = (simulated::plant(name, &self.given_plant).ok()?, hardware.config());
            Some(Reach::of_plant(&plant, f64::from(self.limits.ceiling_bar).min(config.supply_bar), config.rest_mm))
        });
    }

    /// Reads anew what depends on the settings.
    pub(super) fn changed_settings(&mut self) -> Result<()> {
        self.limits = KnownLimits::read(&mut self.client)?;
        self.ask_the_plant();
        self.unsaved = self.borrowed.are_unsaved(&mut self.client)?;
        let before = std::mem::replace(&mut self.settings, self.borrowed.list(&mut self.client)?);
        // What was measured by other maps of the sensors does not hold any more.
        let measures = |setting: &Setting| setting.name.starts_with("laser.") || setting.name.starts_with("pressure.");
        if self.settings.iter().zip(&before).any(|(now, then)| measures(now) && now.value != then.value) {
            self.stroke.forget();
        }
        self.plan = Some(calibrate::plan(&mut self.client, self.wizard.choices(), self.wizard.highest_command_bar())?);
        self.wizard.revision += 1;
        Ok(())
    }
}
