//! The further stages of the physics part in C.

use model_export::schema::{Filter, Growth, Stages};

use super::curve::curve;
use super::literal::{constant, floats};
use super::template::{Context, fill};

/// Constants and functions of the stages; nothing without any. The function `lead` needs those of the front end's opening.
pub fn source(context: &Context<'_>) -> String {
    let front_end = &context.model().front_end;
    let Some(stages) = &front_end.stages else { return String::new() };
    let mut text = include_str!("template/between.c").to_owned();
    if stages.line.is_some() || stages.tip.is_some() {
        text.push_str(include_str!("template/filter.c"));
    }
    text.push_str(&curve(stages.supply.as_ref(), "What the supply gives", "supply"));
    text.push_str(&curve(stages.muscle.as_ref(), "What the muscle makes of its pressure", "muscle"));
    if let Some(flow) = &stages.flow {
        text.push_str(&curve(Some(&flow.fill), "By how much the path rises in a sample, of what is missing", "fill"));
        text.push_str(&curve(Some(&flow.vent), "By how much it falls, of what is too much", "vent"));
    }
    if let Some(growth) = growth(stages, front_end.play_thresholds.len()) {
        text.push_str(&curve(Some(&growth.law), "What thresholds grow with at a size of the path's step", "growth_law"));
        text.push_str(&curve(growth.follow.as_ref(), "How far operators go to their bounds in a sample", "follow"));
        text.push_str(&growth_constants(growth));
    }
    if let Some(tip) = &stages.tip {
        text.push_str(&filter_constants("TIP", "What swings or lags behind the operators", tip));
    }
    text
}

/// The function `lead`; it stands behind the constants of the front end.
pub fn lead(context: &Context<'_>) -> String {
    let Some(stages) = &context.model().front_end.stages else { return String::new() };
    let (mut constants, mut body) = (String::new(), String::new());
    if stages.flow.is_some() {
        body.push_str(include_str!("template/flow.c"));
    }
    if let Some(line) = &stages.line {
        constants.push_str(&filter_constants("LINE", "What swings in the line", line));
        body.push_str("    path = filter(LINE_MOMENTUM, LINE_GAINS, state->line, path, first);\n");
    }
    if body.is_empty() {
        body.push_str("    (void)state;\n    (void)first;\n");
    }
    fill(
        include_str!("template/stages.c"),
        &[
            ("constants", &constants),
            ("supply", if stages.supply.is_some() { "supply(delayed)" } else { "delayed" }),
            ("stages", &body),
            ("muscle", if stages.muscle.is_some() { "muscle(path)" } else { "path" }),
            ("name", context.name.identifier()),
        ],
    )
}

/// The growth of thresholds, where there are any.
pub fn growth(stages: &Stages, plays: usize) -> Option<&Growth> {
    stages.growth.as_ref().filter(|_| plays > 0)
}

/// The step of operators whose thresholds grow.
pub fn step_growing_plays(growth: &Growth) -> String {
    let follow = match growth.follow {
        None => "\n            state->plays[index] = bound;\n",
        Some(_) => include_str!("template/follow.c"),
    };
    fill(include_str!("template/step_growing_plays.c"), &[("follow", follow)])
}

/// Names and lengths of what the stages remember, with what they are.
pub fn fields(stages: &Stages, plays: usize) -> Vec<(&'static str, usize, &'static str)> {
    let mut fields = Vec::new();
    if stages.flow.is_some() {
        fields.push(("flowed", 0, "w: filled and vented"));
    }
    if stages.line.is_some() {
        fields.push(("line", 4, "outputs and inputs of the line"));
    }
    if growth(stages, plays).is_some() {
        fields.push(("step_size", 0, "m: size of the path's steps"));
    }
    if stages.tip.is_some() {
        fields.push(("tip", 4, "outputs and inputs of the tip"));
    }
    fields
}

fn filter_constants(name: &str, meaning: &str, filter: &Filter) -> String {
    let gains = floats(&filter.gains);
    format!(
        "\n/* {meaning}. */\nstatic const float {name}_MOMENTUM = {}\nstatic const float {name}_GAINS[3] = {{\n{gains}}};\n",
        constant(filter.momentum)
    )
}

fn growth_constants(growth: &Growth) -> String {
    let [rising, falling] = growth.per_path.map(constant);
    fill(
        include_str!("template/growth.c"),
        &[
            ("rising", &rising),
            ("falling", &falling),
            ("apart", &floats(&growth.apart)),
            ("share", &constant(growth.share)),
            ("extra", &constant(growth.extra)),
            ("fading", &constant(growth.fading)),
        ],
    )
}
