//! The stability certificate of a network: whether it forgets where it started, for every input there can be.
//!
//! Terms. Two copies of the network get the same inputs from different states. The network is *incrementally input-to-state stable* when
//! their difference shrinks to nothing, and stays small when the inputs differ a little. For one LSTM unit `j`, with `D` for the absolute
//! difference of the two copies,
//!
//! ```text
//! Dc_j+ <= F_j Dc_j + sum_k A_jk Dh_k            A_jk = C_j / 4 |U_f|_jk + I_j |U_g|_jk + G_j / 4 |U_i|_jk
//! Dh_j+ <= O_j Dc_j+ + V_j / 4 sum_k |U_o|_jk Dh_k
//! ```
//!
//! because a sigmoid is no steeper than 1/4 and the activations no steeper than 1. `F`, `I`, `O`, `G` bound the gates and the candidate, `C` the
//! cell, `V` the activated cell, over all that features (saturated at 2) and hidden states (bounded by these same numbers) can
//! be after a reset and any inputs. All entries are non-negative, so a spectral radius below one of the matrix that the two lines form is sufficient. Layers
//! follow one another, and a chain of stable layers is stable.
//!
//! The weights are the quantised ones. Rounding adds a bounded disturbance to each step: differences shrink to its size, not to zero.
//!
//! The condition is that of LSTM networks; there is none here for networks with other layers.
//!
//! Source: the scalar form of the condition in F. Bonassi, E. Terzi, M. Farina, R. Scattolini, "LSTM neural networks: input to state stability
//! and probabilistic safety verification", L4DC 2020, and E. Terzi et al., "Learning model predictive control with long short-term memory
//! networks", Int. J. Robust Nonlinear Control 31, 2021; here entry by entry, which is less conservative.
//!
//! # Example
//! ```
//! use model_export::certificate::{Certificate, LARGEST_FEATURE, LayerBounds, RealLayer, certificate};
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
//! let found: Certificate = certificate(&quantised.as_wire(), 1e-3).expect("LSTM layers only");
//! assert!(found.holds() && found.radius < 0.5);
//! assert!(found.recovery_steps.expect("it gets there") < 50);
//!
//! // The same of the layer before quantisation: a forget gate of at most sigmoid(-1 + 2 * 0.1 + 0.05 |h|).
//! let layer = RealLayer {
//!     units: 1,
//!     input_weights: vec![0.1; 4],
//!     recurrent_weights: vec![0.05; 4],
//!     biases: vec![0.0, -1.0, 0.0, 0.0],
//!     cell_limit: 4.0,
//!     activation: Activation::Tanh,
//! };
//! let bounds: LayerBounds = layer.bounds(&[LARGEST_FEATURE]);
//! assert!(bounds.forget_gates[0] < 0.33);
//! # Ok::<(), model_export::quantise::QuantiseError>(())
//! ```

use std::vec;
use std::vec::Vec;

use crate::fixed::{FEATURE_FRACTION, hidden_fraction};
use crate::schema::{Activation, Cell, Network};

/// Largest feature: Q1.14 saturates there.
pub const LARGEST_FEATURE: f64 = 2.0;
/// Steps after which a network that has not forgotten counts as one that does not: ten minutes at 50 Hz.
const MOST_STEPS: usize = 30_000;
/// Rounds of the bounds, each of which uses the last one's.
const BOUND_ROUNDS: usize = 20;

/// What can be said about a network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Certificate {
    /// Largest spectral radius of the layers; below one is certified.
    pub radius: f64,
    /// Steps after which no start can move the output by more than the tolerance, for a certified network that gets there.
    pub recovery_steps: Option<usize>,
}

impl Certificate {
    /// Whether the network is proven to forget where it started.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.radius < 1.0
    }
}

/// One layer in real numbers.
#[derive(Clone, Debug)]
pub struct RealLayer {
    /// Hidden units.
    pub units: usize,
    /// Rows of the gates i, f, g, o, `units` each, one column an input.
    pub input_weights: Vec<f64>,
    /// The same rows, one column a hidden unit.
    pub recurrent_weights: Vec<f64>,
    /// One for each row.
    pub biases: Vec<f64>,
    /// Largest magnitude of a cell.
    pub cell_limit: f64,
    /// Of the cells.
    pub activation: Activation,
}

/// What holds for one layer, whatever comes in.
#[derive(Clone, Debug)]
pub struct LayerBounds {
    /// Spectral radius of the layer's comparison system, from above.
    pub radius: f64,
    /// Largest opening of each forget gate.
    pub forget_gates: Vec<f64>,
    /// Largest magnitude of each hidden state.
    pub hidden: Vec<f64>,
}

