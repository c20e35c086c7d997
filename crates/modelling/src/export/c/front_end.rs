//! The physics part in C.

use firmware::estimator::{MAX_NORMALISED, MAX_READOUT};
use model_export::schema::{Channel, Feature, FeatureSource, FrontEnd, Growth};

use super::curve::curve;
use super::literal::{constant, float, floats, operand};
use super::stages;
use super::template::{Context, fill};

/// Constants and functions of the front end.
pub fn source(context: &Context<'_>) -> String {
    let front_end = &context.model().front_end;
    let bend = curve(front_end.curve.as_ref(), "Curve of the readout", "bend");
    let parts = [delay(context), stages::source(context), plays(front_end), creeps(front_end), bend, quantiser(context), step(context)];
    parts.concat()
}

/// Whole samples of the dead time, and the fraction on top.
pub fn split(dead_time_samples: f32) -> (usize, f32) {
    // As the firmware does it: exact, since the dead time is short.
    let (mut whole, mut fraction) = (0, dead_time_samples);
    while fraction >= 1.0 {
        whole += 1;
        fraction -= 1.0;
    }
    (whole, fraction)
}

/// Slots of the delay line: the newest sample, the whole delay, and the older neighbour; or as far back as a feature sees.
pub fn delay_line(front_end: &FrontEnd) -> usize {
    let ages =
        front_end.features.iter().map(|feature| if let FeatureSource::Past(age) = feature.source { usize::from(age) + 1 } else { 0 });
    ages.fold(split(front_end.dead_time_samples).0 + 2, usize::max)
}

fn delay(context: &Context<'_>) -> String {
    let front_end = &context.model().front_end;
    let (whole, fraction) = split(front_end.dead_time_samples);
    fill(
        include_str!("template/delay.c"),
        &[
            ("dead_time", &format!("{:?}", front_end.dead_time_samples)),
            ("whole", &whole.to_string()),
            ("line", &delay_line(front_end).to_string()),
            ("fraction", &constant(fraction)),
            ("name", context.name.identifier()),
        ],
    )
}

fn plays(front_end: &FrontEnd) -> String {
    if front_end.play_thresholds.is_empty() {
        return String::new();
    }
    let list: String = front_end.play_inputs.iter().map(|input| format!("    {input}u,\n")).collect();
    let inputs = match front_end.play_inputs.is_empty() {
        true => String::new(),
        false => format!("/* Which input each of them follows. */\nstatic const uint32_t PLAY_INPUTS[PLAYS] = {{\n{list}}};\n"),
    };
    let step = if growth(front_end).is_some() { "" } else { include_str!("template/play_step.c") };
    let lists = fill(
        include_str!("template/play.c"),
        &[
            ("plays", &front_end.play_thresholds.len().to_string()),
            ("thresholds", &floats(&front_end.play_thresholds)),
            ("weights", &floats(&front_end.play_weights)),
            ("inputs", &inputs),
        ],
    );
    lists + step
}

fn growth(front_end: &FrontEnd) -> Option<&Growth> {
    stages::growth(front_end.stages.as_ref()?, front_end.play_thresholds.len())
}

fn creeps(front_end: &FrontEnd) -> String {
    if front_end.creep_coefficients.is_empty() {
        return String::new();
    }
    fill(
        include_str!("template/creep.c"),
        &[
            ("creeps", &front_end.creep_coefficients.len().to_string()),
            ("coefficients", &floats(&front_end.creep_coefficients)),
            ("weights", &floats(&front_end.creep_weights)),
        ],
    )
}

fn quantiser(context: &Context<'_>) -> String {
    match &context.model().network {
        Some(_) => format!("\n#define FEATURES {}u\n{}", context.model().front_end.features.len(), include_str!("template/feature.c")),
        None => String::new(),
    }
}

