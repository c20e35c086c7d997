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

use heapless::Vec;
use hysteresis::play;
use model_export::schema::{self, Channel, Curve, FeatureSource, MAX_CREEP, MAX_DEAD_TIME_SAMPLES, MAX_INPUTS, MAX_PLAY};
use model_export::validate::Invalid;

use super::arithmetic::quantise_feature;

/// Largest magnitude of the normalised input that is believed.
pub const MAX_NORMALISED: f32 = 1000.0;

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
        let [PathState { input, path, .. }, ..] = state.paths;

        let mut sum = 0.0;
        if single {
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
        let readout = self.config.curve.as_ref().map_or(linear, |curve| bent(curve, linear));

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

/// The curve at `sum`.
fn bent(curve: &Curve, sum: f32) -> f32 {
    let straight = curve.offset + curve.slope * sum;
    curve.bend_points.iter().zip(&curve.bends).fold(straight, |value, (point, bend)| {
        // Not `f32::max`: one comparison, and the same answer on every target.
        let beyond = sum - point;
        if beyond > 0.0 { value + bend * beyond } else { value }
    })
}

/// Validation has put every index inside its table; the default is never taken.
fn element(values: &[f32], index: u8) -> f32 {
    values.get(usize::from(index)).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use heapless::Vec;
    use model_export::schema::Feature;

    fn channel() -> Channel<'static> {
        Channel { quantity: "pressure", unit: "bar", offset: 1.0, scale: 2.0, minimum: 0.0, maximum: 3.0 }
    }

    fn feature(source: FeatureSource) -> Feature {
        Feature { source, offset: 0.0, gain: 1.0 }
    }

    fn config() -> schema::FrontEnd {
        schema::FrontEnd {
            lag_coefficient: 1.0,
            play_thresholds: Vec::from_slice(&[0.0, 0.25]).unwrap(),
            play_weights: Vec::from_slice(&[0.5, 0.25]).unwrap(),
            ..schema::FrontEnd::default()
        }
    }

    #[test]
    fn follows_the_play_equation_by_hand() {
        let front_end = FrontEnd::new(&config(), &channel(), &[]).unwrap();
        let mut state = FrontEndState::default();
        // u = -0.5, 0.5, 0.25, -0.5: the second operator goes -0.25, 0.25, 0.25, -0.25. All values are exact in binary.
        let expected = [(0.0, -0.3125), (2.0, 0.3125), (1.5, 0.1875), (0.0, -0.3125)];
        for (raw, readout) in expected {
            assert_eq!(front_end.step(&mut state, &[raw], &mut [0.0; 0]).readout, readout);
        }
    }

    #[test]
    fn delays_by_fractions_of_a_sample_and_lags() {
        let config = schema::FrontEnd { dead_time_samples: 1.25, lag_coefficient: 0.5, input_weight: 1.0, ..schema::FrontEnd::default() };
        let front_end = FrontEnd::new(&config, &channel(), &[]).unwrap();
        let mut state = FrontEndState::default();
        front_end.step(&mut state, &[1.0], &mut [0.0; 0]);
        // A unit step in u, delayed: 0, 0.75, 1, 1; lagged by halves: 0, 0.375, 0.6875, 0.84375.
        let paths = [0.0, 0.375, 0.6875, 0.84375].map(|expected| (front_end.step(&mut state, &[3.0], &mut [0.0; 0]).path, expected));
        for (path, expected) in paths {
            assert_eq!(path, expected);
        }
    }

    #[test]
    fn the_longest_dead_time_is_exact() {
        let config = schema::FrontEnd { dead_time_samples: 32.0, lag_coefficient: 1.0, input_weight: 1.0, ..schema::FrontEnd::default() };
        let front_end = FrontEnd::new(&config, &channel(), &[]).unwrap();
        let mut state = FrontEndState::default();
        for sample in 0..100u8 {
            let path = front_end.step(&mut state, &[f32::from(sample)], &mut [0.0; 0]).path;
            assert_eq!(path, (f32::from(sample.saturating_sub(32)) - 1.0) / 2.0);
        }
    }

    #[test]
    fn creep_starts_at_equilibrium_and_follows_the_sum() {
        let mut config = config();
        config.creep_coefficients.push(0.25).unwrap();
        config.creep_weights.push(2.0).unwrap();
        let front_end = FrontEnd::new(&config, &channel(), &[]).unwrap();
        let mut state = FrontEndState::default();
        assert_eq!(front_end.step(&mut state, &[0.0], &mut [0.0; 0]).readout, -0.3125 * 3.0);
        assert_eq!(front_end.step(&mut state, &[2.0], &mut [0.0; 0]).readout, 0.3125 + 2.0 * (-0.3125 + 0.25 * 0.625));
    }

    #[test]
    fn the_curve_bends_the_sum_by_hand() {
        let curve = Curve {
            offset: 0.25,
            slope: 0.0,
            bend_points: Vec::from_slice(&[-0.5, 0.0, 0.5]).unwrap(),
            bends: Vec::from_slice(&[1.0, 1.0, -2.0]).unwrap(),
        };
        let config = schema::FrontEnd { lag_coefficient: 1.0, input_weight: 1.0, curve: Some(curve), ..schema::FrontEnd::default() };
        let front_end = FrontEnd::new(&config, &channel(), &[]).unwrap();
        let mut state = FrontEndState::default();
        // u = -1, -0.5, -0.25, 0, 0.25, 0.5, 1: flat, then slope 1, then slope 2, then flat again.
        let expected = [(-1.0, 0.25), (0.0, 0.25), (0.5, 0.5), (1.0, 0.75), (1.5, 1.25), (2.0, 1.75), (3.0, 1.75)];
        for (raw, readout) in expected {
            assert_eq!(front_end.step(&mut state, &[raw], &mut [0.0; 0]).readout, readout);
        }
    }

    #[test]
    fn features_are_the_signals_the_schema_names() {
        let mut config = config();
        config.dead_time_samples = 1.0;
        let sources = [
            FeatureSource::Input,
            FeatureSource::InputDifference,
            FeatureSource::Path,
            FeatureSource::PathDifference,
            FeatureSource::Play(1),
            FeatureSource::Stop(1),
            FeatureSource::Readout,
        ];
        config.features.extend(sources.map(feature));
        config.features.push(Feature { source: FeatureSource::Input, offset: 0.5, gain: 2.0 }).unwrap();
        let front_end = FrontEnd::new(&config, &channel(), &[]).unwrap();
        let mut state = FrontEndState::default();
        let mut features = [f32::NAN; 8];
        front_end.step(&mut state, &[0.0], &mut features);
        assert_eq!(features, [-0.5, 0.0, -0.5, 0.0, -0.25, -1.0, -0.3125, -2.0]);
        front_end.step(&mut state, &[2.0], &mut features);
        assert_eq!(features, [0.5, 1.0, -0.5, 0.0, -0.25, -1.0, -0.3125, 0.0]);
        front_end.step(&mut state, &[2.0], &mut features);
        assert_eq!(features, [0.5, 0.0, 0.5, 1.0, 0.25, 1.0, 0.3125, 0.0]);
    }

    #[test]
    fn a_sample_that_is_no_measurement_is_held_and_counted() {
        let front_end = FrontEnd::new(&config(), &channel(), &[]).unwrap();
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1.0e5] {
            let (mut state, mut reference) = (FrontEndState::default(), FrontEndState::default());
            front_end.step(&mut state, &[2.0], &mut [0.0; 0]);
            front_end.step(&mut reference, &[2.0], &mut [0.0; 0]);
            let output = front_end.step(&mut state, &[bad], &mut [0.0; 0]);
            assert!(output.held);
            assert_eq!(output.readout, front_end.step(&mut reference, &[2.0], &mut [0.0; 0]).readout);
            assert_eq!(state.held_samples(), 1);
        }
    }

    #[test]
    fn a_bad_first_sample_leaves_the_start_to_the_first_good_one() {
        let front_end = FrontEnd::new(&config(), &channel(), &[]).unwrap();
        let (mut state, mut fresh) = (FrontEndState::default(), FrontEndState::default());
        // At rest: u = -0.5, as in the hand calculation.
        assert_eq!(front_end.step(&mut state, &[f32::NAN], &mut [0.0; 0]).readout, -0.3125);
        for raw in [2.5, 1.0, 1.7] {
            assert_eq!(front_end.step(&mut state, &[raw], &mut [0.0; 0]), front_end.step(&mut fresh, &[raw], &mut [0.0; 0]));
        }
    }

    #[test]
    fn refuses_what_it_could_not_run() {
        let refused = |change: fn(&mut schema::FrontEnd)| {
            let mut config = config();
            change(&mut config);
            FrontEnd::new(&config, &channel(), &[]).unwrap_err().field
        };
        assert_eq!(refused(|config| config.dead_time_samples = 32.5), "front_end.dead_time_samples");
        assert_eq!(refused(|config| config.dead_time_samples = f32::NAN), "front_end.dead_time_samples");
        assert_eq!(refused(|config| config.lag_coefficient = 0.0), "front_end.lag_coefficient");
        assert_eq!(refused(|config| config.play_thresholds[0] = 0.5), "front_end.play_thresholds");
        assert_eq!(refused(|config| config.play_weights.truncate(1)), "front_end.play_weights");
        let curve = |points: &[f32], bends: &[f32]| {
            Some(Curve {
                slope: 1.0,
                bend_points: Vec::from_slice(points).unwrap(),
                bends: Vec::from_slice(bends).unwrap(),
                ..Curve::default()
            })
        };
        let refused_curve =
            |curve: Option<Curve>| FrontEnd::new(&schema::FrontEnd { curve, ..config() }, &channel(), &[]).unwrap_err().field;
        assert_eq!(refused_curve(curve(&[0.5, 0.5], &[1.0, 1.0])), "front_end.curve.bend_points");
        assert_eq!(refused_curve(curve(&[0.5], &[])), "front_end.curve.bends");
        assert_eq!(refused_curve(curve(&[0.5], &[f32::NAN])), "front_end.curve.bends");
        assert_eq!(refused(|config| config.features.push(feature(FeatureSource::Play(2))).unwrap()), "front_end.features");
        // The first operator has threshold zero: there is no stop to divide by.
        assert_eq!(refused(|config| config.features.push(feature(FeatureSource::Stop(0))).unwrap()), "front_end.features");
    }
}
