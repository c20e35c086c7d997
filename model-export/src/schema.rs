//! The wire types of a model blob, version 1.
//!
//! An estimator has two parts. The **front end** is physics in `f32`: it normalises the input, passes it through a fractional
//! dead time and a first-order lag (the *input path*), feeds a bank of play operators, sums them with the identified weights and
//! lets that sum creep through slow first-order filters. The **network** is a small LSTM in fixed point that sees selected front-end
//! signals as 16-bit *features* and adds a correction to the front end's output.
//!
//! With `x` the raw input, one step computes, all in `f32`:
//!
//! ```text
//! u   = (x - input.offset) / input.scale                            normalised input
//! v   : v += lag_coefficient * (delay(u, dead_time_samples) - v)    input path
//! H_i = play(v, threshold_i)                                        play operators, paper eq. (2)
//! s   = sum_i play_weights_i * H_i                                  Prandtl-Ishlinskii sum, paper eq. (3)
//! C_j : C_j += creep_coefficient_j * (s - C_j)                      creep filters of the sum
//! L   = bias + input_weight * v + s + sum_j creep_weights_j * C_j   linear readout
//! y   = output.offset + output.scale * (L + N(features))            N: the network's output, 0 without a network
//! ```
//!
//! Every state starts at the first sample's equilibrium: `v = u(0)`, plays by the second line of eq. (2), `C_j = s(0)`.

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Most play operators a front end may have.
pub const MAX_PLAY: usize = 24;
/// Most creep filters a front end may have.
pub const MAX_CREEP: usize = 4;
/// Longest dead time of the input path, in samples.
pub const MAX_DEAD_TIME_SAMPLES: usize = 32;
/// Most features the network may see: input, difference, path value, path difference, plays, readout, creeps.
pub const MAX_FEATURES: usize = 32;
/// Most LSTM layers.
pub const MAX_LAYERS: usize = 2;
/// Most units of an LSTM layer.
pub const MAX_UNITS: usize = 64;

/// One physical channel: unit and the affine map to its normalised form, `normalised = (value - offset) / scale`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Channel<'a> {
    /// Quantity, for example `pressure`.
    pub quantity: &'a str,
    /// Unit, for example `bar`.
    pub unit: &'a str,
    /// Value that maps to zero.
    pub offset: f32,
    /// Span that maps to one; positive.
    pub scale: f32,
    /// Smallest value seen in training.
    pub minimum: f32,
    /// Largest value seen in training.
    pub maximum: f32,
}

/// The signal of the front end that a network feature takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FeatureSource {
    /// `u`.
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
    /// `L`, the linear readout.
    Readout,
    /// `C_j`, the creep filter of this index.
    Creep(u8),
}

/// One network input: `feature = (signal - offset) * gain`, then rounded and saturated to Q1.14.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Feature {
    /// Which signal.
    pub source: FeatureSource,
    /// Centre of the signal.
    pub offset: f32,
    /// Reciprocal span, so that the training data lie within about -1 to 1.
    pub gain: f32,
}

/// The physics part: see the module documentation for the equations.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrontEnd {
    /// Dead time in samples, 0 to [`MAX_DEAD_TIME_SAMPLES`], linear interpolation between samples.
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
    /// Constant of the readout.
    pub bias: f32,
    /// What the network sees, in order.
    pub features: Vec<Feature, MAX_FEATURES>,
}
