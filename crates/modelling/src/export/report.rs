//! How far fixed point is from `f32`: at the output, inside each gate, and over time.

use firmware::estimator::{Estimator, EstimatorState, FrontEnd, FrontEndState, Network, NetworkState, Trace, UnitTrace, quantise_feature};
use model_export::schema::{MAX_FEATURES, MAX_WIDTH, Mode, Model};
use model_export::validate::Invalid;
use serde::Serialize;

use super::reference::{LayerSignals, Reference};
use super::single::Single;
use super::work::Work;
use crate::network::{Cell, TrainedModel, narrowed};
use recording::Recording;

/// One inner signal of a layer, fixed point against the `f64` reference, over all units.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SignalReport {
    /// `input gate`, `forget gate`, `output gate`, `reset gate`, `update gate`, `candidate`, `cell` or `hidden`.
    pub name: &'static str,
    /// Largest magnitude in the reference.
    pub largest: f64,
    /// Power of the signal over the power of the difference, in dB; absent when there is no difference.
    pub signal_to_noise_db: Option<f64>,
    /// Root mean square of the difference in each tenth of the recordings, in time order: growth shows here.
    pub rms_over_time: Vec<f64>,
}

/// One layer of the error report.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LayerReport {
    /// The gates and states.
    pub signals: Vec<SignalReport>,
    /// Unit-steps in which the cell state met its limit.
    pub cell_saturations: u64,
    /// Unit-steps in which the hidden state met the end of its 16 bits.
    pub hidden_saturations: u64,
    /// Largest magnitude of a pre-activation.
    pub largest_pre_activation: f64,
}

/// Fixed point against `f32`, free running over the calibration data.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Comparison {
    /// Samples compared.
    pub samples: usize,
    /// Root mean square difference in output units.
    pub rmse: f64,
    /// Largest difference in output units.
    pub max_abs: f64,
    /// [`Self::rmse`] over the output channel's scale.
    pub rmse_normalised: f64,
    /// Root mean square difference of the output in each tenth of the recordings, in time order.
    pub rmse_over_time: Vec<f64>,
    /// Features that met the end of Q1.14.
    pub feature_saturations: u64,
    /// Layers, first layer first; empty without a network.
    pub layers: Vec<LayerReport>,
}

/// Parts of a recording for growth over time.
const PARTS: usize = 10;

/// What is compared in a layer, in the order of [`pairs`].
fn names(cell: Cell) -> &'static [&'static str] {
    match cell {
        Cell::Lstm => &["input gate", "forget gate", "candidate", "output gate", "cell", "hidden"],
        Cell::Gru => &["reset gate", "update gate", "candidate", "hidden"],
        Cell::Dense(_) => &["hidden"],
    }
}

/// A unit's signals, exact and in fixed point.
fn pairs(cell: Cell, exact: &LayerSignals, unit: usize, fixed: &UnitTrace) -> Vec<(f64, f32)> {
    let gate = |number: usize| (exact.gates[number][unit], fixed.gates[number]);
    let hidden = (exact.hidden[unit], fixed.hidden);
    match cell {
        Cell::Lstm => {
            vec![gate(0), gate(1), (exact.candidate[unit], fixed.candidate), gate(2), (exact.cell[unit], fixed.cell), hidden]
        }
        Cell::Gru => vec![gate(0), gate(1), (exact.candidate[unit], fixed.candidate), hidden],
        Cell::Dense(_) => vec![hidden],
    }
}

#[derive(Clone, Default)]
struct Power {
    signal: f64,
    noise: [f64; PARTS],
    count: [f64; PARTS],
    largest: f64,
}

#[derive(Clone)]
struct LayerPower {
    cell: Cell,
    signals: Vec<Power>,
    cell_saturations: u64,
    hidden_saturations: u64,
    largest_pre_activation: f64,
}

/// Collects one step of the fixed-point network.
#[derive(Default)]
struct Collect {
    layers: Vec<Vec<UnitTrace>>,
}

impl Trace for Collect {
    fn unit(&mut self, layer: usize, unit: usize, values: &UnitTrace) {
        if self.layers.len() <= layer {
            self.layers.resize(layer + 1, Vec::new());
        }
        if unit == 0 {
            self.layers[layer].clear();
        }
        self.layers[layer].push(*values);
    }
}

impl LayerPower {
    fn new(cell: Cell) -> Self {
        let signals = vec![Power::default(); names(cell).len()];
        Self { cell, signals, cell_saturations: 0, hidden_saturations: 0, largest_pre_activation: 0.0 }
    }

    fn add(&mut self, part: usize, reference: &LayerSignals, fixed: &[UnitTrace]) {
        for (unit, values) in fixed.iter().enumerate() {
            for (power, (exact, value)) in self.signals.iter_mut().zip(pairs(self.cell, reference, unit, values)) {
                power.signal += exact * exact;
                power.noise[part] += (f64::from(value) - exact).powi(2);
                power.count[part] += 1.0;
                power.largest = power.largest.max(exact.abs());
            }
            self.cell_saturations += u64::from(values.cell_saturated);
            self.hidden_saturations += u64::from(values.hidden_saturated);
        }
        self.largest_pre_activation = reference.pre_activations.iter().fold(self.largest_pre_activation, |most, z| most.max(z.abs()));
    }

