//! The proof that no accumulator can overflow, with the room that is left.
//!
//! For every row the largest magnitude that any input could bring the accumulator to is `sum |w| * 32768`, whatever the data; for the
//! 64-bit sum that scales it, `|b| + sum |w_x| * 32768 * |m_x| + sum |w_h| * 32768 * |m_h|`. The headroom is the type's range over that.

use crate::schema::Network;

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

/// Headroom of a network's sums over all rows and all data. A row of zeros leaves infinite room.
#[must_use]
pub fn headroom(network: &Network<'_>) -> Headroom {
    let (mut accumulator, mut scaled) = (0.0f64, 0.0f64);
    for layer in &network.layers {
        let multipliers = |bytes: &[u8]| -> std::vec::Vec<f64> {
            bytes.as_chunks::<4>().0.iter().map(|bytes| f64::from(i32::from_le_bytes(*bytes)).abs()).collect()
        };
        let input_rows = layer.input_weights.chunks(usize::from(layer.inputs).max(1)).map(magnitude);
        let recurrent_rows = layer.recurrent_weights.chunks(usize::from(layer.units).max(1)).map(magnitude);
        let input_multipliers = multipliers(layer.input_multipliers);
        let recurrent_multipliers = multipliers(layer.recurrent_multipliers);
        let multipliers = input_multipliers.iter().zip(&recurrent_multipliers);
        let biases = layer.biases.as_chunks::<8>().0.iter().map(|bytes| i64::from_le_bytes(*bytes).unsigned_abs() as f64);
        for (((input, recurrent), (by_input, by_recurrent)), bias) in input_rows.zip(recurrent_rows).zip(multipliers).zip(biases) {
            accumulator = accumulator.max(input).max(recurrent);
            scaled = scaled.max(bias + input * by_input + recurrent * by_recurrent);
        }
    }
    let weights = network.dense.weights.as_chunks::<2>().0;
    let dense = weights.iter().map(|bytes| f64::from(i16::from_le_bytes(*bytes)).abs()).sum::<f64>() * 32_768.0;
    Headroom { accumulator: 2f64.powi(31) / accumulator, scaled: 2f64.powi(63) / scaled, dense: 2f64.powi(31) / dense }
}
