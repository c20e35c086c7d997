//! Whether `fit` can be fooled: the same recordings copied, renamed, in other units, with outputs that belong to other inputs, and
//! test outputs that are moved.
//!
//! Each check is a statement about what must not change, or must, when data are distorted in a known way (`measured.py distort`). They
//! run on three development maps: one recording, three, and two dozen.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use super::Maps;
use super::fit::{FITTED, distort};
use crate::bench::table::markdown;
use crate::bench::{Arguments, catheter_json, fresh_folder, number, read_json};

const MAPS: [&str; 3] = ["piezo", "ventilator-other-lung1", "pam-joint1-next"];
/// A copy of every recording may not make the promised error smaller than this share: folds fall differently, nothing else.
const COPIED_LEAST: f64 = 0.9;
/// Other file names let the folds fall differently.
const RENAMED_WITHIN: f64 = 0.2;
/// Other units change nothing but the rounding of the prepared files, nine digits.
const SCALED_WITHIN: f64 = 0.01;
/// Where inputs explain nothing, the error met may exceed the promised interval by chance alone.
const UNRELATED_MOST: f64 = 1.2;
/// Rounding of the prepared files and of the answer, as a share of the shift.
const RAISED_WITHIN: f64 = 1e-6;

struct Check {
    map: &'static str,
    what: &'static str,
    passed: bool,
    seen: String,
}

/// Runs the checks on the maps, whose fits are already there, prints a table and gives the figures.
pub fn measure(bench: &Path, index: &Value, arguments: &Arguments) -> Result<Value> {
    ensure!(arguments.maps != Maps::Reporting, "the checks run on development maps; leave `--maps reporting` or `--checks` out");
    let mut checks = Vec::new();
    for map in MAPS {
        eprintln!("checks on {map}");
        let columns = index[map]["columns"].as_str().with_context(|| format!("the index names no columns of {map}"))?;
        let outcome = one_map(bench, map, columns, arguments);
        checks.extend(outcome.unwrap_or_else(|error| vec![Check { map, what: "all", passed: false, seen: format!("failed: {error:#}") }]));
    }
    let rows = checks.iter().map(|check| {
        let verdict = if check.passed { "passed" } else { "FAILED" };
        vec![check.map.to_owned(), check.what.to_owned(), verdict.to_owned(), check.seen.clone()]
    });
    println!("Whether fit can be fooled\n\n{}", markdown(&["map", "check", "verdict", "seen"], &rows.collect::<Vec<_>>()));
    let values = checks.iter().map(|check| json!({ "map": check.map, "check": check.what, "passed": check.passed, "seen": check.seen }));
    Ok(Value::Array(values.collect()))
}

/// What a fit promises.
struct Promise {
    chosen: String,
    cv_rmse: f64,
    high: Option<f64>,
}

impl Promise {
    fn of(fitted: &Value) -> Result<Self> {
        let chosen = fitted["chosen"].as_str().context("fit names no `chosen` rung")?;
        let rung = fitted["ladder"].as_array().and_then(|rungs| rungs.iter().find(|rung| rung["name"] == chosen));
        let rung = rung.with_context(|| format!("the chosen rung `{chosen}` is not in the ladder"))?;
        Ok(Self { chosen: chosen.to_owned(), cv_rmse: number(rung, "cv_rmse")?, high: rung["cv_interval"][1].as_f64() })
    }
}

fn one_map(bench: &Path, map: &'static str, columns: &str, arguments: &Arguments) -> Result<Vec<Check>> {
    let plain = Promise::of(&read_json(&bench.join(format!("{FITTED}/{map}/fit.json")))?)?;
    let fit = |how: &str| -> Result<(String, Promise)> {
        let own = format!("{FITTED}/{map}-{how}");
        fresh_folder(&own)?;
        distort(bench, map, how, &own, arguments)?;
        let line = format!("fit --data {own}/train --columns {columns} --out {own}/fitted {}", arguments.fit_options);
        Ok((own.clone(), Promise::of(&catheter_json(bench, &format!("{own}/fit"), &line)?)?))
    };
    let check = |what, passed, seen| Check { map, what, passed, seen };
    let mut checks = Vec::new();

    let (_, copied) = fit("copied")?;
    let ratio = copied.cv_rmse / plain.cv_rmse;
    checks.push(check("copies do not make the promise better", ratio >= COPIED_LEAST, format!("{ratio:.3} of the promised error")));

    let (_, renamed) = fit("renamed")?;
    let ratio = renamed.cv_rmse / plain.cv_rmse;
    let passed = (ratio - 1.0).abs() <= RENAMED_WITHIN;
    checks.push(check("names and order decide nothing", passed, format!("{ratio:.3}, {} and {}", plain.chosen, renamed.chosen)));

    let (_, scaled) = fit("scaled")?;
    let ratio = scaled.cv_rmse / plain.cv_rmse / 1000.0;
    let passed = (ratio - 1.0).abs() <= SCALED_WITHIN && scaled.chosen == plain.chosen;
    checks.push(check("units decide nothing", passed, format!("{ratio:.4}, {} and {}", plain.chosen, scaled.chosen)));

    let (own, unrelated) = fit("unrelated")?;
    let line = format!("evaluate --model {own}/fitted/model --data {own}/test --columns {columns}");
    let evaluated = catheter_json(bench, &format!("{own}/evaluation"), &line)?;
    let met = number(&evaluated, "mean_rmse")?;
    let ratio = unrelated.high.map(|high| met / high);
    let seen = ratio.map_or("no interval".to_owned(), |ratio| format!("met {ratio:.2} of the interval's end with {}", unrelated.chosen));
    checks.push(check("what cannot be predicted is not promised", ratio.is_some_and(|ratio| ratio <= UNRELATED_MOST), seen));

    checks.push(predictions_stay(bench, map, columns, arguments)?);
    Ok(checks)
}

/// Moves all test outputs by a constant: the mean error must move by exactly as much.
fn predictions_stay(bench: &Path, map: &'static str, columns: &str, arguments: &Arguments) -> Result<Check> {
    let own = format!("{FITTED}/{map}-raised");
    fresh_folder(&own)?;
    let shift = distort(bench, map, "raised", &own, arguments)?;
    let line = format!("evaluate --model {FITTED}/{map}/fitted/model --data {own}/test --columns {columns}");
    let moved = catheter_json(bench, &format!("{own}/evaluation"), &line)?;
    let plain = read_json(&bench.join(format!("{FITTED}/{map}/evaluation.json")))?;
    let (moved, plain) = (mean_errors(&moved)?, mean_errors(&plain)?);
    let worst = plain.iter().zip(&moved).map(|(plain, moved)| ((plain - moved) / shift - 1.0).abs()).fold(0.0, f64::max);
    let passed = plain.len() == moved.len() && worst <= RAISED_WITHIN;
    Ok(Check { map, what: "predictions do not look at test outputs", passed, seen: format!("off by {worst:.1e} of the shift") })
}

fn mean_errors(evaluated: &Value) -> Result<Vec<f64>> {
    let files = evaluated["files"].as_array().context("evaluate names no files")?;
    files.iter().map(|file| number(file, "mean_error")).collect()
}
