//! The wire types of a model blob; see [`crate::blob`] for its versions.
//!
//! An estimator has two parts. The **front end** is physics in `f32`: it normalises the input, passes it through a fractional
//! dead time and a first-order lag (the *input path*), feeds a bank of play operators, sums them with the identified weights,
//! lets that sum creep through slow first-order filters and bends the result along a curve where the actuator is not even over its
//! range (modified Prandtl-Ishlinskii). The **network** is a small one of LSTM, GRU and dense layers in fixed point that sees selected
//! front-end signals as 16-bit *features* and adds a correction to the front end's output.
//!
//! With `x` the raw input, one step computes, all in `f32`:
//!
//! ```text
//! u   = (x - input.offset) / input.scale                            normalised input
//! v   : v += lag_coefficient * (delay(u, dead_time_samples) - v)    input path
//! H_i = play(v, threshold_i)                                        play operators, paper eq. (2)
//! s   = sum_i play_weights_i * H_i                                  Prandtl-Ishlinskii sum, paper eq. (3)
//! C_j : C_j += creep_coefficient_j * (s - C_j)                      creep filters of the sum
//! p   = bias + input_weight * v + s + sum_j creep_weights_j * C_j   linear sum
//! L   = curve(p)                                                    readout, p itself without a curve
//! y   = output.offset + output.scale * S(L + N(features))           N: the network's output, 0 without a network
//! ```
//!
//! `S` is the stick band: its output stays until its input is more than `stick_band` away, then jumps to it.
//!
//! Every state starts at the first sample's equilibrium: `v = u(0)`, plays by the second line of eq. (2), `C_j = s(0)`.
//!
//! The network's hidden and cell states start at zero. In *streaming* mode they are carried from sample to sample. In *window* mode
//! every output comes from the last `length` feature vectors, run from zero state; before there are that many, the first feature
//! vector stands for the missing ones, as if the input had rested there. The arithmetic is that of [`crate::fixed`].

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::compensation::Extension;
use crate::validate::Invalid;
use crate::wire::{wire_enum, wire_struct};

/// Most play operators a front end may have.
pub const MAX_PLAY: usize = 24;
/// Most creep filters a front end may have.
pub const MAX_CREEP: usize = 4;
/// Most bends of the readout's curve.
pub const MAX_BENDS: usize = 8;
/// Longest dead time of the input path, in samples.
pub const MAX_DEAD_TIME_SAMPLES: usize = 32;
/// Most features the network may see: input, difference, path value, path difference, plays, readout, creeps.
pub const MAX_FEATURES: usize = 32;
/// Most layers before the dense output.
pub const MAX_LAYERS: usize = 4;
/// Most units of a layer.
pub const MAX_UNITS: usize = 64;

/// Widest input of a layer: features of the first, units of the one below for the others.
pub const MAX_WIDTH: usize = 64;
/// Most feature values a window may hold: length times features.
pub const MAX_WINDOW_VALUES: usize = 1024;
/// Most golden samples.
pub const MAX_GOLDEN: usize = 512;

/// One physical channel: unit and the affine map to its normalised form, `normalised = (value - offset) / scale`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
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
    /// `u(k-n)`, the normalised input this many samples ago, 0 to [`MAX_DEAD_TIME_SAMPLES`]; before the first sample the input is taken
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

/// A continuous, piecewise straight curve: `offset + slope * p + sum_k bends_k * max(p - bend_points_k, 0)`, the superposition of
/// one-sided dead zones of the modified Prandtl-Ishlinskii model (K. Kuhnen, European Journal of Control 9, 2003).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Value at `p = 0` of the part below the first bend.
    pub offset: f32,
    /// Slope below the first bend.
    pub slope: f32,
    /// Where the slope changes, ascending.
    pub bend_points: Vec<f32, MAX_BENDS>,
    /// By how much it changes there.
    pub bends: Vec<f32, MAX_BENDS>,
}

