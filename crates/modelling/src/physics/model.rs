//! The identified physics model and its TOML file: quantities with units, confidence intervals, and where it came from.

use std::path::{Path, PathBuf};

use hysteresis::play;
use model_export::schema::{self, Channel, FrontEnd, MAX_BENDS, MAX_CREEP, MAX_DEAD_TIME_SAMPLES, MAX_PLAY};
use serde::{Deserialize, Serialize};

use super::expected::Expected;
use super::input_path::{coefficient, input_path};
use super::nuisance::Nuisance;
use super::stages::Stages;
use recording::{Recording, Signal};

/// Version of the file's layout.
pub const FORMAT_VERSION: u32 = 1;

/// What kind of model a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Eq. (3): a weighted sum of play operators.
    PrandtlIshlinskii,
    /// The sum bent by a piecewise straight curve (dead-zone superposition): asymmetry and saturation.
    ModifiedPrandtlIshlinskii,
}

/// Input or output: what it is and where the data lay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelRange {
    /// Quantity, for example `pressure`.
    pub quantity: String,
    /// Unit, for example `bar`.
    pub unit: String,
    /// Smallest value in the data.
    pub minimum: f64,
    /// Largest value in the data.
    pub maximum: f64,
}

impl ChannelRange {
    /// Quantity and unit.
    #[must_use]
    pub fn signal(&self) -> Signal {
        Signal { quantity: self.quantity.clone(), unit: self.unit.clone() }
    }
}

/// Dead time and lag between the recorded input and the operators.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputPath {
    /// Dead time in s.
    #[serde(default)]
    pub dead_time_s: f64,
    /// Time constant of the first-order lag in s; 0 is none.
    #[serde(default)]
    pub lag_time_constant_s: f64,
}

/// The curve of the modified model, piecewise straight: slope `slopes[i]` between `breakpoints[i]` and `breakpoints[i + 1]`, the end
/// slopes continuing outside. `breakpoints[0]` maps to the model's constant. In the output's unit and dimensionless.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Curve {
    /// Ascending, one more than slopes.
    pub breakpoints: Vec<f64>,
    /// Not negative.
    pub slopes: Vec<f64>,
}

impl Curve {
    /// The value at `sum`, zero at the first breakpoint.
    #[must_use]
    pub fn at(&self, sum: f64) -> f64 {
        (0..self.slopes.len()).map(|index| self.slopes[index] * self.part(index, sum)).sum()
    }

    /// The same curve as the blob's superposition of dead zones, behind `constant`, in an output that has `offset` taken off and is
    /// divided by `scale`, for a sum divided by `scale`. `None` when it has more bends than the blob holds.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
    pub fn dead_zones(&self, constant: f64, offset: f64, scale: f64) -> Option<schema::Curve> {
        let (first, slope) = (*self.breakpoints.first()?, *self.slopes.first()?);
        let mut curve =
            schema::Curve { offset: ((constant - offset - slope * first) / scale) as f32, slope: slope as f32, ..schema::Curve::default() };
        for (point, pair) in self.breakpoints.iter().skip(1).zip(self.slopes.windows(2)) {
            if pair[1] != pair[0] {
                curve.bend_points.push((point / scale) as f32).ok()?;
                curve.bends.push((pair[1] - pair[0]) as f32).ok()?;
            }
        }
        Some(curve)
    }

    /// How much of segment `index` lies below `sum`.
    pub(crate) fn part(&self, index: usize, sum: f64) -> f64 {
        let last = self.slopes.len() - 1;
        let (low, high) = (self.breakpoints[index], self.breakpoints[index + 1]);
        let reach = if index == last { sum } else { sum.min(high) };
        if index == 0 { reach - low } else { (reach - low).max(0.0) }
    }

    /// The slope at `sum`.
    pub(crate) fn slope_at(&self, sum: f64) -> f64 {
        let inner = &self.breakpoints[1..self.slopes.len()];
        self.slopes[inner.iter().filter(|&&breakpoint| sum > breakpoint).count()]
    }
}

