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
//! With several inputs each has a channel and an input path of its own, with the same dead time and lag. Every play operator follows one
//! of them, every feature that is made of `u` or `v` sees one of them, and the linear sum becomes
//! `p = bias + input_weight * v + s + sum_i more_input_weights_i * v_i + sum_j creep_weights_j * C_j`. From schema version 4 on.
//!
//! From schema version 5 on a front end of one input may have further stages (see [`Stages`]; each is optional). Before the operators
//!
//! ```text
//! a  = supply(delay(u, dead_time_samples))                          what the supply gives
//! w  : w += fill(a - w) where a > w, else w -= vent(w - a)          the valve's speed, filling and venting
//! v  = muscle(line(w))                                              swinging line, curve of the muscle; at most 1000 in size
//! ```
//!
//! in place of the input path; the gaps of the play operators by [`Growth`]; and `tip(curve(p))` for the readout.
//!
//! Every state starts at the first sample's equilibrium: `v = u(0)`, plays by the second line of eq. (2), `C_j = s(0)`.
//!
//! The network's hidden and cell states start at zero. In *streaming* mode they are carried from sample to sample. In *window* mode
//! every output comes from the last `length` feature vectors, run from zero state; before there are that many, the first feature
//! vector stands for the missing ones, as if the input had rested there. The arithmetic is that of [`crate::fixed`].
//!
//! # Example
//! ```
//! use model_export::schema::{Channel, Envelope, FrontEnd, Golden, Metrics, Model, Provenance};
//!
//! let front_end = FrontEnd {
//!     lag_coefficient: 1.0,
//!     play_thresholds: [0.0, 0.1].into_iter().collect(),
//!     play_weights: [0.5, 0.5].into_iter().collect(),
//!     ..FrontEnd::default()
//! };
//! let input = Channel { quantity: "pressure", unit: "bar", offset: 0.0, scale: 3.0, minimum: 0.0, maximum: 3.0 };
//! let output = Channel { quantity: "displacement", unit: "mm", offset: 0.0, scale: 10.0, minimum: 0.0, maximum: 10.0 };
//! let model = Model {
//!     sample_period_s: 0.02,
//!     input,
//!     output,
//!     front_end,
//!     provenance: Provenance { preset: "prandtl-ishlinskii", ..Provenance::default() },
//!     metrics: Metrics { validation_rmse: 0.03, ..Metrics::default() }, // mm
//!     envelope: Envelope { minimum: 0.0, maximum: 3.0, maximum_rate: 4.0 }, // bar, bar, bar/s
//!     golden: Golden::default(),
//!     ..Model::default()
//! };
//! assert_eq!(model.schema_version(), 2);
//! assert!(model.validate().is_ok());
//! ```

mod curve;
mod front_end;
mod limits;
mod network;
mod stages;

use heapless::Vec;
use serde::{Deserialize, Serialize};

pub use self::curve::Curve;
pub use self::front_end::{Feature, FeatureSource, FrontEnd};
pub use self::limits::{
    MAX_BENDS, MAX_CREEP, MAX_DEAD_TIME_SAMPLES, MAX_FEATURES, MAX_GOLDEN, MAX_INPUTS, MAX_LAYERS, MAX_MORE_INPUTS, MAX_PLAY, MAX_UNITS,
    MAX_WIDTH, MAX_WINDOW_VALUES,
};
pub use self::network::{Activation, Cell, Dense, Gate, Layer, Mode, Network};
pub use self::stages::{Filter, Flow, Growth, Stages};

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

/// What the training data covered of the first input, in its unit: outside of it nothing is known about the model. The ranges of the
/// other inputs stand in their channels.
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
    /// `f32`, little-endian, in input units, all inputs of a sample one after another; the replay starts from the reset state.
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
    /// The channels of the inputs beside the first. On the wire, from schema version 4 on, they and what the front end has for them stand
    /// behind everything else.
    #[serde(skip)]
    pub more_inputs: Vec<Channel<'a>, MAX_MORE_INPUTS>,
    /// What stands behind the model in the payload: an [`Extension`](crate::compensation::Extension), or nothing.
    #[serde(skip)]
    pub extension: &'a [u8],
}

impl Model<'_> {
    /// The lowest schema version that has room for the model.
    #[must_use]
    pub fn schema_version(&self) -> u16 {
        let has_other_cells = |network: &Network<'_>| network.layers.iter().any(|layer| layer.cell != Cell::Lstm);
        if self.front_end.stages.is_some() {
            return 5;
        }
        if !self.more_inputs.is_empty() {
            return 4;
        }
        let sees_past = self.front_end.features.iter().any(|feature| matches!(feature.source, FeatureSource::Past(_)));
        if sees_past || self.network.as_ref().is_some_and(has_other_cells) { 3 } else { 2 }
    }
}
