//! Networks before and after quantisation.

use std::vec::Vec;

use super::error::QuantiseError;
use super::rounding::{RoundedRow, power};
use crate::fixed::{BIAS_FRACTION, BIAS_ROUNDING, MAX_BIAS};
use crate::schema::{self, Activation, Cell};

/// One layer in `f32`; matrices row-major, rows in the order of [`Cell::gates`].
#[derive(Clone, Copy, Debug)]
pub struct FloatLayer<'a> {
    /// What it computes.
    pub cell: Cell,
    /// Width of the input.
    pub inputs: usize,
    /// Hidden units.
    pub units: usize,
    /// Rows of `inputs`.
    pub input_weights: &'a [f32],
    /// Rows of `units`.
    pub recurrent_weights: &'a [f32],
    /// One a gate and unit.
    pub bias: &'a [f32],
}

/// A network in `f32`.
#[derive(Clone, Debug)]
pub struct FloatNetwork<'a> {
    /// Activation of the recurrent layers.
    pub activation: Activation,
    /// Bound of the cell state, and the cap of the relu in recurrent layers.
    pub state_limit: f32,
    /// First layer first.
    pub layers: Vec<FloatLayer<'a>>,
    /// One per unit of the last layer.
    pub dense_weights: &'a [f32],
    /// Constant of the output.
    pub dense_bias: f32,
}

/// What a layer meets in use.
#[derive(Clone, Debug)]
pub struct LayerCalibration {
    /// Largest magnitude of the hidden state.
    pub hidden_max: f64,
    /// `E[v v^T]` with `v = (inputs, previous hidden states, 1)`, row-major; rounding is to nearest without it. A dense layer too has its
    /// previous outputs in it, which none of its rows sees.
    pub moments: Option<Vec<f64>>,
}

/// A fixed-point layer with its arrays as the blob stores them, and the scales that people ask for.
#[derive(Clone, Debug, PartialEq)]
pub struct QuantisedLayer {
    /// What it computes.
    pub cell: Cell,
    /// Width of the input.
    pub inputs: usize,
    /// Hidden units.
    pub units: usize,
    /// `i8` as bytes.
    pub input_weights: Vec<u8>,
    /// `i8` as bytes.
    pub recurrent_weights: Vec<u8>,
    /// Weight per integer step, one per row of the input matrix.
    pub input_scales: Vec<f32>,
    /// Weight per integer step, one per row of the recurrent matrix.
    pub recurrent_scales: Vec<f32>,
    /// Fractional bits of the input.
    pub input_fraction: i32,
    /// Fractional bits of the hidden state.
    pub hidden_fraction: i32,
    pub(super) input_multipliers: Vec<u8>,
    pub(super) recurrent_multipliers: Vec<u8>,
    pub(super) biases: Vec<u8>,
    pub(super) cell_exponent: u8,
    pub(super) cell_limit: i32,
    pub(super) hidden_shift: u8,
}

/// A fixed-point network that owns its arrays.
#[derive(Clone, Debug, PartialEq)]
pub struct QuantisedNetwork {
    /// Activation of the recurrent layers.
    pub activation: Activation,
    /// First layer first.
    pub layers: Vec<QuantisedLayer>,
    pub(super) dense_weights: Vec<u8>,
    pub(super) dense_scale: f32,
    pub(super) dense_bias: f32,
}

fn signed(bytes: &[u8]) -> impl Iterator<Item = i8> {
    bytes.iter().map(|byte| byte.cast_signed())
}

fn real_weights(bytes: &[u8], scales: &[f32], columns: usize) -> Vec<f32> {
    let mut weights = Vec::with_capacity(bytes.len());
    for (row, scale) in bytes.chunks(columns).zip(scales) {
        weights.extend(signed(row).map(|weight| f32::from(weight) * scale));
    }
    weights
}

impl QuantisedLayer {
    /// The input weights that the integers stand for.
    #[must_use]
    pub fn real_input_weights(&self) -> Vec<f32> {
        real_weights(&self.input_weights, &self.input_scales, self.inputs)
    }