/// Creep of the operators' sum: `s + sum_j gain_j C_j`, each `C_j` following `s` with its time constant.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CreepFilters {
    /// Time constants in s.
    pub time_constants_s: Vec<f64>,
    /// Gains, dimensionless.
    pub gains: Vec<f64>,
}

/// One file that the model was fitted to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// Its name.
    pub file: String,
    /// SHA-256 of its bytes.
    pub sha256: String,
    /// Samples in it.
    pub samples: usize,
}

/// How the model came to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Program and version.
    pub program: String,
    /// How it was fitted, in words.
    pub method: String,
    /// Root mean square error over the fitted samples, in the output's unit.
    pub rmse: f64,
    /// The same as a share of the output's range.
    pub nrmse: f64,
    /// Samples fitted.
    pub samples: usize,
    /// The data.
    pub data: Vec<Source>,
}

/// An identified model; everything in the units of its channels.
///
/// With `u` the input, `v` the input path's output less the rest input and `H` the play operators of eq. (2):
///
/// ```text
/// s = input_gain v + sum_i weights_i H_i(v) + creep        y = constant + s          (Prandtl-Ishlinskii)
///                                                          y = constant + curve(s)   (modified)
/// ```
///
/// Where there are [`Stages`], they lie between the input path and the operators, change the operators, and send `y` through the tip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhysicsModel {
    /// Layout of the file, [`FORMAT_VERSION`].
    pub format_version: u32,
    /// What kind of model.
    pub kind: Kind,
    /// Sample period of the data in s; dead time, lag and creep are in seconds and do not depend on it.
    pub sample_period_s: f64,
    /// The input's value at which the play operators start, as if the actuator had always rested there.
    pub rest_input: f64,
    /// Thresholds of the play operators in the input's unit, ascending.
    pub thresholds: Vec<f64>,
    /// Their weights in the output's unit per input unit. Negative for a model of stop operators.
    pub weights: Vec<f64>,
    /// Weight of the input itself.
    #[serde(default)]
    pub input_gain: f64,
    /// Output at rest, in the output's unit.
    pub constant: f64,
    /// 95 % confidence intervals of the thresholds; empty when they were given, not fitted.
    #[serde(default)]
    pub thresholds_95: Vec<[f64; 2]>,
    /// 95 % confidence intervals of the weights.
    #[serde(default)]
    pub weights_95: Vec<[f64; 2]>,
    /// 95 % confidence interval of the constant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub constant_95: Option<[f64; 2]>,
    /// The input.
    pub input: ChannelRange,
    /// The output.
    pub output: ChannelRange,
    /// Dead time and lag.
    #[serde(default)]
    pub input_path: InputPath,
    /// The curve of the modified model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub curve: Option<Curve>,
    /// Creep.
    #[serde(default)]
    pub creep: CreepFilters,
    /// What supply, valve, line, muscle and tip do beside hysteresis.
    #[serde(default, skip_serializing_if = "Stages::is_empty")]
    pub stages: Stages,
    /// How it came to be.
    pub provenance: Provenance,
    /// What the next recording may bring; only `catheter fit` knows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected: Option<Expected>,
    /// What moved the output of the recordings and is no part of the model; only `catheter fit` names it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub nuisances: Vec<Nuisance>,
}

