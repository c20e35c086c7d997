//! From an `f32` network to the fixed-point one of [`crate::fixed`]: scales per row, rounding, and the formats of states.
//!
//! Two ways to round. *Nearest* takes the largest weight of a row as its scale's end and rounds each weight by itself; training with
//! the quantiser in the loop uses it. *Error feedback* knows the second moments `M = E[v v^T]` of what the row meets in use,
//! `v = (inputs, hidden states, 1)`, and looks for integers that keep the row's *output* close, `(w - q)^T M (w - q)` small: columns are
//! rounded in turn and the rest of the row, the bias last, makes up for the error so far (optimal brain compression; Frantar et al.,
//! "GPTQ", ICLR 2023, section 3). The scale is searched too: clipping a lone large weight can pay.
//!
//! Arithmetic here is `f64` on the desktop; `as` from float to integer saturates and follows an explicit rounding.

use std::vec::Vec;

use crate::fixed::{
    self, BIAS_FRACTION, BIAS_ROUNDING, CELL_FRACTION, FEATURE_FRACTION, MAX_BIAS, MAX_CELL_EXPONENT, MAX_DENSE_SUM, MAX_HIDDEN_SHIFT,
};
use crate::schema::{self, Activation, Cell, Gate};

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

/// Room above the largest hidden state seen in calibration.
pub const HIDDEN_MARGIN: f64 = 1.25;

/// Why a network has no fixed-point form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum QuantiseError {
    /// The arrays do not fit the dimensions.
    Shape {
        /// The layer.
        layer: usize,
    },
    /// The state limit is not positive or above 128.
    StateLimit {
        /// The limit.
        limit: f32,
    },
    /// A weight too large for the row's multiplier.
    Weight {
        /// The layer.
        layer: usize,
        /// The row, in the order of the biases: gate times units plus unit.
        row: usize,
        /// Largest magnitude of the row.
        magnitude: f64,
        /// What would fit.
        limit: f64,
    },
    /// A bias too large for its format.
    Bias {
        /// The layer.
        layer: usize,
        /// The row.
        row: usize,
        /// The bias.
        value: f64,
    },
    /// A dense layer whose outputs exceed 128.
    Output {
        /// The layer.
        layer: usize,
        /// Its largest output in calibration.
        largest: f64,
    },
    /// A value that is not finite.
    NotFinite {
        /// The layer; one more than the last means the dense output.
        layer: usize,
    },
}

impl core::fmt::Display for QuantiseError {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Shape { layer } => write!(formatter, "layer {layer}: the weight arrays do not fit the layer's dimensions"),
            Self::StateLimit { limit } => {
                write!(formatter, "state limit {limit} is not between 0 and 128; train with a smaller one")
            }
            Self::Weight { layer, row, magnitude, limit } => write!(
                formatter,
                "layer {layer}, row {row}: a weight of {magnitude:.3} exceeds what fixed point can scale, {limit:.3}; train with weight decay"
            ),
            Self::Bias { layer, row, value } => {
                write!(formatter, "layer {layer}, row {row}: the bias {value:.3} exceeds 8191; train with weight decay")
            }
            Self::Output { layer, largest } => write!(
                formatter,
                "layer {layer}: outputs up to {largest:.1} leave no margin to 128, the most that fixed point holds; train with normalised values"
            ),
            Self::NotFinite { layer } => write!(formatter, "layer {layer}: a weight is not finite; train the model again"),
        }
    }
}

impl core::error::Error for QuantiseError {}

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
    input_multipliers: Vec<u8>,
    recurrent_multipliers: Vec<u8>,
    biases: Vec<u8>,
    cell_exponent: u8,
    cell_limit: i32,
    hidden_shift: u8,
}

