//! A discovered model as TOML: the operators, the effects with their parameters in the lab's units, and where it all came from.
//!
//! The file holds normalised values, which the model runs on, and beside them the same parameters in units, for people. Effects that
//! follow the session's time (drift, change of set-up, rhythm) stand where the session ended: that is the rig as it is now.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::catalogue::{self, Columns, Quantity};
use super::model::{Model, Slot};
use super::past::Past;
use super::session::{Role, Run, Session};
use crate::recording::Signal;

/// What the file calls its kind.
pub const KIND: &str = "discovered";
/// Version of the file.
pub const VERSION: u32 = 1;

/// One effect in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectEntry {
    /// Name from the vocabulary.
    pub name: String,
    /// Form of the effect.
    pub form: String,
    /// Non-linear parameters, normalised, in the order of the form.
    pub normalised: Vec<f64>,
    /// Weights of its columns, normalised.
    pub weights: Vec<f64>,
    /// The same in units, for people.
    pub parameters: BTreeMap<String, f64>,
    /// Limits between which each parameter lies with 95 % confidence.
    #[serde(default)]
    pub intervals: BTreeMap<String, [f64; 2]>,
}

/// Where the model came from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// Program and version.
    pub program: String,
    /// Recordings that were fitted or that selected, with the hash of their files.
    pub recordings: Vec<String>,
    /// RMSE on the samples that were kept out, output units.
    pub rmse: f64,
    /// RMSE there without the effects.
    pub rmse_before: f64,
}

/// The file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiscoveredModel {
    /// `discovered`.
    pub kind: String,
    /// Version of the file.
    pub version: u32,
    /// What goes in.
    pub input: Signal,
    /// What comes out.
    pub output: Signal,
    /// Time between samples, s.
    pub sample_period_s: f64,
    /// Input that is zero in normalised units.
    pub input_offset: f64,
    /// Input span that is one.
    pub input_scale: f64,
    /// Output span that is one.
    pub output_scale: f64,
    /// Length of the session that it was found in, s: session time goes on from there.
    pub session_s: f64,
    /// Number of recordings of that session.
    pub session_recordings: usize,
    /// Whether the operators are stops instead of plays.
    #[serde(default)]
    pub stops: bool,
    /// Turning points of the input that the operators remember from the session, normalised; empty when recordings begin fresh.
    #[serde(default)]
    pub memory: Vec<f64>,
    /// Thresholds of the operators, normalised.
    pub thresholds: Vec<f64>,
    /// Weights of the operators, normalised.
    pub weights: Vec<f64>,
    /// Constant, normalised.
    pub constant: f64,
    /// Where it came from.
    pub origin: Origin,
    /// Effects, in the order of the signal.
    #[serde(default)]
    pub effects: Vec<EffectEntry>,
}

/// What can be wrong with the file.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It cannot be read.
    #[error("{}: cannot be read ({problem}); check the path", path.display())]
    Open {
        /// Which file.
        path: PathBuf,
        /// Why.
        problem: String,
    },
    /// It makes no sense.
    #[error("{}: is no usable discovered model: {problem}; make it again with `catheter discover`", path.display())]
    Invalid {
        /// Which file.
        path: PathBuf,
        /// Why.
        problem: String,
    },
}

impl DiscoveredModel {
    /// Puts a fitted model into a file's terms.
    #[must_use]
    pub fn new(model: &Model, session: &Session, signals: (Signal, Signal), origin: Origin, effects: Vec<EffectEntry>) -> Self {
        Self {
            kind: KIND.to_owned(),
            version: VERSION,
            input: signals.0,
            output: signals.1,
            sample_period_s: session.runs[0].period_s,
            input_offset: session.input_offset,
            input_scale: session.input_scale,
            output_scale: session.output_scale,
            session_s: session.length_s,
            session_recordings: session.runs.len(),
            stops: model.stops,
            memory: if model.past.is_carried() { [model.past.before_the_session(), session.memory()].concat() } else { Vec::new() },
            thresholds: model.thresholds.clone(),
            weights: model.base[1..].to_vec(),
            constant: model.base[0],
            origin,
            effects,
        }
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// When it cannot be read or makes no sense.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let text = std::fs::read_to_string(path).map_err(|error| FileError::Open { path: path.into(), problem: error.to_string() })?;
        let invalid = |problem: String| FileError::Invalid { path: path.into(), problem };
        let model: Self = toml::from_str(&text).map_err(|error| invalid(error.to_string()))?;
        if model.kind != KIND || model.version != VERSION {
            return Err(invalid(format!("its kind is {:?}, version {}, expected {KIND:?}, version {VERSION}", model.kind, model.version)));
        }
        if model.thresholds.len() != model.weights.len() || model.thresholds.is_empty() {
            return Err(invalid(format!("{} thresholds but {} weights", model.thresholds.len(), model.weights.len())));
        }
        let numbers = [model.sample_period_s, model.input_scale, model.output_scale.abs()];
        if !numbers.iter().all(|value| value.is_finite() && *value > 0.0) {
            return Err(invalid("a scale or the sample period is not a positive number".to_owned()));
        }
        model.build().map_err(invalid)?;
        Ok(model)
    }