/// The physics part: see the module documentation for the equations.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
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
    /// Constant of the linear sum.
    pub bias: f32,
    /// Bends the linear sum; none leaves it as it is.
    pub curve: Option<Curve>,
    /// Half-width of the stick band on the estimate, in normalised output; 0 is none.
    pub stick_band: f32,
    /// What the network sees, in order.
    pub features: Vec<Feature, MAX_FEATURES>,
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
    }
}

fn copy<T: Copy, const N: usize>(to: &mut Vec<T, N>, from: &Vec<T, N>) {
    to.clear();
    // Both have the same capacity.
    let _ = to.extend_from_slice(from);
}

/// How the network meets time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// The state is carried from sample to sample.
    #[default]
    Streaming,
    /// Every output comes from the last `length` samples, from zero state.
    Window {
        /// Samples in the window.
        length: u16,
    },
}

/// The activation of a candidate, of an LSTM cell's output and of a dense layer; gates are always sigmoid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// Hyperbolic tangent.
    #[default]
    Tanh,
    /// `clamp(x, 0, state limit)`: the paper's Table I, clipped because the unclipped form diverges. A dense layer has no state limit.
    Relu,
    /// `clamp(x, -1, 1)`.
    Hard,
}

impl Activation {
    /// The number that stands for it on the wire; never reused.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Tanh => 0,
            Self::Relu => 1,
            Self::Hard => 2,
        }
    }

    /// The activation of a wire number.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Tanh),
            1 => Some(Self::Relu),
            2 => Some(Self::Hard),
            _ => None,
        }
    }

    /// Its name in files and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Tanh => "tanh",
            Self::Relu => "relu",
            Self::Hard => "hard",
        }
    }
}

/// What a layer computes, with `x` its input, `h` its output at the step before and one `z` for each of [`Cell::gates`].
///
/// ```text
/// LSTM    i, f, o = sigmoid(z)   g = act(z)                  c := clamp(f*c + i*g, +-limit)   h := o * act(c)
/// GRU     r, u = sigmoid(z)      n = act(z_n + r * z_m)      h := (1-u)*n + u*h
/// dense   h := act(z)
/// ```
///
/// The GRU is that of PyTorch: the reset gate scales the product with the hidden state, its bias included. Keras' `reset_after=True`
/// and ONNX' `linear_before_reset=1` are the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Cell {
    /// Long short-term memory, with the activation of the network.
    #[default]
    Lstm,
    /// Gated recurrent unit, with the activation of the network.
    Gru,
    /// No memory, and an activation of its own.
    Dense(Activation),
}

/// A set of rows of a layer, one a unit: `z = b`, plus `W x` where it sees the input, plus `U h` where it sees the hidden state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gate {
    /// Its letter in [`Cell`].
    pub name: &'static str,
    /// Which gate's rows of the input matrix are its own; none where it does not see the input.
    pub input: Option<usize>,
    /// Which gate's rows of the recurrent matrix are its own; none where it does not see the hidden state.
    pub recurrent: Option<usize>,
}

impl Gate {
    const fn both(name: &'static str, number: usize) -> Self {
        Self { name, input: Some(number), recurrent: Some(number) }
    }
}

impl Cell {
    /// Its gates, in the order in which their rows stand in the matrices and in the biases.
    #[must_use]
    pub const fn gates(self) -> &'static [Gate] {
        const LSTM: [Gate; 4] = [Gate::both("i", 0), Gate::both("f", 1), Gate::both("g", 2), Gate::both("o", 3)];
        const GRU: [Gate; 4] = [
            Gate::both("r", 0),
            Gate::both("u", 1),
            Gate { name: "n", input: Some(2), recurrent: None },
            Gate { name: "m", input: None, recurrent: Some(2) },
        ];
        const DENSE: [Gate; 1] = [Gate { name: "h", input: Some(0), recurrent: None }];
        match self {
            Self::Lstm => &LSTM,
            Self::Gru => &GRU,
            Self::Dense(_) => &DENSE,
        }
    }

    /// Rows of the input matrix for each unit.
    #[must_use]
    pub fn input_rows(self) -> usize {
        self.gates().iter().filter(|gate| gate.input.is_some()).count()
    }

    /// Rows of the recurrent matrix for each unit.
    #[must_use]
    pub fn recurrent_rows(self) -> usize {
        self.gates().iter().filter(|gate| gate.recurrent.is_some()).count()
    }

    /// Its activation in a network with this one.
    #[must_use]
    pub const fn activation(self, of_network: Activation) -> Activation {
        match self {
            Self::Lstm | Self::Gru => of_network,
            Self::Dense(own) => own,
        }
    }

    /// Its name in files and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Lstm => "LSTM",
            Self::Gru => "GRU",
            Self::Dense(_) => "dense",
        }
    }
}

