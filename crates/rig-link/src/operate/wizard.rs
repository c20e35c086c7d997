//! The calibration of an operated rig: which steps there are, what they found, what was taken into use.

use anyhow::{Context, Result, ensure};
use calibration::step::{Finding, Kind, Plan, Step};
use model_export::link::settings::by_name;
use serde_json::{Value, json};

use super::words;
use crate::calibrate::{self, Change, Choices};

/// The calibration of a session. What it found stays until the settings are reverted; a step can be repeated at any time.
#[derive(Default)]
pub struct Wizard {
    choices: Choices,
    highest_command_bar: Option<f64>,
    /// The step under way, or the one whose finding waits to be taken.
    step: Option<Step>,
    found: Option<Finding>,
    taken: Vec<Finding>,
    changes: Vec<Change>,
    /// Why a step ended without a finding.
    problem: Option<(Kind, String)>,
    /// Counts what [`Self::describe`] would tell anew.
    pub revision: u32,
}

/// A kind by its name.
pub fn kind(name: &str) -> Result<Kind> {
    Kind::ALL.into_iter().find(|kind| kind.name() == name).with_context(|| format!("there is no step {name}"))
}

/// What a step calibrates.
pub fn title(kind: Kind) -> &'static str {
    match kind {
        Kind::Noise => "Noise at rest",
        Kind::Laser => "Laser: zero and span",
        Kind::Pressure => "Pressure sensor: zero and span",
        Kind::Valve => "Valve: dead band, hysteresis, full scale",
        Kind::Response => "Response: fill, vent, delay to the laser",
    }
}

impl Wizard {
    /// How far the steps to come may ask, bar.
    pub fn highest_command_bar(&self) -> Option<f64> {
        self.highest_command_bar
    }

    /// What may be chosen.
    pub fn choices(&self) -> &Choices {
        &self.choices
    }

    /// Begins a step; what it found before is taken away, what is in use stays.
    pub fn begin(&mut self, kind: Kind, plan: &Plan) {
        (self.step, self.found, self.problem) = (Some(Step::new(kind, plan)), None, None);
        self.revision += 1;
    }

    /// The step under way.
    pub fn step(&mut self) -> Result<&mut Step> {
        self.step.as_mut().context("no step is under way")
    }

    /// The step's last instruction was carried out.
    pub fn complete(&mut self) -> Result<()> {
        self.found = Some(self.step()?.finding()?);
        self.revision += 1;
        Ok(())
    }

    /// The step ended without a finding; one that has its finding is not under way any more.
    pub fn fail(&mut self, why: &str) {
        if self.found.is_some() {
            return;
        }
        if let Some(step) = self.step.take() {
            self.problem = Some((step.kind(), why.to_owned()));
            self.revision += 1;
        }
    }

    /// The finding that waits to be taken.
    pub fn found(&self) -> Result<&Finding> {
        self.found.as_ref().context("no step has found anything that is not in use")
    }

    /// The finding is in use, which changed these settings.
    pub fn take(&mut self, changes: Vec<Change>) -> Result<()> {
        let (step, finding) = (self.step.take().context("no step is under way")?, self.found.take().context("nothing was found")?);
        self.highest_command_bar = calibrate::highest_command_bar(&step, &finding, self.highest_command_bar);
        calibrate::merge(&mut self.changes, changes);
        self.taken.retain(|taken| taken.kind != finding.kind);
        self.taken.push(finding);
        self.taken.sort_by_key(|taken| taken.kind);
        self.revision += 1;
        Ok(())
    }

    /// The settings of before are in use again.
    pub fn forget(&mut self) {
        *self = Self { revision: self.revision + 1, ..Self::default() };
    }

    /// What is in use, and the settings that differ.
    ///
    /// # Errors
    /// When no step was taken into use.
    pub fn result(&self) -> Result<(&[Finding], Vec<Change>)> {
        ensure!(!self.taken.is_empty(), "no step is done yet");
        let changes = self.changes.iter().filter(|(_, before, after)| before != after).copied().collect();
        Ok((&self.taken, changes))
    }

    fn described(&self, kind: Kind, plan: &Plan) -> Value {
        let current = self.step.as_ref().filter(|step| step.kind() == kind);
        let found = self.found.as_ref().filter(|found| found.kind == kind);
        let taken = self.taken.iter().find(|taken| taken.kind == kind);
        let problem = self.problem.as_ref().filter(|(failed, _)| *failed == kind).map(|(_, why)| why);
        let state = match (found, current, problem, taken) {
            (Some(_), ..) => "found",
            (_, Some(_), ..) => "running",
            (_, _, Some(_), _) => "failed",
            (_, _, _, Some(_)) => "taken",
            _ => "open",
        };
        // A step under way does what it said before it began.
        let explanation = current.map_or_else(|| Step::new(kind, plan).explanation(), Step::explanation);
        json!({
            "name": kind.name(), "title": title(kind), "explanation": explanation, "state": state, "problem": problem,
            "finding": found.or(taken),
        })
    }

    /// Every step with what it will do or has found, and the settings that differ from those before the first one.
    pub fn describe(&self, plan: &Plan) -> Value {
        let steps: Vec<Value> = Kind::ALL.into_iter().map(|kind| self.described(kind, plan)).collect();
        let changed = self.changes.iter().filter(|(_, before, after)| before != after);
        let changes: Vec<Value> = changed
            .map(|(name, before, after)| {
                let unit = by_name(name).map_or("", |info| info.unit);
                json!({ "name": name, "before": words::value(*before), "after": words::value(*after), "unit": unit })
            })
            .collect();
        json!({ "revision": self.revision, "steps": steps, "changes": changes })
    }
}
