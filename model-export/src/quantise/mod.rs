//! From an `f32` network to the fixed-point one of [`crate::fixed`]: scales per row, rounding, and the formats of states.
//!
//! Two ways to round. *Nearest* takes the largest weight of a row as its scale's end and rounds each weight by itself; training with
//! the quantiser in the loop uses it. *Error feedback* knows the second moments `M = E[v v^T]` of what the row meets in use,
//! `v = (inputs, hidden states, 1)`, and looks for integers that keep the row's *output* close, `(w - q)^T M (w - q)` small: columns are
//! rounded in turn and the rest of the row, the bias last, makes up for the error so far (optimal brain compression; Frantar et al.,
//! "GPTQ", ICLR 2023, section 3). The scale is searched too: clipping a lone large weight can pay.
//!
//! Arithmetic here is `f64` on the desktop; `as` from float to integer saturates and follows an explicit rounding.
//!
//! # Example
//! ```
//! use model_export::quantise::{FloatLayer, FloatNetwork, HIDDEN_MARGIN, LayerCalibration, QuantiseError, quantise};
//! use model_export::quantise::{QuantisedLayer, QuantisedNetwork};
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
//! let quantised: QuantisedNetwork = quantise(&network, &calibration)?;
//! let layer: &QuantisedLayer = &quantised.layers[0];
//! assert!(layer.real_input_weights().iter().all(|weight| (weight - 0.1).abs() < 1e-6));
//! assert!(layer.real_recurrent_weights().iter().all(|weight| (weight - 0.05).abs() < 1e-6));
//! assert!((quantised.real_dense_weights()[0] - 0.5).abs() < 1e-4);
//! assert_eq!(quantised.as_wire().layers[0].units, 1);
//! // A hidden state of 0.5 with its margin fits +-1: Q0.15.
//! assert!(0.5 * HIDDEN_MARGIN < 1.0 && layer.hidden_fraction == 15);
//!
//! let wrong = FloatNetwork { dense_weights: &[], ..network };
//! assert_eq!(quantise(&wrong, &calibration), Err(QuantiseError::Shape { layer: 1 }));
//! # Ok::<(), QuantiseError>(())
//! ```

mod error;
mod network;
mod rounding;

use std::vec::Vec;

pub use error::QuantiseError;
pub use network::{FloatLayer, FloatNetwork, LayerCalibration, QuantisedLayer, QuantisedNetwork};

use crate::fixed::{self, CELL_FRACTION, FEATURE_FRACTION, MAX_CELL_EXPONENT, MAX_DENSE_SUM, MAX_HIDDEN_SHIFT};
use crate::schema::{self, Activation, Cell, Gate};
use rounding::{Feedback, nearest, power};

/// Room above the largest hidden state seen in calibration.
pub const HIDDEN_MARGIN: f64 = 1.25;

/// Quantises a network; `calibration` has one entry per layer.
///
/// # Errors
/// When the network's shape is not the one it claims, or a number does not fit its format.
pub fn quantise(network: &FloatNetwork<'_>, calibration: &[LayerCalibration]) -> Result<QuantisedNetwork, QuantiseError> {
    if network.layers.is_empty() || network.layers.len() > schema::MAX_LAYERS || calibration.len() != network.layers.len() {
        return Err(QuantiseError::Shape { layer: network.layers.len() });
    }
    let mut input_fraction = i32::from(FEATURE_FRACTION);
    let mut layers: Vec<QuantisedLayer> = Vec::with_capacity(network.layers.len());
    for (index, (layer, calibration)) in network.layers.iter().zip(calibration).enumerate() {
        check_layer(index, layer, layers.last().map(|below| below.units))?;
        let activation = layer.cell.activation(network.activation);
        let (cell_exponent, cell_limit) = state_format(index, layer.cell, activation, network.state_limit, calibration.hidden_max)?;
        // Room for what calibration has seen, with a margin, and never more than the format of the state makes possible.
        let highest = 15 - fixed::hidden_fraction(layer.cell, activation, cell_exponent, MAX_HIDDEN_SHIFT);
        let lowest = highest - i32::from(MAX_HIDDEN_SHIFT) + 1;
        let wanted = (calibration.hidden_max * HIDDEN_MARGIN).max(f64::MIN_POSITIVE).log2().ceil();
        let hidden_exponent = (wanted.clamp(f64::from(lowest), f64::from(highest))) as i32;
        let shift = i32::from(MAX_HIDDEN_SHIFT) + hidden_exponent - highest;
        let hidden_shift = u8::try_from(shift).unwrap_or(MAX_HIDDEN_SHIFT);
        let hidden_fraction = fixed::hidden_fraction(layer.cell, activation, cell_exponent, hidden_shift);

        let mut quantised = QuantisedLayer {
            cell: layer.cell,
            inputs: layer.inputs,
            units: layer.units,
            input_weights: Vec::new(),
            recurrent_weights: Vec::new(),
            input_scales: Vec::new(),
            recurrent_scales: Vec::new(),
            input_fraction,
            hidden_fraction,
            input_multipliers: Vec::new(),
            recurrent_multipliers: Vec::new(),
            biases: Vec::new(),
            cell_exponent,
            cell_limit,
            hidden_shift,
        };
        let (mut input_rows, mut recurrent_rows) = (layer.input_weights.chunks(layer.inputs), layer.recurrent_weights.chunks(layer.units));
        let mut row = 0;
        let mut feedback: Option<(Gate, Feedback)> = None;
        for gate in layer.cell.gates() {
            if let Some(moments) = &calibration.moments
                && feedback
                    .as_ref()
                    .is_none_or(|(of, _)| (of.input.is_some(), of.recurrent.is_some()) != (gate.input.is_some(), gate.recurrent.is_some()))
            {
                feedback = Some((*gate, Feedback::new(moments, layer.inputs, layer.units, (layer.cell, *gate))));
            }
            for bias in &layer.bias[row..row + layer.units] {
                let input = if gate.input.is_some() { input_rows.next() } else { None }.unwrap_or_default();
                let recurrent = if gate.recurrent.is_some() { recurrent_rows.next() } else { None }.unwrap_or_default();
                let rounded = match &feedback {
                    Some((_, feedback)) => feedback.search(input, recurrent, *bias),
                    None => nearest(input, recurrent, *bias),
                };
                quantised.push_row(index, row, &rounded)?;
                row += 1;
            }
        }
        input_fraction = hidden_fraction;
        layers.push(quantised);
    }
    let (dense_weights, dense_scale) = quantise_dense(network, &layers)?;
    Ok(QuantisedNetwork { activation: network.activation, layers, dense_weights, dense_scale, dense_bias: network.dense_bias })
}

