//! The recorded figures: `tests/snapshots/firmware.json`, which a change for the worse breaks and `cargo xtask bench firmware --bless` renews.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde_json::{Value, json};

use crate::figures::{Cost, TickCost, worst_tick};

/// Where the record lies.
#[must_use]
pub fn path() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("snapshots/firmware.json")
}

/// The figures by name, as they are recorded.
#[must_use]
pub fn record(costs: &[Cost], ticks: &[TickCost]) -> Value {
    let steps: BTreeMap<&str, u32> = costs.iter().map(|cost| (cost.name, cost.packed[1])).collect();
    let portable: BTreeMap<&str, u32> = costs.iter().map(|cost| (cost.name, cost.portable)).collect();
    let tick = json!({ "worst": worst_tick(ticks) });
    json!({ "instructions_per_step": steps, "instructions_per_step_portable_kernel": portable, "instructions_per_tick": tick })
}

/// The figures that differ from the record by more than compiled code does from one compiler to the next: a hundredth more (a sixth for the
/// tick, in which every module of the firmware has its part), or so much less that the record should be renewed.
#[must_use]
pub fn differences(recorded: &Value, measured: &Value) -> Vec<String> {
    const LESS: f64 = 0.95;
    let mut differences = Vec::new();
    let empty = serde_json::Map::new();
    for (group, figures) in measured.as_object().unwrap_or(&empty) {
        let more = if group == "instructions_per_tick" { 7.0 / 6.0 } else { 1.01 };
        for (name, figure) in figures.as_object().unwrap_or(&empty) {
            let (figure, known) = (figure.as_f64(), recorded[group][name].as_f64());
            let ratio = figure.zip(known).map(|(figure, known)| figure / known);
            if !ratio.is_some_and(|ratio| (LESS..=more).contains(&ratio)) {
                let text = |value: Option<f64>| value.map_or("nothing".to_owned(), |value| value.to_string());
                differences.push(format!("{group} {name}: {} counted, {} recorded", text(figure), text(known)));
            }
        }
    }
    differences
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hundredth_more_or_a_twentieth_less_is_a_difference_and_so_is_a_new_figure() {
        let recorded = json!({ "steps": { "a": 10_000, "b": 10_000, "c": 10_000, "d": 10_000 } });
        let measured = json!({ "steps": { "a": 10_099, "b": 10_101, "c": 9_501, "d": 9_499, "e": 1 } });
        let differences = differences(&recorded, &measured);
        let names: Vec<&str> = differences.iter().filter_map(|line| line.split([' ', ':']).nth(1)).collect();
        assert_eq!(names, ["b", "d", "e"]);
    }
}
