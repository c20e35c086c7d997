//! A discovered model as TOML: the operators, the effects with their parameters in the lab's units, and where it all came from.
//!
//! The file holds normalised values, which the model runs on, and beside them the same parameters in units, for people. It also holds the
//! session's recordings with their start and with what the operators knew there, so that a simulation of one of them, or of another that
//! tells its place in the session, follows what goes with the session's time (drift, change of set-up, rhythm). Without a place a recording
//! comes after the session's end: that is the rig as it is now. What a recording has of its own (a zero, a gain, a phase) is read from a
//! start-up stretch of its measured output, where one is given; without one, zero and gain are the session's mean.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use recording::simulation::{self, Context};
use recording::{Recording, Signal};
use serde::{Deserialize, Serialize};

use crate::chain::definition::Definition;
use crate::chain::form::Quantity;
use crate::data::session::{Beginning, Earlier, OtherInput, Role, Run, Session};
use crate::effects::{catalogue, creep, earlier, other_input};
use crate::model::initial_state::InitialState;
use crate::model::structure::{Model, Slot};

/// What the file calls its kind.
pub const KIND: &str = "discovered";

/// Version of the file; one such file is kept for the fuzz targets, `fuzz/files/discovered.toml`, and changes with it.
pub const VERSION: u32 = 6;

/// One effect in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectEntry {
    /// Name from the vocabulary.
    pub name: String,
    /// Key of the effect's form.
    pub form: String,
    /// What it does, where it comes from a file of effects.
    #[serde(default)]
    pub definition: Option<Definition>,
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