/// Exponent and bound of a layer's state.
fn state_format(layer: usize, cell: Cell, activation: Activation, state_limit: f32, hidden_max: f64) -> Result<(u8, i32), QuantiseError> {
    let (limit, error) = match (cell, activation) {
        (Cell::Lstm, _) | (Cell::Gru, Activation::Relu) => (f64::from(state_limit), QuantiseError::StateLimit { limit: state_limit }),
        // Whole powers of two: the 16 bits of the output are what bounds it.
        (Cell::Dense(_), Activation::Relu) => {
            let reached = (hidden_max * HIDDEN_MARGIN).max(1.0);
            (power(reached.log2().ceil().min(64.0) as i32), QuantiseError::Output { layer, largest: hidden_max })
        }
        // They lie between -1 and 1 whatever comes.
        (Cell::Gru | Cell::Dense(_), Activation::Tanh | Activation::Hard) => (1.0, QuantiseError::StateLimit { limit: 1.0 }),
    };
    let bits = (0..=MAX_CELL_EXPONENT).find(|bits| limit <= power(i32::from(*bits)));
    let exponent = bits.filter(|_| limit > 1e-6).ok_or(error)?;
    // Even, because the step halves it.
    Ok((exponent, 2 * (limit * power(i32::from(CELL_FRACTION) - i32::from(exponent) - 1)).round() as i32))
}

fn check_layer(index: usize, layer: &FloatLayer<'_>, below: Option<usize>) -> Result<(), QuantiseError> {
    let dimensions = (1..=schema::MAX_WIDTH).contains(&layer.inputs) && (1..=schema::MAX_UNITS).contains(&layer.units);
    let lengths = layer.input_weights.len() == layer.cell.input_rows() * layer.units * layer.inputs
        && layer.recurrent_weights.len() == layer.cell.recurrent_rows() * layer.units * layer.units
        && layer.bias.len() == layer.cell.gates().len() * layer.units;
    if !dimensions || !lengths || below.is_some_and(|units| units != layer.inputs) {
        return Err(QuantiseError::Shape { layer: index });
    }
    let mut values = layer.input_weights.iter().chain(layer.recurrent_weights).chain(layer.bias);
    if values.any(|value| !value.is_finite()) {
        return Err(QuantiseError::NotFinite { layer: index });
    }
    Ok(())
}

/// The widest integers whose sum of magnitudes keeps the `i32` accumulator from overflowing.
fn quantise_dense(network: &FloatNetwork<'_>, layers: &[QuantisedLayer]) -> Result<(Vec<u8>, f32), QuantiseError> {
    let (units, fraction) = layers.last().map_or((0, 0), |layer| (layer.units, layer.hidden_fraction));
    if network.dense_weights.len() != units {
        return Err(QuantiseError::Shape { layer: layers.len() });
    }
    if network.dense_weights.iter().any(|weight| !weight.is_finite()) || !network.dense_bias.is_finite() {
        return Err(QuantiseError::NotFinite { layer: layers.len() });
    }
    let magnitudes = network.dense_weights.iter().map(|weight| f64::from(weight.abs()));
    let sum: f64 = magnitudes.clone().sum();
    let largest = magnitudes.fold(0.0, f64::max);
    // Rounding adds at most half a step per weight.
    let room = f64::from(MAX_DENSE_SUM) - 0.5 * f64::from(u32::try_from(units).unwrap_or(u32::MAX)) - 1.0;
    let scale = (sum / room).max(largest / 32767.0);
    let scale = if scale > 0.0 { scale } else { 1.0 };
    let integers = network.dense_weights.iter().map(|weight| (f64::from(*weight) / scale).round() as i16);
    let bytes = integers.flat_map(i16::to_le_bytes).collect();
    Ok((bytes, (scale * power(-fraction)) as f32))
}