impl RealLayer {
    /// The bounds for inputs of at most these magnitudes, one for each column.
    #[must_use]
    pub fn bounds(&self, inputs: &[f64]) -> LayerBounds {
        let bounded = bounds(self, inputs);
        let [_, forget_gates, _] = &bounded.gates;
        LayerBounds { radius: spectral_radius(&bounded), forget_gates: forget_gates.clone(), hidden: bounded.hidden() }
    }
}

/// One layer with its bounds.
struct Bounded {
    units: usize,
    /// Row-major, gates i, f, g, o.
    recurrent: [Vec<f64>; 4],
    cell: Vec<f64>,
    gates: [Vec<f64>; 3],
    candidate: Vec<f64>,
    activated: Vec<f64>,
}

/// Examines a network of LSTM layers, none for others; `tolerance` is in normalised output.
#[must_use]
pub fn certificate(network: &Network<'_>, tolerance: f64) -> Option<Certificate> {
    let activation = network.activation().ok()?;
    if network.layers.iter().any(|layer| layer.cell != Cell::Lstm) {
        return None;
    }
    let mut radius = 0.0f64;
    let mut fraction = i32::from(FEATURE_FRACTION);
    let mut inputs = vec![LARGEST_FEATURE; usize::from(network.layers.first()?.inputs)];
    let mut layers: Vec<(Bounded, Vec<f64>)> = Vec::new();
    for layer in &network.layers {
        let hidden = hidden_fraction(layer.cell, activation, layer.cell_exponent, layer.hidden_shift);
        let units = usize::from(layer.units);
        let real = RealLayer {
            units,
            input_weights: real(layer.input_weights, layer.input_multipliers, usize::from(layer.inputs), fraction),
            recurrent_weights: real(layer.recurrent_weights, layer.recurrent_multipliers, units, hidden),
            biases: layer.biases.as_chunks::<8>().0.iter().map(|bytes| i64::from_le_bytes(*bytes) as f64 * 2f64.powi(-48)).collect(),
            cell_limit: f64::from(layer.cell_limit) * 2f64.powi(i32::from(layer.cell_exponent) - 30),
            activation,
        };
        let bounded = bounds(&real, &inputs);
        radius = radius.max(spectral_radius(&bounded));
        inputs = bounded.hidden();
        fraction = hidden;
        layers.push((bounded, real.input_weights));
    }
    let dense = network.dense.weights.as_chunks::<2>().0.iter();
    let scale = f64::from(network.dense.scale.abs()) * 2f64.powi(fraction);
    let dense: Vec<f64> = dense.map(|bytes| scale * f64::from(i16::from_le_bytes(*bytes)).abs()).collect();
    let recovery_steps = if radius < 1.0 { recovery(&layers, &dense, tolerance) } else { None };
    Some(Certificate { radius, recovery_steps })
}

