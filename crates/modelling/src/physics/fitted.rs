//! The file of a fitted physics model: what `catheter fit` writes where no other format holds what was found.
//!
//! A member is a weighted sum of columns (see [`identification`]); the model's output is the mean of its members, weighted with their
//! shares. TOML, versioned, with units and provenance; everything that the simulation uses is in it.

use std::path::{Path, PathBuf};

use identification::LinearModel;
use serde::{Deserialize, Serialize};

use super::expected::{Calibrated, Expected};
use super::model::{ChannelRange, Source};
use super::nuisance::Nuisance;

/// The file's `kind`.
pub const KIND: &str = "fitted";
/// Version of the file's layout.
pub const FORMAT_VERSION: u32 = 2;

/// A part of the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Member {
    /// Name of the rung.
    pub name: String,
    /// Its share of the output.
    pub share: f64,
    /// The sum.
    #[serde(flatten)]
    pub model: LinearModel,
}

/// A fitted model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FittedModel {
    /// [`KIND`].
    pub kind: String,
    /// [`FORMAT_VERSION`].
    pub format_version: u32,
    /// Name of the rung it is.
    pub name: String,
    /// Program and version that made it.
    pub program: String,
    /// Time between samples in s.
    pub sample_period_s: f64,
    /// Inputs, in order.
    pub inputs: Vec<ChannelRange>,
    /// The output.
    pub output: ChannelRange,
    /// What the next recording may bring.
    pub expected: Expected,
    /// Files that it was fitted to.
    pub data: Vec<Source>,
    /// What moved the output of those recordings and is no part of the simulation.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub nuisances: Vec<Nuisance>,
    /// Parts, whose weighted mean is the output.
    pub members: Vec<Member>,
}

/// Why a fitted model is refused.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what each field is")]
pub enum FileError {
    /// The file cannot be read.
    #[error("{}: cannot be read ({problem}); check the path", path.display())]
    Open { path: PathBuf, problem: String },
    /// A part of the model is out of its domain.
    #[error("{}: cannot be run: {problem}; fit the model again", path.display())]
    Invalid { path: PathBuf, problem: String },
}

impl FittedModel {
    /// Reads and checks a model file.
    ///
    /// # Errors
    /// When it cannot be read, is of another version, or contradicts itself.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let text = output::read_text(path).map_err(|error| FileError::Open { path: path.into(), problem: error.to_string() })?;
        let invalid = |problem: String| FileError::Invalid { path: path.into(), problem };
        let model: Self = toml::from_str(&text).map_err(|error| invalid(error.message().to_owned()))?;
        match model.problem() {
            Some(problem) => Err(invalid(problem)),
            None => Ok(model),
        }
    }

    /// What contradicts itself, if anything.
    fn problem(&self) -> Option<String> {
        if self.format_version != FORMAT_VERSION {
            return Some(format!("it has format_version {}, this program reads {FORMAT_VERSION}", self.format_version));
        }
        if self.members.is_empty() {
            return Some("it has no members".to_owned());
        }
        let sum: f64 = self.members.iter().map(|member| member.share).sum();
        if self.members.iter().any(|member| !(0.0..=1.0).contains(&member.share)) || (sum - 1.0).abs() > 1e-9 {
            return Some("the members' shares must lie between 0 and 1 and add up to 1".to_owned());
        }
        let range = |one: &ChannelRange| one.minimum <= one.maximum && (one.maximum - one.minimum).is_finite();
        if self.inputs.is_empty() || !self.inputs.iter().chain([&self.output]).all(range) {
            return Some("an input or the output has no range of two ascending numbers".to_owned());
        }
        let promise = |rmse: f64, [low, high]: [f64; 2]| rmse >= 0.0 && low >= 0.0 && low <= high;
        let expected = &self.expected;
        let calibrated = |one: &Calibrated| promise(one.rmse, one.interval) && one.calibrate_s > 0.0 && one.calibrate_s.is_finite();
        if !promise(expected.rmse, expected.interval) || !expected.calibrated.as_ref().is_none_or(calibrated) {
            return Some("the error that it promises is not a number with an interval".to_owned());
        }
        if self.nuisances.iter().any(|one| !(one.mean.is_finite() && one.values.iter().all(|value| value.value.is_finite()))) {
            return Some("a nuisance has a value that is not finite".to_owned());
        }
        for member in &self.members {
            if let Err(fault) = member.model.check() {
                return Some(format!("member `{}`: {fault}", member.name));
            }
            if member.model.inputs() != self.inputs.len() || member.model.structure.sample_period_s != self.sample_period_s {
                return Some(format!("member `{}` has other inputs or another sample period than the model", member.name));
            }
        }
        None
    }

    /// Writes the file, atomically.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        output::write_atomic(path, toml::to_string(self)?.as_bytes())
    }

    /// The output for inputs of one length, free running from the equilibrium of the first sample of each stretch between `gaps`.
    #[must_use]
    pub fn simulate(&self, inputs: &[&[f64]], gaps: &[usize]) -> Vec<f64> {
        let mut sum = vec![0.0; inputs.first().map_or(0, |input| input.len())];
        for member in &self.members {
            let one = member.model.simulate(inputs, gaps);
            sum.iter_mut().zip(one).for_each(|(sum, value)| *sum += member.share * value);
        }
        sum
    }
}
