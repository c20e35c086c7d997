//! The front end: the physics part of an estimator in `f32`, by the equations of [`model_export::schema`].
//!
//! Terms. *Normalised input* `u`: the raw sample through the input channel's map. *Input path* `v`: `u` after the dead time and the
//! lag. *Play sum* `s`: the weighted play operators. *Readout* `L`: the front end's estimate in normalised output, bent along the
//! curve where there is one.
//!
//! Every operation is a single `f32` addition, multiplication, division or comparison, so that desktop and Cortex-M4F give the same
//! bits. A sample that is not finite, or lies more than [`MAX_NORMALISED`] spans from the channel's centre, is no measurement: the
//! last good one is held in its place and the event counted. Play operators never forget, so one such sample let through would spoil
//! the memory for good.
//!
//! With several inputs a sample is one value of each. They start together, with the first sample in which all are good; after that each
//! holds its own last good value.

mod stages;

use heapless::Vec;
use hysteresis::play;
use model_export::schema::{self, Channel, FeatureSource, MAX_CREEP, MAX_DEAD_TIME_SAMPLES, MAX_INPUTS, MAX_PLAY};
use model_export::validate::Invalid;

pub use self::stages::MAX_READOUT;
use self::stages::StagesState;
use super::arithmetic::quantise_feature;
use super::curve::{MAX_NORMALISED, bent};

/// Two more than the longest dead time: the newest sample itself, and the older neighbour of a fractional delay.
const DELAY_LINE: usize = MAX_DEAD_TIME_SAMPLES + 2;

/// The physics part, ready to run; immutable.
#[derive(Clone, Debug, Default)]
pub struct FrontEnd {
    config: schema::FrontEnd,
    inputs: Vec<Normalisation, MAX_INPUTS>,
    delay_whole: usize,
    delay_fraction: f32,
}

/// The map of an input channel to its normalised form.
#[derive(Clone, Copy, Debug, Default)]
struct Normalisation {
    offset: f32,
    scale: f32,
    /// Normalised input at the low end of the range: stands in until the first good sample.
    rest: f32,
}

/// The memory of an input path.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PathState {
    delay_line: [f32; DELAY_LINE],
    input: f32,
    path: f32,
    /// `u` and `v` of the sample before.
    last: (f32, f32),
}

/// The memory of a [`FrontEnd`].
#[derive(Clone, Debug, PartialEq)]
pub struct FrontEndState {
    started: bool,
    newest: usize,
    paths: [PathState; MAX_INPUTS],
    plays: [f32; MAX_PLAY],
    creeps: [f32; MAX_CREEP],
    stages: StagesState,
    held_samples: u32,
}

/// What a feature becomes: itself, or the integer that the network computes with.
pub trait FromFeature {
    /// From its value.
    fn from_feature(value: f32) -> Self;
}

impl FromFeature for f32 {
    fn from_feature(value: f32) -> Self {
        value
    }
}

/// Q1.14.
impl FromFeature for i16 {
    fn from_feature(value: f32) -> Self {
        quantise_feature(value)
    }
}

/// What one step of the front end gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontEndOutput {
    /// `u`, the normalised first input that was used.
    pub input: f32,
    /// `v`, the output of the first input's path.
    pub path: f32,
    /// `L`, the readout in normalised output.
    pub readout: f32,
    /// The sample was no measurement and the last good one was used.
    pub held: bool,
}

impl Default for FrontEndState {
    fn default() -> Self {
        Self::new()
    }
}

impl FrontEndState {
    /// At the start.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            started: false,
            newest: 0,
            paths: [PathState::NEW; MAX_INPUTS],
            plays: [0.0; MAX_PLAY],
            creeps: [0.0; MAX_CREEP],
            stages: StagesState::NEW,
            held_samples: 0,
        }
    }

    /// Samples that were no measurement, since the last reset; saturates.
    #[must_use]
    pub fn held_samples(&self) -> u32 {
        self.held_samples
    }

    /// The path of an input; validation has put every number inside the list.
    fn path_of(&self, input: usize) -> &PathState {
        self.paths.get(input).unwrap_or(&PathState::NEW)
    }

    /// Forgets everything: the next good sample starts from its equilibrium.
    pub fn reset(&mut self) {
        // In place: a fresh one would be built on the stack of the tick first. What the first step sets itself is left to it.
        (self.started, self.newest, self.held_samples) = (false, 0, 0);
        self.paths.fill(PathState::NEW);
        self.plays.fill(0.0);
        self.creeps.fill(0.0);
        self.stages = StagesState::NEW;
    }
}

impl PathState {
    const NEW: Self = Self { delay_line: [0.0; DELAY_LINE], input: 0.0, path: 0.0, last: (0.0, 0.0) };

    /// The normalised input so many samples ago, less than [`DELAY_LINE`], where `newest` is the slot of the newest.
    fn past(&self, newest: usize, age: usize) -> f32 {
        let index = newest + age;
        let index = if index >= DELAY_LINE { index - DELAY_LINE } else { index };
        self.delay_line.get(index).copied().unwrap_or(self.input)
    }
}