fn step(context: &Context<'_>) -> String {
    let (model, front_end) = (context.model(), &context.model().front_end);
    // Without a network nobody sees the features.
    let features: &[Feature] = if model.network.is_some() { &front_end.features } else { &[] };
    let sees = |source| features.iter().any(|feature| feature.source == source);
    let lags = front_end.lag_coefficient < 1.0;
    let channels = || std::iter::once(&model.input).chain(&model.more_inputs);
    let of_channels = |value: fn(&Channel<'_>) -> f32| floats(&channels().map(value).collect::<Vec<f32>>());
    let rest = |channel: &Channel<'_>| ((channel.minimum - channel.offset) / channel.scale).clamp(-MAX_NORMALISED, MAX_NORMALISED);
    let weights: Vec<f32> = std::iter::once(front_end.input_weight).chain(front_end.more_input_weights.iter().copied()).collect();

    let (mut last_values, mut keep_last) = (String::new(), String::new());
    if sees(FeatureSource::InputDifference) {
        last_values.push_str("    float last_inputs[INPUTS];\n");
        keep_last.push_str("        last_inputs[input] = first ? value : state->inputs[input];\n");
    }
    let keeps_path = lags || sees(FeatureSource::PathDifference) || growth(front_end).is_some();
    if keeps_path {
        last_values.push_str("    float last_paths[INPUTS];\n");
        keep_last.push_str("        last_paths[input] = first ? value : state->paths[input];\n");
    }
    let feature_lines: String = features.iter().enumerate().map(|(index, feature)| feature_line(front_end, index, feature)).collect();
    let play_input = if front_end.play_inputs.is_empty() { "0" } else { "PLAY_INPUTS[index]" };
    let plays = match growth(front_end) {
        Some(growth) => stages::step_growing_plays(growth),
        None => fill(include_str!("template/step_plays.c"), &[("play_input", play_input)]),
    };
    let staged = front_end.stages.as_ref();
    let mut readout = if front_end.curve.is_some() { "bend(linear)" } else { "linear" }.to_owned();
    if staged.is_some_and(|stages| stages.tip.is_some()) {
        let (low, high) = (operand(-MAX_READOUT), float(MAX_READOUT));
        readout = format!("filter(TIP_MOMENTUM, TIP_GAINS, state->tip, between({readout}, {low}, {high}), first)");
    }
    let path = match (staged.is_some(), lags) {
        (true, _) => "lead(state, delayed, first)",
        (false, true) => "first ? delayed : (last_paths[input] + product(LAG, delayed - last_paths[input]))",
        (false, false) => "delayed",
    };
    let settle = if staged.is_some() && keeps_path { include_str!("template/settle.c") } else { "" };
    fill(
        include_str!("template/front_end.c"),
        &[
            ("inputs", &weights.len().to_string()),
            ("input_offsets", &of_channels(|channel| channel.offset)),
            ("input_scales", &of_channels(|channel| channel.scale)),
            ("most_normalised", &constant(MAX_NORMALISED)),
            ("rests", &of_channels(rest)),
            (
                "lag_constant",
                &if lags { format!("static const float LAG = {}\n", constant(front_end.lag_coefficient)) } else { String::new() },
            ),
            ("bias", &constant(front_end.bias)),
            ("input_weights", &floats(&weights)),
            ("and_features", if features.is_empty() { "" } else { ", and the network's features" }),
            ("features_argument", if features.is_empty() { "" } else { ", int16_t *features" }),
            ("last_values", &last_values),
            ("keep_last", &keep_last),
            ("more_paths", if weights.len() > 1 { include_str!("template/more_paths.c") } else { "" }),
            ("path", path),
            ("settle", settle),
            ("lead", &stages::lead(context)),
            ("start_plays", if front_end.play_thresholds.is_empty() { "" } else { include_str!("template/start_plays.c") }),
            ("plays", if front_end.play_thresholds.is_empty() { "" } else { &plays }),
            ("creeps", if front_end.creep_coefficients.is_empty() { "" } else { include_str!("template/step_creeps.c") }),
            ("readout", &readout),
            ("features", &feature_lines),
            ("name", context.name.identifier()),
        ],
    )
}

/// `feature = (signal - offset) * gain`.
fn feature_line(front_end: &FrontEnd, index: usize, feature: &Feature) -> String {
    let input = front_end.feature_input(index);
    // Counted from one, as the columns of recordings are; a single one needs no number.
    let of = if front_end.inputs() > 1 { format!(" of input {}", input + 1) } else { String::new() };
    let (signal, meaning) = match feature.source {
        FeatureSource::Input => (format!("state->inputs[{input}]"), format!("u{of}")),
        FeatureSource::InputDifference => (format!("(state->inputs[{input}] - last_inputs[{input}])"), format!("change of u{of}")),
        FeatureSource::Path => (format!("state->paths[{input}]"), format!("v{of}")),
        FeatureSource::PathDifference => (format!("(state->paths[{input}] - last_paths[{input}])"), format!("change of v{of}")),
        FeatureSource::Play(play) => (format!("state->plays[{play}]"), format!("play {play}")),
        FeatureSource::Stop(play) => {
            let path = front_end.play_input(usize::from(play));
            (format!("((state->paths[{path}] - state->plays[{play}]) / PLAY_THRESHOLDS[{play}])"), format!("stop {play}: (v - H) / r"))
        }
        FeatureSource::Readout => ("readout".to_owned(), "L".to_owned()),
        FeatureSource::Creep(creep) => (format!("state->creeps[{creep}]"), format!("creep filter {creep}")),
        FeatureSource::Past(age) => {
            (format!("state->delay_line[{input}][(state->newest + {age}u) % DELAY_LINE]"), format!("u{of}, {age} samples ago"))
        }
    };
    let (offset, gain) = (operand(feature.offset), float(feature.gain));
    format!("    features[{index}] = quantise(product({signal} - {offset}, {gain})); /* {meaning} */\n")
}
