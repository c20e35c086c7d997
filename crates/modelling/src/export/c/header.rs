//! The header: what the model is, its state, its functions.

use std::fmt::Write;

use model_export::blob::Blob;
use model_export::schema::{Activation, Mode, Model};

use super::front_end;
use super::literal::{decimal, plain};
use super::stages;
use super::template::{Context, fill};
use crate::network::described;

/// The model's identity.
pub fn sha256(blob: &Blob<'_>) -> String {
    blob.content_hash.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What goes in and what comes out, in one line.
pub fn summary(context: &Context<'_>) -> String {
    let model = context.model();
    let channel = |quantity: &str, unit: &str| format!("{} in {}", plain(quantity), plain(unit));
    let inputs = std::iter::once(&model.input).chain(&model.more_inputs);
    let inputs: Vec<String> = inputs.map(|input| channel(input.quantity, input.unit)).collect();
    let output = channel(model.output.quantity, model.output.unit);
    match &inputs[..] {
        [input] => format!("{input} gives {output}, one sample at a time"),
        _ => format!("{} give {output}, one sample of each at a time", inputs.join(", ")),
    }
}

/// The header's text.
pub fn header(context: &Context<'_>) -> String {
    let model = context.model();
    let (input, output) = (&model.input, &model.output);
    fill(
        include_str!("template/header.h"),
        &[
            ("summary", &summary(context)),
            ("version", env!("CARGO_PKG_VERSION")),
            ("sha256", &sha256(context.blob)),
            ("provenance", &provenance(context)),
            // A double: a step of 0.02 s that was rounded to single precision does not divide a second.
            ("period", &format!("{:?}", model.sample_period_s)),
            ("input_quantity", &plain(input.quantity)),
            ("input_unit", &plain(input.unit)),
            ("input_minimum", &decimal(input.minimum)),
            ("input_maximum", &decimal(input.maximum)),
            ("input_rate", &decimal(model.envelope.maximum_rate)),
            ("output_quantity", &plain(output.quantity)),
            ("output_unit", &plain(output.unit)),
            ("output_minimum", &decimal(output.minimum)),
            ("output_maximum", &decimal(output.maximum)),
            ("inputs", &model.front_end.inputs().to_string()),
            ("more_inputs", &more_inputs(context)),
            ("first_of", if model.more_inputs.is_empty() { "" } else { "first " }),
            ("input_list", &input_list(model)),
            ("input_argument", &input_argument(model)),
            ("delay_line", &front_end::delay_line(&model.front_end).to_string()),
            ("fields", &fields(context)),
            ("name", context.name.identifier()),
            ("NAME", &context.name.upper()),
        ],
    )
}

/// What a step takes.
pub fn input_argument(model: &Model<'_>) -> String {
    match model.front_end.inputs() {
        1 => "float input".to_owned(),
        inputs => format!("const float inputs[{inputs}]"),
    }
}

/// What one sample is, as it stands behind the word.
fn input_list(model: &Model<'_>) -> String {
    let first = plain(model.input.unit);
    match model.more_inputs.is_empty() {
        true => format!(" in {first}"),
        false => {
            let units = model.more_inputs.iter().map(|channel| plain(channel.unit));
            format!(" of each input, in the order above, in {}", std::iter::once(first).chain(units).collect::<Vec<_>>().join(", "))
        }
    }
}

/// The channels of the inputs beside the first.
fn more_inputs(context: &Context<'_>) -> String {
    let mut text = String::new();
    for (index, channel) in context.model().more_inputs.iter().enumerate() {
        let name = format!("{}_INPUT{}", context.name.upper(), index + 2);
        let _ = writeln!(text, "#define {name}_QUANTITY \"{}\"", plain(channel.quantity));
        let _ = writeln!(text, "#define {name}_UNIT \"{}\"", plain(channel.unit));
        let _ = writeln!(text, "#define {name}_MINIMUM {}", decimal(channel.minimum));
        let _ = writeln!(text, "#define {name}_MAXIMUM {}", decimal(channel.maximum));
    }
    text
}

/// Where the model came from and how good it is, as lines of a comment.
fn provenance(context: &Context<'_>) -> String {
    let model = context.model();
    let (origin, metrics, unit) = (&model.provenance, &model.metrics, plain(model.output.unit));
    let known = |text: &str| if text.is_empty() { "unknown".to_owned() } else { plain(text) };
    let mut text = String::new();
    let mut line = |label: &str, value: &str| {
        let _ = writeln!(text, " *   {label:<15}{value}");
    };
    line("model", &sha256(context.blob));
    line("parts", &parts(context));
    line("method", &known(origin.preset));
    line("made by", &known(origin.tool_version));
    line("data", &format!("{} recordings with the SHA-256 {}", origin.training_recordings, known(origin.training_data_sha256)));
    if model.network.is_some() {
        line("training", &format!("seed {}, {} optimiser steps", origin.seed, origin.optimiser_steps));
    }
    line("validation", &format!("RMSE {:e} {unit}, free running", metrics.validation_rmse));
    line(
        "fixed point",
        &format!("RMSE {:e} {unit}, largest {:e} {unit}, against f32", metrics.rmse_f32_vs_fixed, metrics.max_abs_f32_vs_fixed),
    );
    text
}

/// What the model consists of, in words.
fn parts(context: &Context<'_>) -> String {
    let model = context.model();
    let front_end = &model.front_end;
    let mut text = format!("{} play operators, {} creep filters", front_end.play_thresholds.len(), front_end.creep_coefficients.len());
    if let Some(network) = &model.network {
        let activation = Activation::from_code(network.activation_code).unwrap_or(Activation::Tanh);
        let _ = write!(text, ", {}", described(network.layers.iter().map(|layer| (layer.cell, usize::from(layer.units))), activation));
        if let Mode::Window { length } = model.mode {
            let _ = write!(text, " over a window of {length} samples");
        }
    }
    text
}

/// The fields of the state that not every model has.
fn fields(context: &Context<'_>) -> String {
    let model = context.model();
    let mut text = String::new();
    let mut field = |kind: &str, name: &str, size: usize, meaning: &str| {
        let declared = if size > 0 { format!("{kind} {name}[{size}];") } else { format!("{kind} {name};") };
        let _ = writeln!(text, "    {declared:<23} /* {meaning} */");
    };
    let (plays, creeps) = (model.front_end.play_thresholds.len(), model.front_end.creep_coefficients.len());
    if plays > 0 {
        field("float", "plays", plays, "H: play operators");
    }
    if creeps > 0 {
        field("float", "creeps", creeps, "C: creep filters");
    }
    for (name, size, meaning) in model.front_end.stages.iter().flat_map(|stages| stages::fields(stages, plays)) {
        field("float", name, size, meaning);
    }
    let Some(network) = &model.network else { return text };
    for (index, layer) in network.layers.iter().enumerate() {
        let units = usize::from(layer.units);
        if layer.cell.recurrent_rows() > 0 {
            field("int32_t", &format!("cells_{index}"), units, "c: cell states of a layer");
        }
        field("int16_t", &format!("hidden_{index}"), units, "h: hidden states of a layer");
    }
    if let Mode::Window { length } = model.mode {
        let features = model.front_end.features.len();
        let _ = writeln!(text, "    int16_t window[{length}][{features}]; /* the last feature vectors */");
        text.push_str("    uint32_t oldest;        /* slot of the window */\n    bool window_filled;\n");
    }
    text
}
