//! The fixed-point network in C.

use std::fmt::Write;

use model_export::fixed::{SIGMOID, TANH, Table};
use model_export::schema::{Activation, Cell, Layer, Mode, Model, Network};

use super::literal::{constant, integer, wrapped};
use super::template::{Context, fill};

/// Tables, weights and functions of the network; nothing without one.
pub fn source(context: &Context<'_>) -> String {
    let model = context.model();
    let Some(network) = &model.network else { return String::new() };
    let mut text = arithmetic(network);
    text.push_str(&layer_steps(network));
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

/// The activation of a layer: a blob that was decoded has one.
fn activation(network: &Network<'_>, cell: Cell) -> Activation {
    cell.activation(Activation::from_code(network.activation_code).unwrap_or(Activation::Tanh))
}

/// Each cell of the network once.
fn cells(network: &Network<'_>) -> Vec<Cell> {
    let mut cells: Vec<Cell> = Vec::new();
    for layer in &network.layers {
        if !cells.contains(&layer.cell) {
            cells.push(layer.cell);
        }
    }
    cells
}

/// What the layers compute with, and nothing else: strict compilers complain of functions that nobody calls.
fn arithmetic(network: &Network<'_>) -> String {
    let cells = cells(network);
    let has_gates = cells.iter().any(|cell| cell.recurrent_rows() > 0);
    let has_tanh = cells.iter().any(|cell| activation(network, *cell) == Activation::Tanh);
    let mut text = include_str!("template/fixed.c").to_owned();
    if has_gates {
        text.push_str(include_str!("template/product.c"));
    }
    if has_gates || has_tanh {
        text.push_str(include_str!("template/chords.c"));
    }
    if has_gates {
        text.push_str(&fill(include_str!("template/sigmoid.c"), &[("sigmoid", &table(&SIGMOID))]));
    }
    if has_tanh {
        text.push_str(&fill(include_str!("template/tanh.c"), &[("tanh", &table(&TANH))]));
    }
    text
}

fn table(table: &Table) -> String {
    wrapped(table.iter().map(|[base, slope]| format!("{{{}, {}}}", integer(*base), integer(*slope))))
}

fn layer_steps(network: &Network<'_>) -> String {
    let cells = cells(network);
    let most_units = network.layers.iter().filter(|layer| layer.cell.recurrent_rows() > 0).map(|layer| layer.units).max();
    let mut text = include_str!("template/layer.c").to_owned();
    if let Some(most_units) = most_units {
        let most_units = most_units.to_string();
        text.push_str(&fill(include_str!("template/pre_activation.c"), &[("most_units", &most_units)]));
    }
    text.extend(cells.into_iter().map(|cell| layer_step(cell, activation(network, cell))));
    text
}

fn layer_step(cell: Cell, activation: Activation) -> String {
    let template = match cell {
        Cell::Lstm => include_str!("template/lstm.c"),
        Cell::Gru => include_str!("template/gru.c"),
        Cell::Dense(_) => include_str!("template/dense.c"),
    };
    let (meaning, candidate, activated) = match activation {
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
    // Only a layer with states knows them by other names than its own.
    let to_cell = "(14u - layer->cell_exponent)";
    let candidate = if let Cell::Dense(_) = cell { candidate.replace("to_cell", to_cell) } else { candidate.to_owned() };
    let unused =
        if activation == Activation::Tanh && cell == Cell::Gru { "" } else { "    const uint32_t to_cell = 14u - layer->cell_exponent;\n" };
    let words =
        [("activation", meaning), ("candidate", &candidate), ("activated", activated), ("name", activation.name()), ("to_cell", unused)];
    fill(template, &words)
}

/// The arrays of one layer.
fn weights(index: usize, layer: &Layer<'_>) -> String {
    let (inputs, units) = (usize::from(layer.inputs), usize::from(layer.units));
    let gates = layer.cell.gates();
    let mut text = format!("\n/* Layer {index}, {}: {inputs} inputs, {units} units. */\n", layer.cell.name());
    let has_rows = |(_, matrix, ..): &(&str, &[u8], usize, Vec<&str>)| !matrix.is_empty();
    let matrices = [
        ("INPUT", layer.input_weights, inputs, gates.iter().filter(|gate| gate.input.is_some()).map(|gate| gate.name).collect()),
        ("RECURRENT", layer.recurrent_weights, units, gates.iter().filter(|gate| gate.recurrent.is_some()).map(|gate| gate.name).collect()),
    ];
    for (name, matrix, columns, gates) in matrices.into_iter().filter(has_rows) {
        let rows = gates.len() * units;
        let _ = writeln!(text, "static const int8_t {name}_WEIGHTS_{index}[{rows}u * {columns}u] = {{");
        for (row, weights) in matrix.chunks(columns).enumerate() {
            let gate = gates.get(row / units).copied().unwrap_or_default();
            let _ = writeln!(text, "    /* {gate} {} */", row % units);
            text.push_str(&wrapped(weights.iter().map(|weight| weight.cast_signed())));
        }
        text.push_str("};\n");
    }
    let multipliers = [("INPUT", layer.input_multipliers), ("RECURRENT", layer.recurrent_multipliers)];
    for (name, bytes) in multipliers.into_iter().filter(|(_, bytes)| !bytes.is_empty()) {
        let rows = bytes.len() / 4;
        let scales = bytes.as_chunks().0.iter().map(|bytes| integer(i32::from_le_bytes(*bytes)));
        let _ = write!(text, "static const int32_t {name}_SCALES_{index}[{rows}u] = {{\n{}}};\n", wrapped(scales));
    }
    let rows = layer.biases.len() / 8;
    let biases = layer.biases.as_chunks().0.iter().map(|bytes| format!("INT64_C({})", i64::from_le_bytes(*bytes)));
    let _ = write!(text, "static const int64_t BIASES_{index}[{rows}u] = {{\n{}}};\n", wrapped(biases));
    text
}

fn network_step(context: &Context<'_>, network: &Network<'_>) -> String {
    let (mut layers, mut resets, mut steps) = (String::new(), String::new(), String::new());
    let mut input = "features".to_owned();
    for (index, layer) in network.layers.iter().enumerate() {
        let Layer { cell, inputs, units, cell_exponent, cell_limit, hidden_shift, .. } = layer;
        let has_states = cell.recurrent_rows() > 0;
        let recurrent = |name: &str| if has_states { format!("RECURRENT_{name}_{index}") } else { "0".to_owned() };
        let _ = writeln!(
            layers,
            "    {{{inputs}u, {units}u, INPUT_WEIGHTS_{index}, {}, INPUT_SCALES_{index}, {}, BIASES_{index},\n     \
             {cell_exponent}u, {cell_limit}, {hidden_shift}u}},",
            recurrent("WEIGHTS"),
            recurrent("SCALES"),
        );
        let _ = writeln!(resets, "    for (unit = 0u; unit < {units}u; unit++) {{");
        if has_states {
            let _ = writeln!(resets, "        state->cells_{index}[unit] = 0;");
        }
        let _ = writeln!(resets, "        state->hidden_{index}[unit] = 0;\n    }}");
        let _ = match cell {
            Cell::Lstm => writeln!(steps, "    step_lstm(&LAYERS[{index}], {input}, state->cells_{index}, state->hidden_{index});"),
            Cell::Gru => writeln!(steps, "    step_gru(&LAYERS[{index}], {input}, state->cells_{index}, state->hidden_{index});"),
            Cell::Dense(own) => writeln!(steps, "    step_dense_{}(&LAYERS[{index}], {input}, state->hidden_{index});", own.name()),
        };
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
