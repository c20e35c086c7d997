//! The network: cells, layers, activations, and how it is run.
//!
//! # Example
//! ```
//! use model_export::schema::{Activation, Cell, Dense, Gate, Layer, Mode, Network};
//!
//! assert_eq!(Activation::from_code(Activation::Hard.code()), Some(Activation::Hard));
//! assert_eq!(Activation::Hard.name(), "hard");
//!
//! let letters: Vec<&str> = Cell::Gru.gates().iter().map(|gate: &Gate| gate.name).collect();
//! assert_eq!(letters, ["r", "u", "n", "m"]);
//! assert_eq!((Cell::Gru.input_rows(), Cell::Gru.recurrent_rows()), (3, 3));
//! assert_eq!(Cell::Dense(Activation::Relu).activation(Activation::Tanh), Activation::Relu);
//! assert_eq!(Cell::Lstm.name(), "LSTM");
//!
//! // An empty network streams; one of a window has its length in samples.
//! let layer = Layer { cell: Cell::Lstm, inputs: 1, units: 16, ..Layer::default() };
//! let network = Network { layers: [layer].into_iter().collect(), dense: Dense::default(), ..Network::default() };
//! assert_eq!(network.activation(), Ok(Activation::Tanh));
//! assert_ne!(Mode::default(), Mode::Window { length: 50 });
//! ```

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::MAX_LAYERS;

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
    /// Width of the input, 1 to [`MAX_WIDTH`](super::MAX_WIDTH).
    pub inputs: u16,
    /// Hidden units, 1 to [`MAX_UNITS`](super::MAX_UNITS).
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