/// One layer. Arrays are borrowed bytes, little-endian, so that reading a blob copies nothing; rows are in the order of [`Cell::gates`],
/// one row per unit in each gate. The formats are those of [`crate::fixed`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Layer<'a> {
    /// What it computes; schema version 2 has LSTM layers only.
    pub cell: Cell,
    /// Width of the input, 1 to [`MAX_WIDTH`].
    pub inputs: u16,
    /// Hidden units, 1 to [`MAX_UNITS`].
    pub units: u16,
    /// `i8`, rows of `inputs`.
    pub input_weights: &'a [u8],
    /// `i8`, rows of `units`.
    pub recurrent_weights: &'a [u8],
    /// `i32`, one per row of the input matrix: scale of its accumulator.
    pub input_multipliers: &'a [u8],
    /// `i32`, one per row of the recurrent matrix: scale of its accumulator.
    pub recurrent_multipliers: &'a [u8],
    /// `i64`, one per gate and unit: bias in Q15.48, rounding constant included.
    pub biases: &'a [u8],
    /// The state (of the cell; of a GRU, the hidden one; of a dense layer, its output) is in Q1.30 of `2^cell_exponent`.
    pub cell_exponent: u8,
    /// Bound of that state in its stored form; even.
    pub cell_limit: i32,
    /// Right shift from the product of output gate and activated cell, or from half the state, to the 16-bit hidden state.
    pub hidden_shift: u8,
}

/// The dense output: `N = bias + scale * sum(weight * hidden)`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Dense<'a> {
    /// `i16`, little-endian, one per unit of the last layer.
    pub weights: &'a [u8],
    /// Normalised output per step of the accumulator.
    pub scale: f32,
    /// Constant.
    pub bias: f32,
}

/// The correction that the network adds to the front end.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Network<'a> {
    /// [`Activation::code`] of every recurrent layer's activation.
    pub activation_code: u8,
    /// First layer first.
    #[serde(borrow)]
    pub layers: Vec<Layer<'a>, MAX_LAYERS>,
    /// The output.
    #[serde(borrow)]
    pub dense: Dense<'a>,
}

/// Where a model came from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance<'a> {
    /// Name of the training preset, or of the kind of physics model.
    pub preset: &'a str,
    /// Version of the tool that trained.
    pub tool_version: &'a str,
    /// SHA-256 of the training samples, lower-case hexadecimal; empty when unknown.
    pub training_data_sha256: &'a str,
    /// Seed of every random choice.
    pub seed: u64,
    /// Recordings trained on.
    pub training_recordings: u32,
    /// Optimiser steps made.
    pub optimiser_steps: u64,
}

/// How good the model was found to be when it was exported, in output units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Root mean square error on the validation part of the training, free running.
    pub validation_rmse: f32,
    /// Root mean square difference between fixed point and `f32` over the calibration data.
    pub rmse_f32_vs_fixed: f32,
    /// Largest difference between fixed point and `f32` over the calibration data.
    pub max_abs_f32_vs_fixed: f32,
    /// Samples of the calibration data.
    pub calibration_samples: u32,
}

/// What the training data covered, in input units: outside of it nothing is known about the model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Envelope {
    /// Smallest input.
    pub minimum: f32,
    /// Largest input.
    pub maximum: f32,
    /// Largest rate of the input, in units per second.
    pub maximum_rate: f32,
}

