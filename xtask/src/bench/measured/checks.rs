//! Whether `fit` can be fooled: the same recordings copied, renamed, in other units, with outputs that belong to other inputs, and
//! test outputs that are moved.
//!
//! Each check is a statement about what must not change, or must, when data are distorted in a known way (`measured.py distort`). They
//! run on three development maps: one recording, three, and two dozen.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use super::distort::{FITTED, distort};
use crate::bench::arguments::Arguments;
use crate::bench::arguments::Maps;
use crate::bench::files::{catheter_json, fresh_folder, number, read_json};
use crate::bench::table::markdown;

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

struct Outcome {
    map: &'static str,
    what: &'static str,
    passed: bool,
    seen: String,
}

/// Runs the checks on the maps, whose fits are already there, prints a table and gives the figures.
pub fn measure(bench: &Path, index: &Value, arguments: &Arguments) -> Result<Value> {
    ensure!(arguments.maps != Maps::Reporting, "the checks run on development maps; leave `--maps reporting` or `--checks` out");
    let mut results = Vec::new();
    for map in MAPS {
        eprintln!("checks on {map}");
        let columns = index[map]["columns"].as_str().with_context(|| format!("the index names no columns of {map}"))?;
        let case = Case { bench, map, columns, arguments };
        let several = index[map]["train"].as_array().is_some_and(|recordings| recordings.len() > 1);
        for (what, check) in CHECKS {
            // A single recording has no other one whose outputs it could get.
            if what == UNRELATED && !several {
                continue;
            }
            // A check that cannot be made has failed; the others are made all the same.
            let (passed, seen) = check(&case).unwrap_or_else(|error| (false, format!("{error:#}")));
            results.push(Outcome { map, what, passed, seen });
        }
    }
    let rows = results.iter().map(|check| {
        let verdict = if check.passed { "passed" } else { "FAILED" };
        vec![check.map.to_owned(), check.what.to_owned(), verdict.to_owned(), check.seen.clone()]
    });
    println!("Whether fit can be fooled\n\n{}", markdown(&["map", "check", "verdict", "seen"], &rows.collect::<Vec<_>>()));
    let values = results.iter().map(|check| json!({ "map": check.map, "check": check.what, "passed": check.passed, "seen": check.seen }));
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

/// A map and how to run commands on it.
struct Case<'a> {
    bench: &'a Path,
    map: &'static str,
    columns: &'a str,
    arguments: &'a Arguments,
}

impl Case<'_> {
    /// What the fit to the recordings as they are promises.
    fn plain(&self) -> Result<Promise> {
        Promise::of(&read_json(&self.bench.join(format!("{FITTED}/{}/fit.json", self.map)))?)
    }

    /// Writes distorted recordings; gives their folder and the range of the map's test outputs.
    fn distorted(&self, how: &str) -> Result<(String, f64)> {
        let own = format!("{FITTED}/{}-{how}", self.map);
        fresh_folder(&own)?;
        let range = distort(self.bench, self.map, how, &own, self.arguments)?;
        Ok((own, range))
    }

    /// Fits distorted recordings; gives their folder and what is promised.
    fn fitted(&self, how: &str) -> Result<(String, Promise)> {
        let (own, _) = self.distorted(how)?;
        let line = format!("fit --data {own}/train --columns {} --out {own}/fitted {}", self.columns, self.arguments.fit_options);
        let promise = Promise::of(&catheter_json(self.bench, &format!("{own}/fit"), &line)?)?;
        Ok((own, promise))
    }

    /// Evaluates the model fitted in one folder on the test recordings in another.
    fn evaluated(&self, model: &str, own: &str) -> Result<Value> {
        let line = format!("evaluate --model {model}/fitted/model --data {own}/test --columns {}", self.columns);
        catheter_json(self.bench, &format!("{own}/evaluation"), &line)
    }
}

/// Whether a check passed, and what was seen.
type Verdict = Result<(bool, String)>;
type Check = fn(&Case) -> Verdict;

const UNRELATED: &str = "what cannot be predicted is not promised";
const CHECKS: [(&str, Check); 5] = [
    ("copies do not make the promise better", copied),
    ("names and order decide nothing", renamed),
    ("units decide nothing", scaled),
    (UNRELATED, unrelated),
    ("predictions do not look at test outputs", raised),
];

fn copied(case: &Case) -> Verdict {
    let ratio = case.fitted("copied")?.1.cv_rmse / case.plain()?.cv_rmse;
    Ok((ratio >= COPIED_LEAST, format!("{ratio:.3} of the promised error")))
}

fn renamed(case: &Case) -> Verdict {
    let (plain, (_, renamed)) = (case.plain()?, case.fitted("renamed")?);
    let ratio = renamed.cv_rmse / plain.cv_rmse;
    Ok(((ratio - 1.0).abs() <= RENAMED_WITHIN, format!("{ratio:.3}, {} and {}", plain.chosen, renamed.chosen)))
}

fn scaled(case: &Case) -> Verdict {
    let (plain, (_, scaled)) = (case.plain()?, case.fitted("scaled")?);
    let ratio = scaled.cv_rmse / plain.cv_rmse / 1000.0;
    let passed = (ratio - 1.0).abs() <= SCALED_WITHIN && scaled.chosen == plain.chosen;
    Ok((passed, format!("{ratio:.4}, {} and {}", plain.chosen, scaled.chosen)))
}

fn unrelated(case: &Case) -> Verdict {
    let (own, promise) = case.fitted("unrelated")?;
    let met = number(&case.evaluated(&own, &own)?, "mean_rmse")?;
    let Some(high) = promise.high else { return Ok((false, "no interval".to_owned())) };
    let ratio = met / high;
    Ok((ratio <= UNRELATED_MOST, format!("met {ratio:.2} of the interval's end with {}", promise.chosen)))
}

/// Moves all test outputs by a constant: the mean errors must move by exactly as much.
fn raised(case: &Case) -> Verdict {
    let (own, shift) = case.distorted("raised")?;
    let plain_folder = format!("{FITTED}/{}", case.map);
    let moved = mean_errors(&case.evaluated(&plain_folder, &own)?)?;
    let plain = mean_errors(&read_json(&case.bench.join(&plain_folder).join("evaluation.json"))?)?;
    let worst = plain.iter().zip(&moved).map(|(plain, moved)| ((plain - moved) / shift - 1.0).abs()).fold(0.0, f64::max);
    Ok((plain.len() == moved.len() && worst <= RAISED_WITHIN, format!("off by {worst:.1e} of the shift")))
}

fn mean_errors(evaluated: &Value) -> Result<Vec<f64>> {
    let files = evaluated["files"].as_array().context("evaluate names no files")?;
    files.iter().map(|file| number(file, "mean_error")).collect()
}