    /// The file's text.
    ///
    /// # Errors
    /// When a value cannot be written as TOML.
    pub fn encode(&self) -> Result<String, toml::ser::Error> {
        toml::to_string_pretty(self)
    }

    /// The model, ready to run.
    fn build(&self) -> Result<Model, String> {
        let forms = catalogue::forms();
        let mut slots = Vec::new();
        for entry in &self.effects {
            let form = forms
                .iter()
                .find(|form| form.name() == entry.name && form.form() == entry.form)
                .ok_or_else(|| format!("no effect {:?} of the form {:?} is known", entry.name, entry.form))?;
            if form.parameters().len() != entry.normalised.len() || form.weights() != entry.weights.len() {
                return Err(format!("the effect {:?} has another number of parameters or weights than its form", entry.name));
            }
            for (parameter, &value) in form.parameters().iter().zip(&entry.normalised) {
                if !(parameter.low..=parameter.high).contains(&value) {
                    return Err(format!(
                        "{} of {:?} is {value}, outside {} to {}",
                        parameter.name, entry.name, parameter.low, parameter.high
                    ));
                }
            }
            slots.push(Slot { form: *form, parameters: entry.normalised.clone(), weights: entry.weights.clone() });
        }
        let base = std::iter::once(self.constant).chain(self.weights.iter().copied()).collect();
        Ok(Model {
            thresholds: self.thresholds.clone(),
            past: if self.memory.is_empty() { Past::Fresh } else { Past::SESSION },
            stops: self.stops,
            slots,
            base,
            ease: Arc::default(),
            settled: false,
        })
    }

    /// The effects of the file in the normalised units of another session.
    ///
    /// # Errors
    /// When an effect of the file is not known.
    pub fn slots_in(&self, session: &Session) -> Result<Vec<Slot>, String> {
        let input = self.input_scale / session.input_scale;
        let output = (self.output_scale / session.output_scale).abs();
        let mut slots = self.build()?.slots;
        for slot in &mut slots {
            for (value, parameter) in slot.parameters.iter_mut().zip(slot.form.parameters()) {
                let factor = match parameter.quantity {
                    Quantity::Input | Quantity::InputRate => input,
                    Quantity::Output | Quantity::OutputRate => output,
                    Quantity::PerInput => 1.0 / input,
                    Quantity::Time | Quantity::Frequency | Quantity::Ratio => 1.0,
                };
                *value = (*value * factor).clamp(parameter.low, parameter.high);
            }
        }
        Ok(slots)
    }

    /// Output for every input sample, from rest, in the units of the file.
    ///
    /// # Errors
    /// When an effect of the file is not known.
    pub fn simulate(&self, input: &[f64]) -> Result<Vec<f64>, String> {
        if input.is_empty() {
            return Ok(Vec::new());
        }
        Ok(self.build()?.predict(&self.run(input)).into_iter().map(|value| value * self.output_scale).collect())
    }

    /// A recording with this input after the session's last.
    fn run(&self, input: &[f64]) -> Run {
        let time_s: Vec<f64> = (0..input.len()).map(|sample| sample as f64 * self.sample_period_s).collect();
        Run {
            name: String::new(),
            index: self.session_recordings,
            source: (0, 0),
            period_s: self.sample_period_s,
            input: input.iter().map(|value| (value - self.input_offset) / self.input_scale).collect(),
            output: vec![0.0; input.len()],
            session_s: time_s.iter().map(|time| time + self.session_s).collect(),
            time_s,
            role: vec![Role::Kept; input.len()],
            screens: false,
            keep: vec![true; input.len()],
            rest: Vec::new(),
            history: self.memory.clone(),
            session: std::sync::Arc::default(),
        }
    }

    /// What an effect of the sensor does to the model's output where the session ended: gain, and offset (normalised).
    ///
    /// # Errors
    /// When the effect is not known.
    pub fn at_the_end(&self, effect: &EffectEntry) -> Result<(f64, f64), String> {
        let model = self.build()?;
        let slot = model.slots.iter().find(|slot| slot.form.name() == effect.name).ok_or_else(|| effect.name.clone())?;
        let run = Run { session_s: vec![self.session_s], ..self.run(&[self.input_offset]) };
        let of = |sum: f64| {
            let mut columns = Columns::of(1);
            slot.form.output(&slot.parameters, &run, &[sum], &mut columns);
            sum + columns.added().values.iter().zip(&slot.weights).map(|(value, weight)| value * weight).sum::<f64>()
        };
        Ok((of(1.0) - of(0.0), of(0.0)))
    }

    /// Numbers that were fitted.
    #[must_use]
    pub fn parameters(&self) -> usize {
        let effects: usize = self.effects.iter().map(|effect| effect.normalised.len() + effect.weights.len()).sum();
        self.weights.len() + 1 + effects
    }
}