/// Why a model cannot be read, written or converted.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what each field is")]
pub enum ModelError {
    /// The file cannot be read.
    #[error("{}: cannot be read ({source}); check the path", path.display())]
    Open { path: PathBuf, source: std::io::Error },
    /// The file is not a physics model.
    #[error("{}: is no valid physics model: {problem}", path.display())]
    Syntax { path: PathBuf, problem: String },
    /// The file has a layout of another version.
    #[error("{}: has format_version {found}, this program reads {FORMAT_VERSION}; identify again or use the matching version", path.display())]
    Version { path: PathBuf, found: i64 },
    /// Values that contradict each other.
    #[error("{}: {problem}; identify again", path.display())]
    Value { path: PathBuf, problem: String },
    /// The model does not fit the microcontroller's front end.
    #[error("the model has no front-end form: {problem}")]
    NotRepresentable { problem: String },
    /// Writing failed.
    #[error("{}: cannot be written ({problem})", path.display())]
    Write { path: PathBuf, problem: String },
}

impl PhysicsModel {
    /// Reads a model file.
    ///
    /// # Errors
    /// When it cannot be read, has another version, or contradicts itself.
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        let text = output::read_text(path).map_err(|source| ModelError::Open { path: path.into(), source })?;
        let syntax = |error: toml::de::Error| ModelError::Syntax { path: path.into(), problem: error.to_string() };
        // The version first: another layout would only give a confusing message about some field.
        let table: toml::Table = toml::from_str(&text).map_err(syntax)?;
        if let Some(found) = table.get("format_version").and_then(toml::Value::as_integer)
            && found != i64::from(FORMAT_VERSION)
        {
            return Err(ModelError::Version { path: path.into(), found });
        }
        let model: Self = toml::from_str(&text).map_err(syntax)?;
        match model.problem() {
            Some(problem) => Err(ModelError::Value { path: path.into(), problem }),
            None => Ok(model),
        }
    }

    /// Writes the model file, atomically.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), ModelError> {
        let write = |problem: String| ModelError::Write { path: path.into(), problem };
        if let Some(problem) = self.problem() {
            return Err(ModelError::Value { path: path.into(), problem });
        }
        let text = toml::to_string(self).map_err(|error| write(error.to_string()))?;
        output::write_atomic(path, text.as_bytes()).map_err(|error| write(format!("{error:#}")))
    }

    /// What contradicts itself in the values, if anything.
    fn problem(&self) -> Option<String> {
        let lists: [&[f64]; 4] = [&self.thresholds, &self.weights, &self.creep.time_constants_s, &self.creep.gains];
        let single = [self.sample_period_s, self.rest_input, self.input_gain, self.constant];
        let path = [self.input_path.dead_time_s, self.input_path.lag_time_constant_s];
        if lists.iter().flat_map(|list| list.iter()).chain(&single).chain(&path).any(|value| !value.is_finite()) {
            return Some("a value is not finite".to_owned());
        }
        if self.thresholds.len() != self.weights.len() {
            return Some(format!("{} thresholds but {} weights", self.thresholds.len(), self.weights.len()));
        }
        if self.thresholds.iter().any(|&threshold| threshold < 0.0) || self.thresholds.windows(2).any(|pair| pair[1] < pair[0]) {
            return Some("the thresholds are not ascending from zero".to_owned());
        }
        if self.sample_period_s <= 0.0 || path.iter().any(|&time| time < 0.0) {
            return Some("sample_period_s must be positive, dead_time_s and lag_time_constant_s not negative".to_owned());
        }
        if self.creep.gains.len() != self.creep.time_constants_s.len() || self.creep.time_constants_s.iter().any(|&time| time <= 0.0) {
            return Some("creep needs one gain for each positive time constant".to_owned());
        }
        if let Some(problem) = self.stages.problem() {
            return Some(problem);
        }
        match &self.curve {
            Some(curve) => {
                let shaped = !curve.slopes.is_empty() && curve.breakpoints.len() == curve.slopes.len() + 1;
                let ascending = curve.breakpoints.windows(2).all(|pair| pair[0] < pair[1]);
                let finite = curve.breakpoints.iter().chain(&curve.slopes).all(|value| value.is_finite());
                (!(shaped && ascending && finite)).then(|| "the curve needs ascending breakpoints, one more than slopes".to_owned())
            }
            None => (self.kind == Kind::ModifiedPrandtlIshlinskii).then(|| "a modified model needs a curve".to_owned()),
        }
    }

    /// The output for an input, free running from the start; one value a sample, at the model's sample period.
    #[must_use]
    pub fn simulate(&self, input: &[f64]) -> Vec<f64> {
        let sums = self.sums(input);
        let readout: Vec<f64> = match &self.curve {
            Some(curve) => sums.into_iter().map(|sum| self.constant + curve.at(sum)).collect(),
            None => sums.into_iter().map(|sum| self.constant + sum).collect(),
        };
        match &self.stages.tip {
            Some(tip) => tip.run(&readout),
            None => readout,
        }
    }

    /// The operators' weighted sum with creep, before constant and curve.
    #[must_use]
    pub fn sums(&self, input: &[f64]) -> Vec<f64> {
        let path = input_path(input, self.input_path.dead_time_s / self.sample_period_s, self.lag_coefficient());
        let path: Vec<f64> = path.into_iter().map(|value| value - self.rest_input).collect();
        let path = self.stages.lead(&path);
        let creep: Vec<f64> = self.creep.time_constants_s.iter().map(|time| coefficient(self.sample_period_s, *time)).collect();
        let mut elements: Option<Vec<f64>> = None;
        path.iter()
            .zip(self.weighted_plays(&path))
            .map(|(value, plays)| {
                let sum = self.input_gain * value + plays;
                let elements = elements.get_or_insert_with(|| vec![sum; creep.len()]);
                elements.iter_mut().zip(&creep).for_each(|(element, coefficient)| *element += coefficient * (sum - *element));
                sum + self.creep.gains.iter().zip(elements.iter()).map(|(gain, element)| gain * element).sum::<f64>()
            })
            .collect()
    }

    /// The operators' weighted sum along a path from the rest input.
    fn weighted_plays(&self, path: &[f64]) -> Vec<f64> {
        if let Some(growth) = &self.stages.growth {
            let operators: Vec<(f64, f64)> = self.thresholds.iter().copied().zip(self.weights.iter().copied()).collect();
            return growth.sums(path, &operators, self.sample_period_s);
        }
        let mut plays = vec![0.0; self.thresholds.len()];
        let sum = |value: &f64| {
            play::step_bank(&self.thresholds, *value, &mut plays);
            self.weights.iter().zip(&plays).map(|(weight, play)| weight * play).sum()
        };
        path.iter().map(sum).collect()
    }

    /// Simulates a recording's input and returns root mean square error, its share of the output's range, and the largest error.
    #[must_use]
    pub fn errors(&self, recording: &Recording) -> (f64, f64, f64) {
        let simulated = self.simulate(&recording.input);
        let squares: f64 = simulated.iter().zip(&recording.output).map(|(a, b)| (a - b).powi(2)).sum();
        let rmse = (squares / recording.len().max(1) as f64).sqrt();
        let largest = simulated.iter().zip(&recording.output).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let (low, high) = range(&recording.output);
        (rmse, rmse / (high - low), largest)
    }

    fn lag_coefficient(&self) -> f64 {
        coefficient(self.sample_period_s, self.input_path.lag_time_constant_s)
    }

    /// Input channel, output channel and front end for the microcontroller, in normalised units: the input's offset is the rest input
    /// and its scale the farthest excursion from it, the output's offset and scale are the middle and half of its range.
    ///
    /// # Errors
    /// When the model has more operators, creep filters or bends of its curve than the blob holds, or too long a dead time.
    pub fn front_end(&self) -> Result<(Channel<'_>, Channel<'_>, FrontEnd), ModelError> {
        let refuse = |problem: String| ModelError::NotRepresentable { problem };
        let dead_time_samples = self.input_path.dead_time_s / self.sample_period_s;
        if dead_time_samples > MAX_DEAD_TIME_SAMPLES as f64 {
            return Err(refuse(format!("a dead time of {dead_time_samples:.1} samples, at most {MAX_DEAD_TIME_SAMPLES} fit")));
        }
        let positive = |value: f64| if value > 0.0 { value } else { 1.0 };
        let input_scale = positive((self.input.maximum - self.rest_input).abs().max((self.input.minimum - self.rest_input).abs()));
        let output_offset = 0.5 * (self.output.maximum + self.output.minimum);
        let output_scale = positive(0.5 * (self.output.maximum - self.output.minimum));
        let gain = input_scale / output_scale;
        let mut front_end =
            FrontEnd { dead_time_samples: dead_time_samples as f32, lag_coefficient: self.lag_coefficient() as f32, ..FrontEnd::default() };
        match &self.curve {
            None => front_end.bias = ((self.constant - output_offset) / output_scale) as f32,
            Some(curve) => {
                let full = || refuse(format!("a curve of {} segments, at most {} fit", curve.slopes.len(), MAX_BENDS + 1));
                front_end.curve = Some(curve.dead_zones(self.constant, output_offset, output_scale).ok_or_else(full)?);
            }
        }
        if !self.stages.is_empty() {
            if self.input_path.lag_time_constant_s > 0.0 {
                return Err(refuse("a lag of the input path beside further stages, which have one of their own".to_owned()));
            }
            let full = |stage| refuse(format!("the curve of its stage `{stage}` has more than {MAX_BENDS} bends"));
            front_end.stages = Some(self.stages.as_wire(self.sample_period_s, input_scale).map_err(full)?);
        }
        let mut input_weight = self.input_gain;
        for (&threshold, &weight) in self.thresholds.iter().zip(&self.weights) {
            if threshold == 0.0 && self.stages.growth.is_none() {
                // The play operator of threshold zero is the input itself.
                input_weight += weight;
                continue;
            }
            let full = |_| refuse(format!("{} play operators, at most {MAX_PLAY} fit", self.thresholds.len()));
            front_end.play_thresholds.push((threshold / input_scale) as f32).map_err(full)?;
            front_end.play_weights.push((weight * gain) as f32).map_err(full)?;
        }
        front_end.input_weight = (input_weight * gain) as f32;
        if self.creep.gains.len() > MAX_CREEP {
            return Err(refuse(format!("{} creep filters, at most {MAX_CREEP} fit", self.creep.gains.len())));
        }
        if !self.creep.gains.is_empty() && input_weight != 0.0 {
            // The blob's creep sees the play operators only: the input's share needs an operator of threshold zero there.
            let full = |_| refuse(format!("{} play operators, at most {MAX_PLAY} fit", self.thresholds.len() + 1));
            front_end.play_thresholds.insert(0, 0.0).map_err(full)?;
            front_end.play_weights.insert(0, front_end.input_weight).map_err(full)?;
            front_end.input_weight = 0.0;
        }
        for (&time, &share) in self.creep.time_constants_s.iter().zip(&self.creep.gains) {
            let full = |_| refuse(format!("{} creep filters, at most {MAX_CREEP} fit", self.creep.gains.len()));
            front_end.creep_coefficients.push(coefficient(self.sample_period_s, time) as f32).map_err(full)?;
            front_end.creep_weights.push(share as f32).map_err(full)?;
        }
        let input = Channel {
            quantity: &self.input.quantity,
            unit: &self.input.unit,
            offset: self.rest_input as f32,
            scale: input_scale as f32,
            minimum: self.input.minimum as f32,
            maximum: self.input.maximum as f32,
        };
        let output = Channel {
            quantity: &self.output.quantity,
            unit: &self.output.unit,
            offset: output_offset as f32,
            scale: output_scale as f32,
            minimum: self.output.minimum as f32,
            maximum: self.output.maximum as f32,
        };
        Ok((input, output, front_end))
    }
}

/// Smallest and largest value.
pub(crate) fn range(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)))
}