/// Weights as real numbers: `2^(fraction - 48)` times multiplier times integer.
fn real(weights: &[u8], multipliers: &[u8], columns: usize, fraction: i32) -> Vec<f64> {
    let step = 2f64.powi(fraction - 48);
    let scales = multipliers.as_chunks::<4>().0.iter().map(|bytes| f64::from(i32::from_le_bytes(*bytes)) * step);
    weights
        .chunks(columns.max(1))
        .zip(scales)
        .flat_map(|(row, scale)| row.iter().map(move |weight| f64::from(weight.cast_signed()) * scale))
        .collect()
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

fn bounds(layer: &RealLayer, inputs: &[f64]) -> Bounded {
    let RealLayer { units, cell_limit: limit, activation, .. } = *layer;
    let (gains, biases) = (&layer.input_weights, &layer.biases);
    let recurrent = [0, 1, 2, 3].map(|gate| layer.recurrent_weights[gate * units * units..(gate + 1) * units * units].to_vec());
    let activate = |x: f64| match activation {
        Activation::Tanh => x.tanh(),
        Activation::Relu => x.clamp(0.0, limit),
        Activation::Hard => x.clamp(-1.0, 1.0),
    };
    let mut cell = vec![limit; units];
    let mut activated: Vec<f64> = cell.iter().map(|c| activate(*c)).collect();
    let mut hidden_bound = activated.clone();
    let mut gates = [vec![1.0; units], vec![1.0; units], vec![1.0; units]];
    let mut candidate = vec![activate(f64::INFINITY); units];
    for _ in 0..BOUND_ROUNDS {
        // Largest pre-activation and largest magnitude of it, for a row of a gate.
        let reach = |gate: usize, unit: usize| {
            let row = gate * units + unit;
            let width = inputs.len();
            let from_inputs: f64 = gains[row * width..(row + 1) * width].iter().zip(inputs).map(|(gain, input)| gain.abs() * input).sum();
            let from_hidden: f64 =
                recurrent[gate][unit * units..(unit + 1) * units].iter().zip(&hidden_bound).map(|(gain, h)| gain.abs() * h).sum();
            (biases[row], from_inputs + from_hidden)
        };
        for unit in 0..units {
            for (place, gate) in [(0, 0), (1, 1), (2, 3)] {
                let (bias, spread) = reach(gate, unit);
                gates[place][unit] = sigmoid(bias + spread);
            }
            let (bias, spread) = reach(2, unit);
            candidate[unit] = activate(bias + spread).abs().max(activate(bias - spread).abs());
        }
        for unit in 0..units {
            let still = gates[0][unit] * candidate[unit] / (1.0 - gates[1][unit]).max(f64::MIN_POSITIVE);
            cell[unit] = still.min(limit);
            activated[unit] = activate(cell[unit]);
            hidden_bound[unit] = gates[2][unit] * activated[unit];
        }
    }
    Bounded { units, recurrent, cell, gates, candidate, activated }
}

impl Bounded {
    /// Largest magnitude of each hidden state.
    fn hidden(&self) -> Vec<f64> {
        self.gates[2].iter().zip(&self.activated).map(|(gate, activated)| gate * activated).collect()
    }

    /// One step of the comparison system: the differences of cell and hidden state, and what differing inputs add to the pre-activations.
    fn step(&self, cells: &[f64], hiddens: &[f64], inputs: &dyn Fn(usize, usize) -> f64) -> (Vec<f64>, Vec<f64>) {
        let n = self.units;
        let influence = |gate: usize, unit: usize| -> f64 {
            let row = &self.recurrent[gate][unit * n..(unit + 1) * n];
            row.iter().zip(hiddens).map(|(weight, hidden)| weight.abs() * hidden).sum::<f64>() + inputs(gate, unit)
        };
        let mut next_cells = vec![0.0; n];
        let mut next_hiddens = vec![0.0; n];
        for unit in 0..n {
            let [input_gate, forget_gate, output_gate] = [0, 1, 2].map(|gate| self.gates[gate][unit]);
            next_cells[unit] = forget_gate * cells[unit]
                + 0.25 * self.cell[unit] * influence(1, unit)
                + input_gate * influence(2, unit)
                + 0.25 * self.candidate[unit] * influence(0, unit);
            next_hiddens[unit] = output_gate * next_cells[unit] + 0.25 * self.activated[unit] * influence(3, unit);
        }
        (next_cells, next_hiddens)
    }
}

/// Spectral radius of the comparison system, from above: for a non-negative matrix the largest growth of any entry of a positive vector
/// bounds it (Collatz and Wielandt), whatever the vector, and falls towards it under iteration.
fn spectral_radius(layer: &Bounded) -> f64 {
    let n = layer.units;
    let (mut cells, mut hiddens) = (vec![1.0; n], vec![1.0; n]);
    let mut radius = f64::INFINITY;
    for _ in 0..500 {
        let (next_cells, next_hiddens) = layer.step(&cells, &hiddens, &|_, _| 0.0);
        let growth = next_cells.iter().chain(&next_hiddens).zip(cells.iter().chain(&hiddens)).map(|(next, last)| next / last);
        radius = radius.min(growth.fold(0.0, f64::max));
        let largest = next_cells.iter().chain(&next_hiddens).copied().fold(f64::MIN_POSITIVE, f64::max);
        // A floor keeps the vector positive, which is what makes each growth a bound.
        let scaled = |value: &f64| (value / largest).max(1e-9);
        cells = next_cells.iter().map(scaled).collect();
        hiddens = next_hiddens.iter().map(scaled).collect();
    }
    radius
}

/// Steps until the comparison system of all layers, begun as far apart as states can be, moves the output by less than the tolerance for good.
fn recovery(layers: &[(Bounded, Vec<f64>)], dense: &[f64], tolerance: f64) -> Option<usize> {
    let mut states: Vec<(Vec<f64>, Vec<f64>)> = layers
        .iter()
        .map(|(layer, _)| {
            let hidden = (0..layer.units).map(|unit| 2.0 * layer.gates[2][unit] * layer.activated[unit]).collect();
            (layer.cell.iter().map(|cell| 2.0 * cell).collect(), hidden)
        })
        .collect();
    let mut last_above = None;
    for step in 0..MOST_STEPS {
        let difference: f64 = states.last()?.1.iter().zip(dense).map(|(hidden, weight)| hidden * weight).sum();
        if difference > tolerance {
            last_above = Some(step);
        } else if step > 10 + 2 * last_above.unwrap_or(0) {
            // As long again below the tolerance, and every layer shrinking.
            return Some(last_above.map_or(0, |above| above + 1));
        }
        let mut below: Vec<f64> = Vec::new();
        for ((layer, gains), (cells, hiddens)) in layers.iter().zip(&mut states) {
            let width = below.len();
            let from_below = |gate: usize, unit: usize| -> f64 {
                let row = gate * layer.units + unit;
                if width == 0 {
                    0.0
                } else {
                    gains[row * width..(row + 1) * width].iter().zip(&below).map(|(gain, h)| gain.abs() * h).sum()
                }
            };
            let next = layer.step(cells, hiddens, &from_below);
            (*cells, *hiddens) = next;
            below = hiddens.clone();
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schema::{Dense, Layer, MAX_LAYERS};

    /// One unit: weights of the gates i, f, g, o from the input and from the hidden state, and their biases, as bytes.
    struct Unit {
        input: [u8; 4],
        recurrent: [u8; 4],
        multipliers: Vec<u8>,
        biases: Vec<u8>,
        dense: Vec<u8>,
    }

    impl Unit {
        /// Weights in hundredths; the multiplier makes one step of a weight worth 0.01.
        fn new(recurrent: [i8; 4], biases: [f64; 4]) -> Self {
            // Real = weight * multiplier * 2^(14 - 48); the hidden state has 14 fractional bits with a shift of 15.
            let multiplier = (0.01 * 2f64.powi(34)) as i32;
            Self {
                input: [10; 4],
                recurrent: recurrent.map(i8::cast_unsigned),
                multipliers: [multiplier.to_le_bytes(); 4].concat(),
                biases: biases.map(|bias| ((bias * 2f64.powi(48)) as i64).to_le_bytes()).concat(),
                dense: 16_384i16.to_le_bytes().to_vec(),
            }
        }

        fn network(&self) -> Network<'_> {
            let layer = Layer {
                cell: Cell::Lstm,
                inputs: 1,
                units: 1,
                input_weights: &self.input,
                recurrent_weights: &self.recurrent,
                input_multipliers: &self.multipliers,
                recurrent_multipliers: &self.multipliers,
                biases: &self.biases,
                cell_exponent: 2,
                cell_limit: 1 << 30,
                hidden_shift: 15,
            };
            let mut layers = heapless::Vec::<_, MAX_LAYERS>::new();
            layers.push(layer).unwrap();
            let dense = Dense { weights: &self.dense, scale: 2f32.powi(-28), bias: 0.0 };
            Network { activation_code: Activation::Tanh.code(), layers, dense }
        }
    }

    #[test]
    fn a_network_that_forgets_is_certified_and_one_that_latches_is_not() {
        let forgets = Unit::new([5, 5, 20, 5], [0.0, -1.0, 0.0, 0.0]);
        let certificate = super::certificate(&forgets.network(), 0.01).unwrap();
        assert!(certificate.holds(), "{certificate:?}");
        let steps = certificate.recovery_steps.unwrap();
        assert!((1..60).contains(&steps), "{certificate:?}");
        // A candidate that its own output drives hard, and gates wide open: two equilibria.
        let latches = Unit::new([0, 0, 127, 0], [4.0, 4.0, 0.0, 4.0]);
        let certificate = super::certificate(&latches.network(), 0.01).unwrap();
        assert!(!certificate.holds() && certificate.recovery_steps.is_none(), "{certificate:?}");
    }

    #[test]
    fn without_recurrent_weights_the_radius_is_that_of_the_forget_gate() {
        let unit = Unit::new([0; 4], [0.0, 1.0, 0.0, 0.0]);
        let certificate = super::certificate(&unit.network(), 1e-3).unwrap();
        // The input reaches 2 with a weight of 0.1.
        assert!((certificate.radius - sigmoid(1.2)).abs() < 1e-6, "{certificate:?}");
    }

    #[test]
    fn a_tighter_tolerance_takes_longer() {
        let unit = Unit::new([5, 5, 20, 5], [0.0, 1.0, 0.0, 0.0]);
        let steps = |tolerance| super::certificate(&unit.network(), tolerance).unwrap().recovery_steps.unwrap();
        assert!(steps(1e-4) > steps(1e-2));
    }
}