/// A fixed-point network that owns its arrays.
#[derive(Clone, Debug, PartialEq)]
pub struct QuantisedNetwork {
    /// Activation of the recurrent layers.
    pub activation: Activation,
    /// First layer first.
    pub layers: Vec<QuantisedLayer>,
    dense_weights: Vec<u8>,
    dense_scale: f32,
    dense_bias: f32,
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

fn power(exponent: i32) -> f64 {
    2f64.powi(exponent)
}

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

/// A row in integers; it may have no inputs, or nothing else.
struct RoundedRow {
    integers: Vec<i8>,
    inputs: usize,
    input_scale: f64,
    recurrent_scale: f64,
    bias: f64,
}

impl QuantisedLayer {
    fn push_row(&mut self, layer: usize, row: usize, rounded: &RoundedRow) -> Result<(), QuantiseError> {
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

fn widest_scale(weights: &[f32]) -> f64 {
    weights.iter().fold(0.0, |largest: f64, weight| largest.max(f64::from(weight.abs()))) / 127.0
}

/// The nearest integer of 8 bits, symmetric.
fn round_weight(weight: f64, scale: f64) -> i8 {
    if scale > 0.0 { (weight / scale).round().clamp(-127.0, 127.0) as i8 } else { 0 }
}

fn nearest(input: &[f32], recurrent: &[f32], bias: f32) -> RoundedRow {
    let (input_scale, recurrent_scale) = (widest_scale(input), widest_scale(recurrent));
    let mut integers: Vec<i8> = input.iter().map(|weight| round_weight(f64::from(*weight), input_scale)).collect();
    integers.extend(recurrent.iter().map(|weight| round_weight(f64::from(*weight), recurrent_scale)));
    RoundedRow { integers, inputs: input.len(), input_scale, recurrent_scale, bias: f64::from(bias) }
}

/// The factors that tell how the columns still to be rounded make up for one that has been.
struct Feedback {
    width: usize,
    moments: Vec<f64>,
    clips: Vec<f64>,
    /// Upper Cholesky factor of the inverse of the (damped) moments, row-major.
    factor: Vec<f64>,
}

/// Part of the mean diagonal added to the moments: what calibration has not seen must not become free.
const DAMPING: f64 = 1e-3;

/// Ends of the scale that are tried, as parts of the largest weight.
const CLIPS: [f64; 8] = [1.0, 0.96, 0.92, 0.88, 0.84, 0.8, 0.72, 0.64];
/// As many that are tried in layers that were not trained with the quantiser in the loop: with a few weights in a row, there is a scale of
/// which all are nearly multiples.
const FINE_CLIPS: u8 = 96;

impl Feedback {
    /// For the rows of a gate of a layer with these moments: of them, the columns that the gate sees.
    fn new(moments: &[f64], inputs: usize, units: usize, (cell, gate): (Cell, Gate)) -> Self {
        let seen = |column: usize| match column {
            _ if column < inputs => gate.input.is_some(),
            _ if column < inputs + units => gate.recurrent.is_some(),
            _ => true,
        };
        let columns: Vec<usize> = (0..=inputs + units).filter(|column| seen(*column)).collect();
        let width = columns.len();
        let pairs = columns.iter().flat_map(|row| columns.iter().map(move |column| row * (inputs + units + 1) + column));
        let mut damped: Vec<f64> = pairs.map(|index| moments[index]).collect();
        let mean = (0..width).map(|index| damped[index * width + index]).sum::<f64>() / width.max(1) as f64;
        for index in 0..width {
            damped[index * width + index] += DAMPING * mean + 1e-12;
        }
        let factor = upper_factor_of_inverse(&damped, width);
        let clips = match cell {
            Cell::Lstm => CLIPS.to_vec(),
            Cell::Gru | Cell::Dense(_) => (0..FINE_CLIPS).map(|index| 1.0 - 0.4 * f64::from(index) / f64::from(FINE_CLIPS)).collect(),
        };
        Self { width, moments: damped, clips, factor }
    }

    /// The better scales and integers of a row.
    fn search(&self, input: &[f32], recurrent: &[f32], bias: f32) -> RoundedRow {
        let widest = (widest_scale(input), widest_scale(recurrent));
        let mut best = self.round(input, recurrent, bias, widest);
        // One scale after the other; the second search starts from what the first found.
        for which in 0..2 {
            for clip in &self.clips {
                let scales = if which == 0 { (best.0.input_scale, clip * widest.1) } else { (clip * widest.0, best.0.recurrent_scale) };
                let trial = self.round(input, recurrent, bias, scales);
                if trial.1 < best.1 {
                    best = trial;
                }
            }
        }
        best.0
    }

    /// Rounds a row with error feedback; also its mean square output error.
    fn round(&self, input: &[f32], recurrent: &[f32], bias: f32, scales: (f64, f64)) -> (RoundedRow, f64) {
        let original: Vec<f64> = input.iter().chain(recurrent).chain([&bias]).map(|value| f64::from(*value)).collect();
        let mut left = original.clone();
        let mut integers = Vec::with_capacity(self.width - 1);
        for column in 0..self.width - 1 {
            let scale = if column < input.len() { scales.0 } else { scales.1 };
            let integer = round_weight(left[column], scale);
            let value = f64::from(integer) * scale;
            let factor = &self.factor[column * self.width..][..self.width];
            let error = (left[column] - value) / factor[column];
            for later in column + 1..self.width {
                left[later] -= error * factor[later];
            }
            left[column] = value;
            integers.push(integer);
        }
        let difference: Vec<f64> = left.iter().zip(&original).map(|(rounded, exact)| rounded - exact).collect();
        let mut cost = 0.0;
        for (row, error) in self.moments.chunks(self.width).zip(&difference) {
            cost += error * row.iter().zip(&difference).map(|(moment, other)| moment * other).sum::<f64>();
        }
        let row =
            RoundedRow { integers, inputs: input.len(), input_scale: scales.0, recurrent_scale: scales.1, bias: left[self.width - 1] };
        (row, cost)
    }
}

/// `U` with `M^-1 = U^T U`, `U` upper triangular, of a symmetric positive definite `M`.
fn upper_factor_of_inverse(matrix: &[f64], width: usize) -> Vec<f64> {
    let inverse = inverse_from_factor(&lower_factor(matrix, width), width);
    let lower = lower_factor(&inverse, width);
    let mut upper = std::vec![0.0; width * width];
    for row in 0..width {
        for column in 0..=row {
            upper[column * width + row] = lower[row * width + column];
        }
    }
    upper
}

/// Cholesky: `L` with `M = L L^T`.
fn lower_factor(matrix: &[f64], width: usize) -> Vec<f64> {
    let mut lower = std::vec![0.0; width * width];
    for row in 0..width {
        for column in 0..=row {
            let dot: f64 = (0..column).map(|k| lower[row * width + k] * lower[column * width + k]).sum();
            let rest = matrix[row * width + column] - dot;
            // Damping keeps the pivot away from zero; the bound only guards against rounding.
            lower[row * width + column] = if row == column { rest.max(1e-300).sqrt() } else { rest / lower[column * width + column] };
        }
    }
    lower
}

fn inverse_from_factor(lower: &[f64], width: usize) -> Vec<f64> {
    let mut inverse = std::vec![0.0; width * width];
    let mut solution = std::vec![0.0; width];
    for column in 0..width {
        for row in 0..width {
            let unit = if row == column { 1.0 } else { 0.0 };
            let dot: f64 = (0..row).map(|k| lower[row * width + k] * solution[k]).sum();
            solution[row] = (unit - dot) / lower[row * width + row];
        }
        for row in (0..width).rev() {
            let dot: f64 = (row + 1..width).map(|k| lower[k * width + row] * solution[k]).sum();
            solution[row] = (solution[row] - dot) / lower[row * width + row];
        }
        for row in 0..width {
            inverse[row * width + column] = solution[row];
        }
    }
    inverse
}
