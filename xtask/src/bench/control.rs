//! The figures of the controllers on the realistic rig, side by side in one run, with their targets.

use anyhow::{Context, Result};
use serde_json::Value;

use super::arguments::{Arguments, FIRST_REPORTING_SEED};
use super::files::{catheter_json, fresh_folder, number};
use super::table::markdown;

/// Figure, what it is, target, and whether the target is a least or a most.
const FIGURES: [(&str, &str, f64, bool); 10] = [
    ("feed_forward_gain", "physics inverse without laser against open loop, moving references", 0.85, true),
    ("feedback_gain", "physics inverse with laser against the best PID alone, 0.2 to 0.8 Hz", 0.60, true),
    ("point_to_point_gain", "random point-to-point, sensorless against open loop", 0.75, true),
    ("estimate_rmse_share", "sensorless estimate over an hour, RMSE / stroke", 0.01, false),
    ("estimate_drift_share", "its drift from the first to the last six minutes / stroke", 0.01, false),
    ("laser_lost_share", "laser lost in mid-motion, tip within a second / stroke", 0.01, false),
    ("laser_lost_slew_share", "fastest output in that second / slew limit", 0.99, false),
    ("learned.feed_forward_gain", "learned inverse without laser against open loop, moving references", 0.85, true),
    ("learned.point_to_point_gain", "random point-to-point, sensorless on a network's estimate against open loop", 0.75, true),
    ("learned.estimate_rmse_share", "that estimate, RMSE / stroke", 0.01, false),
];

/// Runs the controllers and prints one table; every seed is a rig of its own.
pub fn measure(arguments: &Arguments) -> Result<Value> {
    let folder = fresh_folder("control")?;
    let line = format!("bench control --seed {FIRST_REPORTING_SEED} --seeds {}", arguments.seeds);
    let table = catheter_json(&folder, "control", &line)?;
    let mut rows = Vec::new();
    for (key, what, target, least) in FIGURES {
        let value = key.split_once('.').map_or_else(|| number(&table, key), |(part, key)| number(&table[part], key))?;
        let met = if least { value >= target } else { value <= target };
        let bound = if least { "at least" } else { "at most" };
        rows.push(vec![
            what.to_owned(),
            format!("{:.1} %", 100.0 * value),
            format!("{bound} {:.0} %", 100.0 * target),
            if met { "met" } else { "not met" }.to_owned(),
        ]);
    }
    println!("Controllers on the realistic rig, {} rig(s), references used nowhere else\n", arguments.seeds);
    println!("{}", markdown(&["figure", "measured", "target", ""], &rows));
    let ticks = |key: &str| number(&table, key);
    println!(
        "Ticks at a limit in that second, of all rigs: {}; in the same second with the laser: {}\n",
        ticks("laser_lost_limited_ticks")?,
        ticks("laser_kept_limited_ticks")?
    );
    println!("Tracking RMSE in mm, mean over the rigs\n");
    println!("{}", by_controller(&table)?);
    Ok(table)
}

/// One row a controller, one column a reference.
fn by_controller(table: &Value) -> Result<String> {
    let rows = table["rows"].as_array().context("the bench gave no rows")?;
    let distinct = |key: &str| {
        let mut names: Vec<&str> = Vec::new();
        for name in rows.iter().filter_map(|row| row[key].as_str()) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    };
    let (references, controllers) = (distinct("reference"), distinct("controller"));
    let mean = |controller: &str, reference: &str| {
        let of = rows.iter().filter(|row| row["controller"] == controller && row["reference"] == reference);
        let errors: Vec<f64> = of.filter_map(|row| row["rmse_mm"].as_f64()).collect();
        format!("{:.3}", errors.iter().sum::<f64>() / errors.len().max(1) as f64)
    };
    let line = |controller: &&str| {
        std::iter::once((*controller).to_owned()).chain(references.iter().map(|reference| mean(controller, reference))).collect()
    };
    let header: Vec<&str> = std::iter::once("controller").chain(references.iter().copied()).collect();
    Ok(markdown(&header, &controllers.iter().map(line).collect::<Vec<_>>()))
}
