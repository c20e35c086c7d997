//! The fixed-point LSTM in C.

use std::fmt::Write;

use model_export::fixed::{SIGMOID, TANH, Table};
use model_export::schema::{Activation, Layer, Mode, Model, Network};

use super::literal::{constant, integer, wrapped};
use super::{Context, fill};

/// Tables, weights and functions of the network; nothing without one.
pub fn source(context: &Context<'_>) -> String {
    let model = context.model();
    let Some(network) = &model.network else { return String::new() };
    let mut text = fill(include_str!("template/fixed.c"), &[("sigmoid", &table(&SIGMOID))]);
    if activation(network) == Activation::Tanh {
        text.push_str(&fill(include_str!("template/tanh.c"), &[("tanh", &table(&TANH))]));
    }
    text.push_str(&layer_step(network));
    for (index, layer) in network.layers.iter().enumerate() {
        text.push_str(&weights(index, layer));
    }
    text.push_str(&network_step(context, network));
    if let Mode::Window { length } = model.mode {
        let words = [("window", &*length.to_string()), ("name", context.name.identifier())];
        text.push_str(&fill(include_str!("template/window.c"), &words));
    }
    text
}

/// The network's part of a step.
pub fn correction(model: &Model<'_>) -> &'static str {
    match (&model.network, model.mode) {
        (None, _) => "0.0f",
        (Some(_), Mode::Streaming) => "step_network(state, features)",
        (Some(_), Mode::Window { .. }) => "step_window(state, features)",
    }
}

/// The network's part of a reset.
pub fn reset(model: &Model<'_>) -> &'static str {
    match (&model.network, model.mode) {
        (None, _) => "",
        (Some(_), Mode::Streaming) => "    reset_network(state);\n",
        (Some(_), Mode::Window { .. }) => "    state->window_filled = false;\n    state->oldest = 0u;\n    reset_network(state);\n",
    }
}

/// A blob that was decoded has an activation.
fn activation(network: &Network<'_>) -> Activation {
    Activation::from_code(network.activation_code).unwrap_or(Activation::Tanh)
}

fn table(table: &Table) -> String {
    wrapped(table.iter().map(|[base, slope]| format!("{{{}, {}}}", integer(*base), integer(*slope))))
}

fn layer_step(network: &Network<'_>) -> String {
    let (meaning, candidate, activated) = match activation(network) {
        Activation::Tanh => {
            ("tanh", "shift_right(hyperbolic_tangent(z), layer->cell_exponent)", "hyperbolic_tangent(shift_right(cell, to_cell))")
        }
        Activation::Hard => (
            "clamp(x, -1, 1)",
            "clamp(z, -65536, 65535) * power_of_two(to_cell)",
            "clamp(cell, -power_of_two(16u + to_cell), power_of_two(16u + to_cell) - 1) * power_of_two(layer->cell_exponent)",
        ),
        Activation::Relu => (
            "clamp(x, 0, cell limit)",
            "clamp(z, 0, shift_right(layer->cell_limit, to_cell)) * power_of_two(to_cell)",
            "(cell > 0) ? cell : 0",
        ),
    };
    let most_units = network.layers.iter().map(|layer| layer.units).max().unwrap_or(1);
    let words = [("activation", meaning), ("candidate", candidate), ("activated", activated), ("most_units", &most_units.to_string())];
    fill(include_str!("template/layer.c"), &words)
}

/// The arrays of one layer.
fn weights(index: usize, layer: &Layer<'_>) -> String {
    let (inputs, units) = (usize::from(layer.inputs), usize::from(layer.units));
    let rows = 4 * units;
    let mut text = format!("\n/* Layer {index}: {inputs} inputs, {units} units. */\n");
    for (name, matrix, columns) in [("INPUT", layer.input_weights, inputs), ("RECURRENT", layer.recurrent_weights, units)] {
        let _ = writeln!(text, "static const int8_t {name}_WEIGHTS_{index}[{rows}u * {columns}u] = {{");
        for (row, weights) in matrix.chunks(columns).enumerate() {
            let gate = ["i", "f", "g", "o"].get(row / units).copied().unwrap_or_default();
            let _ = writeln!(text, "    /* {gate} {} */", row % units);
            text.push_str(&wrapped(weights.iter().map(|weight| weight.cast_signed())));
        }
        text.push_str("};\n");
    }
    for (name, bytes) in [("INPUT", layer.input_multipliers), ("RECURRENT", layer.recurrent_multipliers)] {
        let scales = bytes.as_chunks().0.iter().map(|bytes| integer(i32::from_le_bytes(*bytes)));
        let _ = write!(text, "static const int32_t {name}_SCALES_{index}[{rows}u] = {{\n{}}};\n", wrapped(scales));
    }
    let biases = layer.biases.as_chunks().0.iter().map(|bytes| format!("INT64_C({})", i64::from_le_bytes(*bytes)));
    let _ = write!(text, "static const int64_t BIASES_{index}[{rows}u] = {{\n{}}};\n", wrapped(biases));
    text
}

fn network_step(context: &Context<'_>, network: &Network<'_>) -> String {
    let (mut layers, mut resets, mut steps) = (String::new(), String::new(), String::new());
    let mut input = "features".to_owned();
    for (index, layer) in network.layers.iter().enumerate() {
        let Layer { inputs, units, cell_exponent, cell_limit, hidden_shift, .. } = layer;
        let _ = writeln!(
            layers,
            "    {{{inputs}u, {units}u, INPUT_WEIGHTS_{index}, RECURRENT_WEIGHTS_{index}, INPUT_SCALES_{index}, RECURRENT_SCALES_{index}, \
             BIASES_{index},\n     {cell_exponent}u, {cell_limit}, {hidden_shift}u}},"
        );
        let _ = writeln!(resets, "    for (unit = 0u; unit < {units}u; unit++) {{");
        let _ = writeln!(resets, "        state->cells_{index}[unit] = 0;\n        state->hidden_{index}[unit] = 0;\n    }}");
        let _ = writeln!(steps, "    step_layer(&LAYERS[{index}], {input}, state->cells_{index}, state->hidden_{index});");
        input = format!("state->hidden_{index}");
    }
    let dense = network.dense.weights.as_chunks().0.iter().map(|bytes| i16::from_le_bytes(*bytes));
    fill(
        include_str!("template/network.c"),
        &[
            ("layer_count", &network.layers.len().to_string()),
            ("layers", &layers),
            ("outputs", &(network.dense.weights.len() / 2).to_string()),
            ("dense", &wrapped(dense)),
            ("scale", &constant(network.dense.scale)),
            ("bias", &constant(network.dense.bias)),
            ("resets", &resets),
            ("steps", &steps),
            ("hidden", &input),
            ("name", context.name.identifier()),
        ],
    )
}
