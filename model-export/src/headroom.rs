//! The proof that no accumulator can overflow, with the room that is left.
//!
//! For every row the largest magnitude that any input could bring the accumulator to is `sum |w| * 32768`, whatever the data; for the
//! 64-bit sum that scales it, `|b| + sum |w_x| * 32768 * |m_x| + sum |w_h| * 32768 * |m_h|`. The headroom is the type's range over that.
//!
//! # Example
//! ```
//! use model_export::headroom::{Headroom, headroom};
//! use model_export::quantise::{FloatLayer, FloatNetwork, LayerCalibration, quantise};
//! use model_export::schema::{Activation, Cell};
//!
//! // One LSTM unit: gates i, f, g, o with a weight of 0.1 for the input and 0.05 for the hidden state; it forgets by a bias of -1.
//! let layer = FloatLayer {
//!     cell: Cell::Lstm,
//!     inputs: 1,
//!     units: 1,
//!     input_weights: &[0.1; 4],
//!     recurrent_weights: &[0.05; 4],
//!     bias: &[0.0, -1.0, 0.0, 0.0],
//! };
//! let network = FloatNetwork {
//!     activation: Activation::Tanh,
//!     state_limit: 4.0,
//!     layers: vec![layer],
//!     dense_weights: &[0.5],
//!     dense_bias: 0.0,
//! };
//! let calibration = [LayerCalibration { hidden_max: 0.5, moments: None }];
//! let quantised = quantise(&network, &calibration)?;
//! let room: Headroom = headroom(&quantised.as_wire());
//! // A row of one weight of 127 times 32768 in 2^31.
//! assert!((room.accumulator - 516.0).abs() < 0.1);
//! assert!(room.least() > 1.0, "nothing can overflow");
//! # Ok::<(), model_export::quantise::QuantiseError>(())
//! ```

use crate::schema::{Layer, Network};

/// Range of the type over the largest magnitude possible; above 1 the sum cannot overflow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Headroom {
    /// Input and recurrent accumulators, `i32`.
    pub accumulator: f64,
    /// The scaled sum with the bias, `i64`.
    pub scaled: f64,
    /// The dense accumulator, `i32`.
    pub dense: f64,
}

impl Headroom {
    /// The least of the three.
    #[must_use]
    pub fn least(&self) -> f64 {
        self.accumulator.min(self.scaled).min(self.dense)
    }
}

fn magnitude(weights: &[u8]) -> f64 {
    weights.iter().map(|weight| f64::from(weight.cast_signed().unsigned_abs())).sum::<f64>() * 32_768.0
}

/// Largest magnitudes of a row: of each accumulator, and of what it adds to the scaled sum.
struct Row {
    input: [f64; 2],
    recurrent: [f64; 2],
    bias: f64,
}

fn rows(layer: &Layer<'_>) -> impl Iterator<Item = Row> {
    let sums = |weights: &'_ [u8], multipliers: &'_ [u8], columns: u16| {
        let multipliers = multipliers.as_chunks::<4>().0.iter().map(|bytes| f64::from(i32::from_le_bytes(*bytes)).abs());
        let sums = weights.chunks(usize::from(columns).max(1)).map(magnitude).zip(multipliers);
        sums.map(|(sum, multiplier)| [sum, sum * multiplier]).collect::<std::vec::Vec<_>>().into_iter()
    };
    let mut input = sums(layer.input_weights, layer.input_multipliers, layer.inputs);
    let mut recurrent = sums(layer.recurrent_weights, layer.recurrent_multipliers, layer.units);
    let biases = layer.biases.as_chunks::<8>().0.iter().map(|bytes| i64::from_le_bytes(*bytes).unsigned_abs() as f64);
    let gates = layer.cell.gates().iter().flat_map(|gate| core::iter::repeat_n(gate, usize::from(layer.units)));
    gates.zip(biases).map(move |(gate, bias)| Row {
        input: if gate.input.is_some() { input.next() } else { None }.unwrap_or_default(),
        recurrent: if gate.recurrent.is_some() { recurrent.next() } else { None }.unwrap_or_default(),
        bias,
    })
}

/// Headroom of a network's sums over all rows and all data. A row of zeros leaves infinite room.
#[must_use]
pub fn headroom(network: &Network<'_>) -> Headroom {
    let (mut accumulator, mut scaled) = (0.0f64, 0.0f64);
    for layer in &network.layers {
        for row in rows(layer) {
            accumulator = accumulator.max(row.input[0]).max(row.recurrent[0]);
            scaled = scaled.max(row.bias + row.input[1] + row.recurrent[1]);
        }
    }
    let weights = network.dense.weights.as_chunks::<2>().0;
    let dense = weights.iter().map(|bytes| f64::from(i16::from_le_bytes(*bytes)).abs()).sum::<f64>() * 32_768.0;
    Headroom { accumulator: 2f64.powi(31) / accumulator, scaled: 2f64.powi(63) / scaled, dense: 2f64.powi(31) / dense }
}
