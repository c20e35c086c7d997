//! Time to an error: how long training a 2x64 LSTM takes until the test families a to d are predicted to within a target, beside PyTorch.
//!
//! Both sides train on all recordings of the rich set; the error is pooled over the test recordings, free running from their start. The
//! settings of each were tried on another seed (see the constants). Ours counts everything, theirs only the steps of its optimiser.
//! Both run one after the other on one thread, and processor time counts: another load of the machine falls on neither.

use std::time::Duration;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::arguments::{Arguments, FIRST_REPORTING_SEED};
use super::files::{catheter, fresh_folder, number};
use super::table::markdown;
use crate::process::{answer, answer_within, command, root, run, target_folder};

/// Processor time that our training plans with, in s: the schedule's length.
const BUDGET_CPU_S: u64 = 240;
/// Steps and peak learning rate of Adam: the schedule's length, three times the processor time of ours at that budget, and height; 2e-3 was
/// slower.
const ADAM_STEPS: u64 = 40_000;
const ADAM_LEARNING_RATE: f64 = 5e-3;
/// Longest run of a side.
const LONGEST: Duration = Duration::from_secs(3600);

/// Measures both sides, seed by seed, and prints the table.
pub fn measure(arguments: &Arguments) -> Result<Value> {
    let version = answer(command(&arguments.python).args(["-c", "import torch; print(torch.__version__)"]));
    if version.is_none() {
        eprintln!("PyTorch is left out: {} cannot import torch", arguments.python);
    }
    let folder = fresh_folder("time-to-error")?;
    // Error on the test recordings, free running.
    let target_mm = arguments.target_mm;
    let (mut rows, mut seeds) = (Vec::new(), Vec::new());
    for seed in FIRST_REPORTING_SEED..FIRST_REPORTING_SEED + arguments.seeds {
        run("simulate", &mut catheter(&folder, &format!("simulate rich --out {seed} --seed {seed}")))?;
        let data = folder.join(seed.to_string());
        let (training, test) = (data.join("train"), data.join("test"));
        let budget = arguments.budget_cpu_s.unwrap_or(BUDGET_CPU_S);
        let mut ours = command(target_folder().join("release/examples/time_to_error"));
        ours.arg(&training).arg(&test).args([target_mm.to_string(), seed.to_string(), "1".to_owned(), budget.to_string()]);
        let ours = one(&mut ours)?;
        let theirs = if version.is_some() {
            let mut theirs = command(&arguments.python);
            theirs.arg(root().join("xtask/pytorch_time_to_error.py")).arg(&training).arg(&test);
            theirs.args(["--target-mm", &target_mm.to_string(), "--seed", &seed.to_string(), "--threads", "1"]);
            theirs.args([
                "--steps",
                &(ADAM_STEPS * budget / BUDGET_CPU_S).max(1).to_string(),
                "--learning-rate",
                &ADAM_LEARNING_RATE.to_string(),
            ]);
            Some(one(&mut theirs)?)
        } else {
            None
        };
        let ratio = theirs.as_ref().and_then(|theirs| Some(time(theirs)?.0 / time(&ours)?.0));
        let shown = |side: Option<&Value>| side.map_or("-".to_owned(), shown);
        rows.push(vec![
            seed.to_string(),
            shown(Some(&ours)),
            shown(theirs.as_ref()),
            ratio.map_or("-".to_owned(), |ratio| format!("{ratio:.1}")),
        ]);
        seeds.push(json!({ "seed": seed, "catheter": ours, "pytorch": theirs, "ratio": ratio }));
    }
    println!(
        "Time to {target_mm} mm on the test families, 2x64, rich set, one thread (PyTorch {})\n",
        version.as_deref().map_or("-", str::trim)
    );
    println!("{}", markdown(&["seed", "catheter", "PyTorch, Adam", "ratio of processor times"], &rows));
    Ok(json!({ "target_mm": target_mm, "pytorch": version.map(|text| text.trim().to_owned()), "seeds": seeds }))
}

/// Runs one side, which prints a line of JSON.
fn one(command: &mut std::process::Command) -> Result<Value> {
    let text = answer_within(LONGEST, command)?;
    serde_json::from_str(text.trim()).with_context(|| format!("no line of JSON: {text}"))
}

/// Processor and wall time to the target; nothing where it was not reached.
fn time(side: &Value) -> Option<(f64, f64)> {
    Some((number(&side["reached"], "cpu_s").ok()?, number(&side["reached"], "wall_s").ok()?))
}

/// Both times, or how far it came.
fn shown(side: &Value) -> String {
    match time(side) {
        Some((cpu_s, wall_s)) => format!("{cpu_s:.0} CPU-s ({wall_s:.0} s)"),
        None => {
            let errors = side["history"].as_array().into_iter().flatten().filter_map(|one| one["rmse_mm"].as_f64());
            format!("not reached: {:.4} mm", errors.fold(f64::INFINITY, f64::min))
        }
    }
}