    /// The recurrent weights that the integers stand for.
    #[must_use]
    pub fn real_recurrent_weights(&self) -> Vec<f32> {
        real_weights(&self.recurrent_weights, &self.recurrent_scales, self.units)
    }
}

impl QuantisedNetwork {
    /// The same network as the wire type of the blob, borrowing the arrays.
    #[must_use]
    pub fn as_wire(&self) -> schema::Network<'_> {
        let mut layers = heapless::Vec::new();
        for layer in &self.layers {
            let wire = schema::Layer {
                cell: layer.cell,
                inputs: u16::try_from(layer.inputs).unwrap_or(u16::MAX),
                units: u16::try_from(layer.units).unwrap_or(u16::MAX),
                input_weights: &layer.input_weights,
                recurrent_weights: &layer.recurrent_weights,
                input_multipliers: &layer.input_multipliers,
                recurrent_multipliers: &layer.recurrent_multipliers,
                biases: &layer.biases,
                cell_exponent: layer.cell_exponent,
                cell_limit: layer.cell_limit,
                hidden_shift: layer.hidden_shift,
            };
            // `quantise` has refused more layers than fit.
            let _ = layers.push(wire);
        }
        let dense = schema::Dense { weights: &self.dense_weights, scale: self.dense_scale, bias: self.dense_bias };
        schema::Network { activation_code: self.activation.code(), layers, dense }
    }

    /// The dense weights that the integers stand for.
    #[must_use]
    pub fn real_dense_weights(&self) -> Vec<f32> {
        let fraction = self.layers.last().map_or(0, |layer| layer.hidden_fraction);
        let scale = self.dense_scale * f32::from(2i16).powi(fraction);
        self.dense_weights.as_chunks::<2>().0.iter().map(|bytes| f32::from(i16::from_le_bytes(*bytes)) * scale).collect()
    }
}

impl QuantisedLayer {
    pub(super) fn push_row(&mut self, layer: usize, row: usize, rounded: &RoundedRow) -> Result<(), QuantiseError> {
        let multiplier = |scale: f64, fraction: i32| {
            let unit = power(i32::from(BIAS_FRACTION) - fraction);
            let scaled = (scale * unit).round();
            let limit = f64::from(i32::MAX);
            if scaled <= limit {
                Ok(scaled as i32)
            } else {
                Err(QuantiseError::Weight { layer, row, magnitude: 127.0 * scale, limit: 127.0 * limit / unit })
            }
        };
        let input_multiplier = multiplier(rounded.input_scale, self.input_fraction)?;
        let recurrent_multiplier = multiplier(rounded.recurrent_scale, self.hidden_fraction)?;
        let bias = (rounded.bias * power(i32::from(BIAS_FRACTION))).round();
        // The bound leaves the rounding constant its place.
        if bias.abs() >= power(61) - power(32) {
            return Err(QuantiseError::Bias { layer, row, value: rounded.bias });
        }
        let bias = (bias as i64 + BIAS_ROUNDING).clamp(-MAX_BIAS, MAX_BIAS);
        let (input, recurrent) = rounded.integers.split_at(rounded.inputs);
        self.input_weights.extend(input.iter().map(|weight| weight.cast_unsigned()));
        self.recurrent_weights.extend(recurrent.iter().map(|weight| weight.cast_unsigned()));
        // What the integer multiplier stands for, not what it was rounded from.
        let scale = |multiplier: i32, fraction: i32| (f64::from(multiplier) * power(fraction - i32::from(BIAS_FRACTION))) as f32;
        if !input.is_empty() {
            self.input_scales.push(scale(input_multiplier, self.input_fraction));
            self.input_multipliers.extend(input_multiplier.to_le_bytes());
        }
        if !recurrent.is_empty() {
            self.recurrent_scales.push(scale(recurrent_multiplier, self.hidden_fraction));
            self.recurrent_multipliers.extend(recurrent_multiplier.to_le_bytes());
        }
        self.biases.extend(bias.to_le_bytes());
        Ok(())
    }
}
