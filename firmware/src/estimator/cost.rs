//! What a step costs on the Cortex-M4 with the packed kernel, in instructions.
//!
//! The kernel's part is counted off its assembly and exact. The rest is compiled code: its constants are fitted to counts in the emulator
//! (rustc 1.95, release), and a test holds the whole to within 3 % of what the emulator counts. A board's cycles are more, by an
//! estimated 1.3 to 1.5 for each instruction: loads of several words, taken branches, flash wait states.

use model_export::schema::{Activation, Cell, Curve, Layer, Mode, Model, Stages};

use super::shape::Shape;

/// A step without network, operators, filters and features.
const STEP: usize = 156;
/// What a network adds to that, besides its layers.
const NETWORK: usize = 149;
const PLAY: usize = 28;
const CREEP: usize = 13;
/// A bend of the readout's curve, of which the curve's own part is counted in.
const BEND: usize = 16;
/// What leads an input through further stages, whichever there are, and what each of them adds to that. A curve without its bends, a filter.
const STAGES: usize = 40;
const CURVE: usize = 10;
const FLOW: usize = 8;
const FILTER: usize = 35;
/// Thresholds that change: with all that an operator does not see, and what each operator takes more.
const GROWTH: usize = 60;
const GROWING_PLAY: usize = 8;
/// What following its bound late adds to that, and a bend of that curve: short distances lie before most of them.
const FOLLOW: usize = 12;
const FOLLOW_BEND: usize = 12;
/// A feature with its rounding; without a network there are none.
const FEATURE: usize = 32;
/// Glue around a layer's kernel, and a unit's share of the dense output.
const LAYER: usize = 25;
const DENSE_UNIT: usize = 3;
/// Copying and clearing around each run of the network in window mode.
const WINDOW_SAMPLE: usize = 156;

/// Estimated instructions of one step of a valid model.
#[must_use]
pub fn step_instructions(model: &Model<'_>) -> usize {
    let front_end = &model.front_end;
    let features = front_end.features.len();
    let physics = STEP + PLAY * front_end.play_thresholds.len() + CREEP * front_end.creep_coefficients.len();
    let physics = physics + BEND * front_end.curve.as_ref().map_or(0, |curve| curve.bends.len());
    let physics = physics + front_end.stages.as_ref().map_or(0, |stages| stage_instructions(stages, front_end.play_thresholds.len()));
    let Some(network) = &model.network else { return physics };
    let activation = network.activation().unwrap_or(Activation::Tanh);
    let layers: usize = network.layers.iter().map(|layer| LAYER + layer_instructions(layer, activation)).sum();
    let run = layers + DENSE_UNIT * network.dense.weights.len() / 2;
    let runs = match model.mode {
        Mode::Streaming => run,
        Mode::Window { length } => usize::from(length) * (run + WINDOW_SAMPLE),
    };
    physics + NETWORK + FEATURE * features + runs
}

/// Instructions of the further stages.
fn stage_instructions(stages: &Stages, plays: usize) -> usize {
    let curve = |curve: &Curve| CURVE + BEND * curve.bends.len();
    let curves: usize = [&stages.supply, &stages.muscle].into_iter().flatten().map(curve).sum();
    let filters = FILTER * [&stages.line, &stages.tip].into_iter().flatten().count();
    // One of the two runs in a sample.
    let flow = stages.flow.as_ref().map_or(0, |flow| FLOW + curve(&flow.fill).max(curve(&flow.vent)));
    let growth = stages.growth.as_ref().map_or(0, |growth| {
        let follow = growth.follow.as_ref().map_or(0, |curve| FOLLOW + FOLLOW_BEND * curve.bends.len());
        GROWTH + curve(&growth.law) + (GROWING_PLAY + follow) * plays
    });
    STAGES + curves + filters + flow + growth
}

/// Instructions of the assembly for one layer, as it stands in `smlad`.
fn layer_instructions(layer: &Layer<'_>, activation: Activation) -> usize {
    let shape = Shape { cell: layer.cell, inputs: usize::from(layer.inputs), units: usize::from(layer.units) };
    // Loops that copy four samples each; the input's may be half empty, and a dense layer's copy is made all the same.
    let fours = shape.recurrent_words() / 4;
    let (input, copied) = if shape.has_pairs() {
        let pairs = shape.input_words() / 4;
        (6 * pairs, pairs.div_ceil(2))
    } else {
        let groups = shape.input_words() / 4;
        (14 * groups + 8, groups)
    };
    let elements = match (layer.cell, layer.cell.activation(activation)) {
        (Cell::Lstm, Activation::Tanh) => 60,
        (Cell::Lstm, Activation::Relu) => 53,
        (Cell::Lstm, Activation::Hard) => 55,
        (Cell::Gru, Activation::Tanh) => 53,
        (Cell::Gru, Activation::Relu) => 51,
        (Cell::Gru, Activation::Hard) => 49,
        // Of four units.
        (Cell::Dense(_), Activation::Tanh) => 67,
        (Cell::Dense(_), Activation::Relu) => 63,
        (Cell::Dense(_), Activation::Hard) => 51,
    };
    // Entering the columns, six accumulators to start from and four sums to keep: 3 and 3; 8 to tell rows apart and 1 to leave.
    let group = 3 + input + 3 + 14 * fours + 8 + 1 + elements;
    40 + 7 * (copied + fours.max(1)) + shape.groups() * group
}