/// A recording of the session in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaceEntry {
    /// Name of the recording's file.
    pub name: String,
    /// SHA-256 of that file; empty where it never was one.
    #[serde(default)]
    pub sha256: String,
    /// Which stretch between gaps of the recording.
    #[serde(default)]
    pub part: usize,
    /// When it began, s after the session did.
    pub start_s: f64,
    /// Turning points of the input, as the operators see it, that they remember when it begins, normalised.
    #[serde(default)]
    pub memory: Vec<f64>,
    /// States of the operators when it begins, where these hang on how fast they went, normalised.
    #[serde(default)]
    pub states: Vec<f64>,
    /// What the recordings before left in the material.
    #[serde(default)]
    pub earlier: Option<Earlier>,
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
    /// Further inputs.
    #[serde(default)]
    pub others: Vec<OtherInput>,
    /// Output span that is one.
    pub output_scale: f64,
    /// Length of the session that it was found in, s: session time goes on from there.
    pub session_s: f64,
    /// Number of recordings of that session.
    pub session_recordings: usize,
    /// Time on the session's own clock at which its first recording began, s; absent where the recordings have no such clock.
    #[serde(default)]
    pub session_origin_s: Option<f64>,
    /// Start-up stretch of measured output from which is read what a recording has of its own, s; absent when nothing is.
    #[serde(default)]
    pub calibrate_s: Option<f64>,
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
    /// The session's recordings, in order.
    #[serde(default)]
    pub session: Vec<PlaceEntry>,
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
            others: session.others.clone(),
            output_scale: session.output_scale,
            session_s: session.length_s,
            session_recordings: session.runs.len(),
            session_origin_s: session.has_session_time.then_some(session.origin_s),
            calibrate_s: calibration_s(model, session),
            stops: model.stops,
            memory: if model.initial_state.is_carried() {
                [model.initial_state.before_the_session(), session.memory()].concat()
            } else {
                Vec::new()
            },
            thresholds: model.thresholds.clone(),
            weights: model.base[1..].to_vec(),
            constant: model.base[0],
            origin,
            effects,
            session: places(model, session),
        }
    }

    /// A fitted model in a file's terms, with nothing beside it that is for people.
    #[must_use]
    pub fn bare(model: &Model, session: &Session, recording: &Recording) -> Self {
        let effects = model.slots.iter().map(|slot| EffectEntry {
            name: slot.form.name().to_owned(),
            form: slot.form.key().to_owned(),
            definition: slot.form.definition().cloned(),
            normalised: slot.parameters.clone(),
            weights: slot.weights.clone(),
            parameters: BTreeMap::new(),
            intervals: BTreeMap::new(),
        });
        let origin = Origin { program: String::new(), recordings: Vec::new(), rmse: 0.0, rmse_before: 0.0 };
        let signals = (recording.input_signal.clone(), recording.output_signal.clone());
        Self::new(model, session, signals, origin, effects.collect())
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// When it cannot be read or makes no sense.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let text = output::read_text(path).map_err(|error| FileError::Open { path: path.into(), problem: error.to_string() })?;
        let invalid = |problem: String| FileError::Invalid { path: path.into(), problem };
        let model: Self = toml::from_str(&text).map_err(|error| invalid(error.to_string()))?;
        if model.kind != KIND || model.version != VERSION {
            let (kind, version) = (model.kind, model.version);
            let problem =
                format!("its kind is {kind:?}, version {version}, expected {KIND:?}, version {VERSION}: find it again with discover");
            return Err(invalid(problem));
        }
        if model.thresholds.len() != model.weights.len() || model.thresholds.is_empty() {
            return Err(invalid(format!("{} thresholds but {} weights", model.thresholds.len(), model.weights.len())));
        }
        let numbers = [model.sample_period_s, model.input_scale, model.output_scale.abs()];
        if !numbers.iter().all(|value| value.is_finite() && *value > 0.0) {
            return Err(invalid("a scale or the sample period is not a positive number".to_owned()));
        }
        if model.session.iter().any(|place| !place.states.is_empty() && place.states.len() != model.thresholds.len()) {
            return Err(invalid("a recording of the session has another number of states than there are operators".to_owned()));
        }
        let own = model.effects.iter().filter(|effect| effect.name == other_input::NAME).count();
        if own != model.others.len() || model.others.iter().any(|other| !(other.scale > 0.0 && other.scale.is_finite())) {
            return Err(invalid(format!("it has {} further inputs, and operators of {own}, or one without a span", model.others.len())));
        }
        let times = 2 * creep::TIMES_S.len();
        if model.session.iter().filter_map(|place| place.earlier.as_ref()).any(|earlier| earlier.creeping.len() != times) {
            return Err(invalid(format!("what earlier recordings left creeping takes {times} numbers")));
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
    pub(super) fn build(&self) -> Result<Model, String> {
        let forms = [&catalogue::forms()[..], &other_input::FORMS].concat();
        let mut slots = Vec::new();
        for entry in &self.effects {
            let form = match &entry.definition {
                Some(definition) => definition.form().map_err(|error| error.to_string())?,
                None => *forms
                    .iter()
                    .find(|form| form.name() == entry.name && form.key() == entry.form)
                    .ok_or_else(|| format!("no effect {:?} of the form {:?} is known", entry.name, entry.form))?,
            };
            if form.parameters().len() != entry.normalised.len() || form.spec().weights != entry.weights.len() {
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
            slots.push(Slot { form, parameters: entry.normalised.clone(), weights: entry.weights.clone() });
        }
        let base = std::iter::once(self.constant).chain(self.weights.iter().copied()).collect();
        Ok(Model {
            thresholds: self.thresholds.clone(),
            initial_state: if self.memory.is_empty() { InitialState::Fresh } else { InitialState::SESSION },
            stops: self.stops,
            slots,
            base,
            sensitivities: Arc::default(),
            fixed_weights: false,
        })
    }

    /// The effects of the file in the normalised units of another session.
    ///
    /// # Errors
    /// When an effect of the file is not known, or it has further inputs that the session has not.
    pub fn slots_in(&self, session: &Session) -> Result<Vec<Slot>, String> {
        if self.others.len() > session.others.len() {
            return Err(format!("it has {} inputs, the recordings have {}", self.others.len() + 1, session.others.len() + 1));
        }
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
    /// When an effect of the file is not known, or it has further inputs.
    pub fn simulate(&self, input: &[f64]) -> Result<Vec<f64>, String> {
        if input.is_empty() {
            return Ok(Vec::new());
        }
        Ok(self.build()?.predict(&self.run(&[input])?).into_iter().map(|value| value * self.output_scale).collect())
    }

    /// Output for every sample of a stretch between gaps, free running in its place in the session, in the units of the file.
    ///
    /// # Errors
    /// When an effect of the file is not known, or an input is missing.
    pub fn simulate_in(&self, context: &Context<'_>, part: usize, stretch: Range<usize>, inputs: &[&[f64]]) -> Result<Vec<f64>, String> {
        if inputs[0].is_empty() {
            return Ok(Vec::new());
        }
        let mut run = self.run(inputs)?;
        let measured = context.start_up(stretch.clone(), self.sample_period_s);
        for (value, measured) in run.output.iter_mut().zip(measured) {
            *value = measured / self.output_scale;
        }
        run.keep.iter_mut().enumerate().for_each(|(sample, keep)| *keep = measured.is_empty() || sample < measured.len());
        let own = |place: &&PlaceEntry| place.sha256 == context.sha256 && (!context.sha256.is_empty() || place.name == context.name);
        let known = self.session.iter().position(|place| own(&place) && place.part == part);
        let clock = context.session_time_s.zip(self.session_origin_s);
        if let Some((times_s, origin_s)) = clock {
            run.session_s = times_s[stretch].iter().map(|time_s| time_s - origin_s).collect();
        } else if let Some(place) = known {
            run.session_s = run.time_s.iter().map(|time_s| time_s + self.session[place].start_s).collect();
        }
        let later = self.session.iter().take_while(|place| place.start_s <= run.session_s[0]).count();
        let begins = known.unwrap_or(later);
        // Between two of the session's recordings the set-up is that of the earlier one.
        run.index = known.unwrap_or(if later < self.session.len() { later.saturating_sub(1) } else { self.session_recordings });
        run.earlier = self.session.get(begins).and_then(|place| place.earlier.clone());
        run.beginning = self.session.get(begins).map(|place| match place.states.is_empty() {
            true => Beginning::After(place.memory.clone()),
            false => Beginning::From(place.states.clone()),
        });
        Ok(self.build()?.predict(&run).into_iter().map(|value| value * self.output_scale).collect())
    }

    /// Output for every sample of a recording in its place in the session, in the units of the file: free running behind a start-up stretch of
    /// so many seconds at the start of each stretch between gaps.
    ///
    /// # Errors
    /// When an effect of the file is not known.
    pub fn simulate_recording(&self, recording: &Recording, start_up_s: f64) -> Result<Vec<f64>, String> {
        let simulate = |context: &Context<'_>, inputs: &[&[f64]], gaps: &[usize]| self.simulate_stretches(context, inputs, gaps);
        let (period_s, gaps) = (self.sample_period_s, &recording.gaps[..]);
        // Operators alone know no time.
        let on_clock = simulation::differs(period_s, recording.sample_period_s) || !simulation::is_even(recording);
        if !self.effects.is_empty() && on_clock {
            return simulation::on_even_clock(recording, gaps, period_s, start_up_s, simulate);
        }
        simulate(&Context::of(recording, start_up_s), &recording.inputs(), gaps)
    }

    /// Output for every sample of an input with gaps, free running in its place in the session, in the units of the file.
    ///
    /// # Errors
    /// When an effect of the file is not known, or an input is missing.
    pub fn simulate_stretches(&self, context: &Context<'_>, inputs: &[&[f64]], gaps: &[usize]) -> Result<Vec<f64>, String> {
        let length = inputs[0].len();
        let mut output = Vec::with_capacity(length);
        let bounds: Vec<usize> = std::iter::once(0).chain(gaps.iter().copied()).chain(std::iter::once(length)).collect();
        for (part, bound) in bounds.windows(2).enumerate() {
            let stretch: Vec<&[f64]> = inputs.iter().map(|input| &input[bound[0]..bound[1]]).collect();
            output.extend(self.simulate_in(context, part, bound[0]..bound[1], &stretch)?);
        }
        Ok(output)
    }

    /// A recording with these inputs after the session's last.
    pub(super) fn run(&self, inputs: &[&[f64]]) -> Result<Run, String> {
        let (input, further) = (inputs[0], &inputs[1..]);
        if further.len() < self.others.len() {
            return Err(format!("it has {} inputs and was given {}", self.others.len() + 1, inputs.len()));
        }
        let time_s: Vec<f64> = (0..input.len()).map(|sample| sample as f64 * self.sample_period_s).collect();
        Ok(Run {
            name: String::new(),
            file: String::new(),
            index: self.session_recordings,
            source: (0, 0),
            sha256: String::new(),
            part: 0,
            period_s: self.sample_period_s,
            input: input.iter().map(|value| (value - self.input_offset) / self.input_scale).collect(),
            others: self.others.iter().zip(further).map(|(other, values)| other.normalised(values)).collect(),
            output: vec![0.0; input.len()],
            session_s: time_s.iter().map(|time| time + self.session_s).collect(),
            time_s,
            role: vec![Role::Test; input.len()],
            screens: false,
            keep: vec![true; input.len()],
            rest: Vec::new(),
            history: self.memory.clone(),
            beginning: None,
            earlier: None,
            session: std::sync::Arc::default(),
        })
    }

    /// Numbers that were fitted.
    #[must_use]
    pub fn parameters(&self) -> usize {
        let effects: usize = self.effects.iter().map(|effect| effect.normalised.len() + effect.weights.len()).sum();
        self.weights.len() + 1 + effects
    }
}

/// Recordings of the session, with what the operators know when each begins.
fn places(model: &Model, session: &Session) -> Vec<PlaceEntry> {
    let of = |(run, beginning): (&Run, Beginning)| {
        let (memory, states) = match beginning {
            Beginning::After(memory) => (memory, Vec::new()),
            Beginning::From(states) => (Vec::new(), states),
        };
        PlaceEntry {
            name: run.file.clone(),
            sha256: run.sha256.clone(),
            part: run.part,
            start_s: run.session_s[0],
            memory,
            states,
            earlier: Some(earlier::earlier(run)),
        }
    };
    session.runs.iter().zip(model.beginnings(session)).map(of).collect()
}

/// Longest share of the shortest recording that serves as a start-up stretch.
const LONGEST_START_UP: f64 = 0.25;

/// The start-up stretch that a model states, s: what its effects ask for, and no more than a quarter of the shortest recording.
fn calibration_s(model: &Model, session: &Session) -> Option<f64> {
    let wanted_s = model.start_up_s();
    let length_s = |run: &Run| run.input.len() as f64 * run.period_s;
    let most_s = LONGEST_START_UP * session.runs.iter().map(length_s).fold(f64::MAX, f64::min);
    (wanted_s > 0.0).then(|| wanted_s.min(most_s))
}

#[cfg(test)]
mod tests;