impl FrontEnd {
    /// Builds the front end of a model; `more_inputs` are the channels of the inputs beside the first.
    ///
    /// # Errors
    /// When a field of `config` or of a channel is out of its domain, or the channels are not as many as `config` has weights for.
    pub fn new(config: &schema::FrontEnd, input: &Channel<'_>, more_inputs: &[Channel<'_>]) -> Result<Self, Invalid> {
        let mut front_end = Self::default();
        front_end.rebuild(config, input, more_inputs)?;
        Ok(front_end)
    }

    /// As [`Self::new`], over a front end that is there already.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn rebuild(&mut self, config: &schema::FrontEnd, input: &Channel<'_>, more_inputs: &[Channel<'_>]) -> Result<(), Invalid> {
        config.validate()?;
        if config.more_input_weights.len() != more_inputs.len() {
            let must = "as many as there are inputs beside the first";
            return Err(Invalid { field: "front_end.more_input_weights", index: 0, must });
        }
        self.inputs.clear();
        for channel in core::iter::once(input).chain(more_inputs) {
            channel.validate()?;
            let rest = ((channel.minimum - channel.offset) / channel.scale).clamp(-MAX_NORMALISED, MAX_NORMALISED);
            // There are no more than there is room for: the weights' list is as long.
            let _ = self.inputs.push(Normalisation { offset: channel.offset, scale: channel.scale, rest });
        }
        // The dead time is at most 32 samples, so counting up is exact and needs no float-to-integer cast.
        (self.delay_whole, self.delay_fraction) = (0, config.dead_time_samples);
        while self.delay_fraction >= 1.0 {
            self.delay_whole += 1;
            self.delay_fraction -= 1.0;
        }
        self.config.clone_from(config);
        Ok(())
    }

    /// The parameters it was built from.
    #[must_use]
    pub fn config(&self) -> &schema::FrontEnd {
        &self.config
    }

    /// Number of features it computes.
    #[must_use]
    pub fn features(&self) -> usize {
        self.config.features.len()
    }

    /// Number of inputs.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.inputs.len()
    }

    /// One sample: `raw` has a value of each input in its channel's unit, and a missing one is no measurement; `features` receives the
    /// network's inputs, before quantisation about -1 to 1, in the schema's order (features beyond the slice's end are not computed).
    ///
    /// # Deadline
    /// Runs in the control tick: about 15 instructions a play operator and 10 a feature.
    #[inline(always)]
    pub fn step<T: FromFeature>(&self, state: &mut FrontEndState, raw: &[f32], features: &mut [T]) -> FrontEndOutput {
        let (first, single) = (!state.started, self.inputs.len() <= 1);
        let held = self.take(state, raw);
        if held {
            state.held_samples = state.held_samples.saturating_add(1);
        }
        if first {
            state.plays = [0.0; MAX_PLAY];
            // A stand-in is no start: the first good sample shall find its own equilibrium.
            state.started = !held;
        }
        let stages = self.config.stages.as_ref();
        if let (Some(stages), [only, ..]) = (stages, &mut state.paths) {
            only.path = state.stages.lead(stages, only.path, first);
            if first {
                only.last.1 = only.path;
            }
        }
        let [PathState { input, path, last, .. }, ..] = state.paths;

        let mut sum = 0.0;
        if let Some(growth) = stages.and_then(|stages| stages.growth.as_ref()) {
            sum = state.stages.growing_plays(growth, &self.config, &mut state.plays, (path, last.1), first);
        } else if single {
            let operators = self.config.play_thresholds.iter().zip(&self.config.play_weights);
            for ((threshold, weight), memory) in operators.zip(&mut state.plays) {
                *memory = play::step(*threshold, path, *memory);
                sum += weight * *memory;
            }
        } else {
            sum = self.plays_of_several(state);
        }

        let mut linear = self.config.bias + self.config.input_weight * path + sum;
        if !single {
            linear = self.with_more_paths(state, linear);
        }
        let filters = self.config.creep_coefficients.iter().zip(&self.config.creep_weights);
        for ((coefficient, weight), memory) in filters.zip(&mut state.creeps) {
            *memory = if first { sum } else { *memory + coefficient * (sum - *memory) };
            linear += weight * *memory;
        }
        let mut readout = self.config.curve.as_ref().map_or(linear, |curve| bent(curve, linear));
        if let Some(tip) = stages.and_then(|stages| stages.tip.as_ref()) {
            readout = state.stages.swing(tip, readout, first);
        }

        if single {
            // A model of one input does not pay for the lists of several.
            let [only, ..] = &state.paths;
            for (feature, value) in self.config.features.iter().zip(features) {
                let signal = self.signal(state, only, only, readout, feature.source);
                *value = T::from_feature((signal - feature.offset) * feature.gain);
            }
        } else {
            self.features_of_several(state, readout, features);
        }
        FrontEndOutput { input, path, readout, held }
    }

    #[inline(never)]
    fn plays_of_several(&self, state: &mut FrontEndState) -> f32 {
        let operators = self.config.play_thresholds.iter().zip(&self.config.play_weights).zip(&mut state.plays);
        let mut sum = 0.0;
        for (index, ((threshold, weight), memory)) in operators.enumerate() {
            let path = state.paths.get(self.config.play_input(index)).map_or(0.0, |path| path.path);
            *memory = play::step(*threshold, path, *memory);
            sum += weight * *memory;
        }
        sum
    }

    #[inline(never)]
    fn with_more_paths(&self, state: &FrontEndState, linear: f32) -> f32 {
        let others = self.config.more_input_weights.iter().zip(state.paths.iter().skip(1));
        others.fold(linear, |linear, (weight, other)| linear + weight * other.path)
    }

    /// A feature's signal: of the input `seen`, and of the path that operators follow where it is a stop's.
    #[inline(always)]
    fn signal(&self, state: &FrontEndState, seen: &PathState, followed: &PathState, readout: f32, source: FeatureSource) -> f32 {
        match source {
            FeatureSource::Input => seen.input,
            FeatureSource::InputDifference => seen.input - seen.last.0,
            FeatureSource::Path => seen.path,
            FeatureSource::PathDifference => seen.path - seen.last.1,
            FeatureSource::Play(index) => element(&state.plays, index),
            FeatureSource::Stop(index) => (followed.path - element(&state.plays, index)) / element(&self.config.play_thresholds, index),
            FeatureSource::Readout => readout,
            FeatureSource::Creep(index) => element(&state.creeps, index),
            FeatureSource::Past(age) => seen.past(state.newest, usize::from(age)),
        }
    }

    #[inline(never)]
    fn features_of_several<T: FromFeature>(&self, state: &FrontEndState, readout: f32, features: &mut [T]) {
        let of_input = |input: Option<&u8>| state.path_of(input.map_or(0, |input| usize::from(*input)));
        for (index, (feature, value)) in self.config.features.iter().zip(features).enumerate() {
            let seen = of_input(self.config.feature_inputs.get(index));
            let followed = match feature.source {
                FeatureSource::Stop(operator) => of_input(self.config.play_inputs.get(usize::from(operator))),
                _ => seen,
            };
            let signal = self.signal(state, seen, followed, readout, feature.source);
            *value = T::from_feature((signal - feature.offset) * feature.gain);
        }
    }

    /// Takes a sample through every input path; whether any of its values was no measurement.
    #[inline(always)]
    fn take(&self, state: &mut FrontEndState, raw: &[f32]) -> bool {
        let FrontEndState { started, newest, paths, .. } = state;
        *newest = if *newest == 0 { DELAY_LINE - 1 } else { *newest - 1 };
        let (newest, first) = (*newest, !*started);
        let [first_path, more_paths @ ..] = paths;
        let (Some((normalisation, others)), value) = (self.inputs.split_first(), raw.first().copied().unwrap_or(f32::NAN)) else {
            return true;
        };
        let held = self.take_one(normalisation, first_path, value, newest, first);
        if others.is_empty() { held } else { held | self.take_others(others, more_paths, raw, newest, first) }
    }

    /// The inputs beside the first.
    #[inline(never)]
    fn take_others(&self, others: &[Normalisation], paths: &mut [PathState], raw: &[f32], newest: usize, first: bool) -> bool {
        let mut any_held = false;
        for (index, (normalisation, path)) in others.iter().zip(paths).enumerate() {
            let value = raw.get(1 + index).copied().unwrap_or(f32::NAN);
            any_held |= self.take_one(normalisation, path, value, newest, first);
        }
        any_held
    }

    /// Takes a value through one input path; whether it was no measurement.
    #[inline(always)]
    fn take_one(&self, normalisation: &Normalisation, state: &mut PathState, raw: f32, newest: usize, first: bool) -> bool {
        let measured = (raw - normalisation.offset) / normalisation.scale;
        // Also true for what is not a number.
        let held = measured.is_nan() || measured.abs() > MAX_NORMALISED;
        let input = match (held, first) {
            (false, _) => measured,
            (true, false) => state.input,
            (true, true) => normalisation.rest,
        };
        if first {
            state.delay_line = [input; DELAY_LINE];
        } else if let Some(slot) = state.delay_line.get_mut(newest) {
            *slot = input;
        }
        state.last = if first { (input, input) } else { (state.input, state.path) };
        state.input = input;
        // Dead time by linear interpolation between the two samples around it.
        let (younger, older) = (state.past(newest, self.delay_whole), state.past(newest, self.delay_whole + 1));
        let delayed = younger + self.delay_fraction * (older - younger);
        let lag = self.config.lag_coefficient;
        state.path = if first || lag >= 1.0 { delayed } else { state.last.1 + lag * (delayed - state.last.1) };
        held
    }
}

/// Validation has put every index inside its table; the default is never taken.
fn element(values: &[f32], index: u8) -> f32 {
    values.get(usize::from(index)).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