/// Vectors that the device replays before it trusts the model.
///
/// The outputs come from a reference in `f64` that shares no code with the estimator and knows the weights before quantisation; they
/// must be met within the tolerance. The digest is that of the estimator's own output bits on the desktop and must be met exactly.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Golden<'a> {
    /// `f32`, little-endian, in input units; the replay starts from the reset state.
    pub input: &'a [u8],
    /// `f32`, little-endian, in output units.
    pub output: &'a [u8],
    /// Largest difference allowed, in output units.
    pub tolerance: f32,
    /// CRC-32 of the estimator's outputs, as little-endian `f32`.
    pub digest: u32,
}

/// A model: everything in a blob but its frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Model<'a> {
    /// Time between samples in s.
    pub sample_period_s: f32,
    /// Streaming or window.
    pub mode: Mode,
    /// The input channel.
    #[serde(borrow)]
    pub input: Channel<'a>,
    /// The output channel.
    #[serde(borrow)]
    pub output: Channel<'a>,
    /// The physics part.
    pub front_end: FrontEnd,
    /// The correction; absent when physics alone suffices.
    #[serde(borrow)]
    pub network: Option<Network<'a>>,
    /// Where it came from.
    #[serde(borrow)]
    pub provenance: Provenance<'a>,
    /// How good it is.
    pub metrics: Metrics,
    /// What it was trained on.
    pub envelope: Envelope,
    /// How to check it.
    #[serde(borrow)]
    pub golden: Golden<'a>,
    /// What stands behind the model in the payload: an [`Extension`], or nothing.
    #[serde(skip)]
    pub extension: &'a [u8],
}

impl Model<'_> {
    /// The lowest schema version that has room for the model.
    #[must_use]
    pub fn schema_version(&self) -> u16 {
        let has_other_cells = |network: &Network<'_>| network.layers.iter().any(|layer| layer.cell != Cell::Lstm);
        let sees_past = self.front_end.features.iter().any(|feature| matches!(feature.source, FeatureSource::Past(_)));
        if sees_past || self.network.as_ref().is_some_and(has_other_cells) { 3 } else { 2 }
    }

    /// What the controllers need of the model, read; empty for a model that was exported for estimation only.
    ///
    /// # Errors
    /// When the bytes do not decode or a field is out of its domain.
    pub fn extension(&self) -> Result<Extension, Invalid> {
        Extension::decode(self.extension)
    }
}

wire_struct!(Channel<'a> { quantity, unit, offset, scale, minimum, maximum });
wire_enum!(Activation {
    0 Tanh,
    1 Relu,
    2 Hard,
});
wire_enum!(Cell {
    0 Lstm,
    1 Gru,
    2 Dense(activation),
});
wire_enum!(FeatureSource {
    0 Input,
    1 InputDifference,
    2 Path,
    3 PathDifference,
    4 Play(index),
    5 Stop(index),
    6 Readout,
    7 Creep(index),
    8 Past(age),
});
wire_struct!(Feature { source, offset, gain });
wire_struct!(Curve { offset, slope, bend_points, bends });
wire_struct!(FrontEnd {
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
});
wire_enum!(Mode {
    0 Streaming,
    1 Window { length },
});
wire_struct!(Layer<'a> {
    [from 3] cell,
    inputs,
    units,
    input_weights,
    recurrent_weights,
    input_multipliers,
    recurrent_multipliers,
    biases,
    cell_exponent,
    cell_limit,
    hidden_shift,
});
wire_struct!(Dense<'a> { weights, scale, bias });
wire_struct!(Network<'a> { activation_code, layers, dense });
wire_struct!(Provenance<'a> { preset, tool_version, training_data_sha256, seed, training_recordings, optimiser_steps });
wire_struct!(Metrics { validation_rmse, rmse_f32_vs_fixed, max_abs_f32_vs_fixed, calibration_samples });
wire_struct!(Envelope { minimum, maximum, maximum_rate });
wire_struct!(Golden<'a> { input, output, tolerance, digest });
wire_struct!(Model<'a> { sample_period_s, mode, input, output, front_end, network, provenance, metrics, envelope, golden; extension });