    fn finish(&self) -> LayerReport {
        let signals = self.signals.iter().zip(names(self.cell)).map(|(power, name)| {
            let noise: f64 = power.noise.iter().sum();
            let ratio = (noise > 0.0).then(|| 10.0 * (power.signal / noise).log10());
            let rms_over_time = power.noise.iter().zip(power.count).map(|(noise, count)| (noise / count.max(1.0)).sqrt()).collect();
            SignalReport { name, largest: power.largest, signal_to_noise_db: ratio, rms_over_time }
        });
        LayerReport {
            signals: signals.collect(),
            cell_saturations: self.cell_saturations,
            hidden_saturations: self.hidden_saturations,
            largest_pre_activation: self.largest_pre_activation,
        }
    }
}

/// Runs a blob's model against the model it came from.
///
/// # Errors
/// When the model does not validate.
pub(super) fn compare(model: &TrainedModel, wire: &Model<'_>, data: &[Recording], work: &Work<'_>) -> Result<Comparison, Invalid> {
    let estimator = Estimator::new(wire)?;
    let (mut sum, mut max_abs) = (0.0, 0.0f64);
    let mut samples = 0usize;
    let (mut squares, mut counts) = ([0.0; PARTS], [0.0f64; PARTS]);
    for recording in data {
        let inputs = recording.inputs();
        for segment in recording.segments() {
            let length = segment.len();
            let mut single = Single::new(model)?;
            let mut state = EstimatorState::default();
            for (index, sample) in segment.enumerate() {
                let raw = narrowed(&inputs, sample);
                let difference = f64::from(estimator.step_all(&mut state, &raw).value) - f64::from(single.step(&raw));
                sum += difference * difference;
                max_abs = max_abs.max(difference.abs());
                squares[index * PARTS / length] += difference * difference;
                counts[index * PARTS / length] += 1.0;
                samples += 1;
                work.run();
            }
        }
    }
    let rmse = (sum / samples.max(1) as f64).sqrt();
    let (layers, feature_saturations) = inner(model, wire, data, work)?;
    Ok(Comparison {
        samples,
        rmse,
        max_abs,
        rmse_normalised: rmse / f64::from(model.output.scale),
        rmse_over_time: squares.iter().zip(counts).map(|(square, count)| (square / count.max(1.0)).sqrt()).collect(),
        feature_saturations,
        layers,
    })
}

/// The inside of the network, streamed: a window's steps are those of a stream that starts anew, so the stream shows its gates too.
fn inner(model: &TrainedModel, wire: &Model<'_>, data: &[Recording], work: &Work<'_>) -> Result<(Vec<LayerReport>, u64), Invalid> {
    let Some(network) = &wire.network else { return Ok((Vec::new(), 0)) };
    let front_end = FrontEnd::new(&wire.front_end, &wire.input, &wire.more_inputs)?;
    let network = Network::new(network, front_end.features())?;
    let mut powers: Vec<LayerPower> = network.layers().iter().map(|layer| LayerPower::new(layer.cell())).collect();
    let mut saturations = 0;
    let streamed = TrainedModel { mode: crate::network::Mode::Streaming, ..model.clone() };
    // A window starts from zero state every `length` samples, so no longer stream than that is compared.
    let restart = if let Mode::Window { length } = wire.mode { usize::from(length) } else { usize::MAX };
    for recording in data {
        let inputs = recording.inputs();
        for segment in recording.segments() {
            let length = segment.len();
            let mut reference = Reference::new(&streamed);
            let (mut physics, mut state, mut collect) = (FrontEndState::default(), NetworkState::default(), Collect::default());
            for (index, sample) in segment.enumerate() {
                if index > 0 && index.is_multiple_of(restart) {
                    reference.reset_network();
                    state.reset();
                }
                let mut features = [0.0; MAX_FEATURES];
                front_end.step(&mut physics, &narrowed(&inputs, sample), &mut features);
                let mut integers = [0; MAX_WIDTH];
                for (integer, feature) in integers.iter_mut().zip(features.iter().take(front_end.features())) {
                    *integer = quantise_feature(*feature);
                    saturations += u64::from(*integer == i16::MAX || *integer == i16::MIN);
                }
                network.step_traced(&mut state, &integers, &mut collect);
                let raw: Vec<f64> = inputs.iter().map(|values| values[sample]).collect();
                reference.step(&raw, &mut |_| {});
                for ((power, signals), fixed) in powers.iter_mut().zip(reference.layers()).zip(&collect.layers) {
                    power.add(index * PARTS / length, signals, fixed);
                }
                work.looked_into();
            }
        }
    }
    Ok((powers.iter().map(LayerPower::finish).collect(), saturations))
}
