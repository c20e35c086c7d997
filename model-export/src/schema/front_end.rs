//! The front end: features, play operators, creep, curve. Its formulas are in [`super`].
//!
//! # Example
//! ```
//! use model_export::schema::{Curve, Feature, FeatureSource, FrontEnd};
//!
//! // A play operator of 0.1 of the input's scale, whose stop operator the network sees; the readout bends at 0.5.
//! let front_end = FrontEnd {
//!     play_thresholds: [0.1].into_iter().collect(),
//!     play_weights: [1.0].into_iter().collect(),
//!     features: [Feature { source: FeatureSource::Stop(0), offset: 0.0, gain: 1.0 }].into_iter().collect(),
//!     curve: Some(Curve { slope: 1.0, bend_points: [0.5].into_iter().collect(), bends: [-0.25].into_iter().collect(), ..Curve::default() }),
//!     lag_coefficient: 1.0,
//!     ..FrontEnd::default()
//! };
//! assert_eq!(front_end.inputs(), 1);
//! assert_eq!((front_end.play_input(0), front_end.feature_input(0)), (0, 0));
//! ```

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::curve::Curve;
use super::stages::Stages;
use super::{MAX_CREEP, MAX_FEATURES, MAX_MORE_INPUTS, MAX_PLAY};

/// The signal of the front end that a network feature takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum FeatureSource {
    /// `u`.
    #[default]
    Input,
    /// `u(k) - u(k-1)`, zero at the first sample.
    InputDifference,
    /// `v`, the output of the input path.
    Path,
    /// `v(k) - v(k-1)`, zero at the first sample.
    PathDifference,
    /// `H_i`, the play operator of this index.
    Play(u8),
    /// `(v - H_i) / threshold_i`, the stop operator of this index, -1 to 1; the threshold must be positive. Bounded and blind to
    /// where in the range the loop lies, so a network learns from it what a reversal does once for the whole range.
    Stop(u8),
    /// `L`, the readout.
    Readout,
    /// `C_j`, the creep filter of this index.
    Creep(u8),
    /// `u(k-n)`, the normalised input this many samples ago, 0 to [`MAX_DEAD_TIME_SAMPLES`](super::MAX_DEAD_TIME_SAMPLES); before the first sample the input is taken
    /// to have rested where it begins. From schema version 3 on.
    Past(u8),
}

/// One network input: `feature = (signal - offset) * gain`, then rounded and saturated to Q1.14.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Feature {
    /// Which signal.
    pub source: FeatureSource,
    /// Centre of the signal.
    pub offset: f32,
    /// Reciprocal span, so that the training data lie within about -1 to 1.
    pub gain: f32,
}

/// The physics part: see the module documentation for the equations.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrontEnd {
    /// Dead time in samples, 0 to [`MAX_DEAD_TIME_SAMPLES`](super::MAX_DEAD_TIME_SAMPLES), linear interpolation between samples.
    pub dead_time_samples: f32,
    /// First-order lag, 0 < coefficient <= 1; 1 is no lag.
    pub lag_coefficient: f32,
    /// Thresholds of the play operators in normalised input, ascending, non-negative.
    pub play_thresholds: Vec<f32, MAX_PLAY>,
    /// Weights of the play operators.
    pub play_weights: Vec<f32, MAX_PLAY>,
    /// Coefficients of the creep filters, each in 0 < coefficient <= 1.
    pub creep_coefficients: Vec<f32, MAX_CREEP>,
    /// Weights of the creep filters.
    pub creep_weights: Vec<f32, MAX_CREEP>,
    /// Weight of the input path's output.
    pub input_weight: f32,
    /// Constant of the linear sum.
    pub bias: f32,
    /// Bends the linear sum; none leaves it as it is.
    pub curve: Option<Curve>,
    /// Half-width of the stick band on the estimate, in normalised output; 0 is none.
    pub stick_band: f32,
    /// What the network sees, in order.
    pub features: Vec<Feature, MAX_FEATURES>,
    /// Weights of the other inputs' paths, one each: as many as there are inputs beside the first.
    #[serde(skip)]
    pub more_input_weights: Vec<f32, MAX_MORE_INPUTS>,
    /// Which input each play operator follows, counted from 0; empty where all follow the first.
    #[serde(skip)]
    pub play_inputs: Vec<u8, MAX_PLAY>,
    /// Which input each feature sees, where its signal is one of an input; empty where all see the first.
    #[serde(skip)]
    pub feature_inputs: Vec<u8, MAX_FEATURES>,
    /// Further stages; only with one input, and with a `lag_coefficient` of 1: they have a lag of their own.
    #[serde(skip)]
    pub stages: Option<Stages>,
}

impl FrontEnd {
    /// Number of inputs.
    #[must_use]
    pub fn inputs(&self) -> usize {
        1 + self.more_input_weights.len()
    }

    /// The input that a play operator follows, counted from 0.
    #[must_use]
    pub fn play_input(&self, operator: usize) -> usize {
        self.play_inputs.get(operator).map_or(0, |input| usize::from(*input))
    }

    /// The input that a feature sees, counted from 0.
    #[must_use]
    pub fn feature_input(&self, feature: usize) -> usize {
        self.feature_inputs.get(feature).map_or(0, |input| usize::from(*input))
    }
}

impl Clone for FrontEnd {
    fn clone(&self) -> Self {
        let mut clone = Self::default();
        clone.clone_from(self);
        clone
    }

    /// In place: the microcontroller's stack has no room for a second one.
    fn clone_from(&mut self, source: &Self) {
        // Every field by name, so that a new one cannot be forgotten.
        let Self {
            dead_time_samples,
            lag_coefficient,
            play_thresholds,
            play_weights,
            creep_coefficients,
            creep_weights,
            input_weight,
            bias,
            curve,
            stick_band,
            features,
            more_input_weights,
            play_inputs,
            feature_inputs,
            stages,
        } = source;
        self.dead_time_samples = *dead_time_samples;
        self.lag_coefficient = *lag_coefficient;
        copy(&mut self.play_thresholds, play_thresholds);
        copy(&mut self.play_weights, play_weights);
        copy(&mut self.creep_coefficients, creep_coefficients);
        copy(&mut self.creep_weights, creep_weights);
        self.input_weight = *input_weight;
        self.bias = *bias;
        self.curve.clone_from(curve);
        self.stick_band = *stick_band;
        copy(&mut self.features, features);
        copy(&mut self.more_input_weights, more_input_weights);
        copy(&mut self.play_inputs, play_inputs);
        copy(&mut self.feature_inputs, feature_inputs);
        self.stages.clone_from(stages);
    }
}

fn copy<T: Copy, const N: usize>(to: &mut Vec<T, N>, from: &Vec<T, N>) {
    to.clear();
    // Both have the same capacity.
    let _ = to.extend_from_slice(from);
}
