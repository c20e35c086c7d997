//! Training throughput of the 2x64 LSTM beside PyTorch's, both measured now, on this machine, in turns.
//!
//! One weight counts three multiply-accumulates a step and lane: forward, gradient to the layer below or the step before, gradient of
//! the weight. The Python side does the same work (forward, backward, Adam) and counts the same way.

use std::collections::BTreeMap;
use std::time::Duration;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::table::markdown;
use crate::process::{answer_within, command, root, target_folder};

/// Each side is measured this often, in turns, so that a passing load of the machine does not fall on one side alone.
const ROUNDS: usize = 3;

/// Best throughput in MAC/s and the threads it was reached with, by batch size and steps.
type Best = BTreeMap<(u64, u64), (f64, u64)>;

/// Measures both sides and prints the table.
pub fn measure() -> Result<Value> {
    let mut ours = Best::new();
    let mut theirs = Best::new();
    let python = crate::process::answer(command("python3").args(["-c", "import torch; print(torch.__version__)"]));
    if python.is_none() {
        eprintln!("PyTorch is left out: python3 cannot import torch");
    }
    for _ in 0..ROUNDS {
        keep_best(&mut ours, &mut command(target_folder().join("release/examples/training_throughput")))?;
        if python.is_some() {
            keep_best(&mut theirs, command("python3").arg(root().join("xtask/pytorch_throughput.py")))?;
        }
    }
    let mut rows = Vec::new();
    let mut shapes = Vec::new();
    for (&(batch, steps), &(rate, threads)) in &ours {
        let other = theirs.get(&(batch, steps));
        rows.push(vec![
            format!("2x64 tanh, batch {batch} x {steps} steps"),
            format!("{:.1} ({threads} threads)", rate / 1e9),
            other.map_or("-".to_owned(), |(rate, threads)| format!("{:.1} ({threads} threads)", rate / 1e9)),
            other.map_or("-".to_owned(), |(other, _)| format!("{:.2}", rate / other)),
        ]);
        shapes.push(json!({
            "batch": batch, "steps": steps, "macs_per_second": rate, "threads": threads,
            "pytorch_macs_per_second": other.map(|(rate, _)| rate), "pytorch_threads": other.map(|(_, threads)| threads),
            "ratio": other.map(|(other, _)| rate / other),
        }));
    }
    let version = python.as_deref().map_or("-", str::trim);
    println!("Training throughput, GMAC/s, best thread setting of each (PyTorch {version})\n");
    println!("{}", markdown(&["training", "catheter", "PyTorch", "ratio"], &rows));
    Ok(json!({ "pytorch": python.map(|text| text.trim().to_owned()), "shapes": shapes }))
}

/// Runs one side, which prints a line of JSON per shape and thread count, and keeps the best of each shape.
fn keep_best(best: &mut Best, command: &mut std::process::Command) -> Result<()> {
    for line in answer_within(Duration::from_secs(600), command)?.lines() {
        let value: Value = serde_json::from_str(line).with_context(|| format!("no line of JSON: {line}"))?;
        if value["activation"] != "tanh" {
            continue; // PyTorch's LSTM knows no other
        }
        let whole = |key: &str| value[key].as_u64().with_context(|| format!("`{key}` is missing in {line}"));
        let shape = (whole("batch")?, whole("steps")?);
        let found = (super::files::number(&value, "macs_per_second")?, whole("threads")?);
        best.entry(shape)
            .and_modify(|best| {
                if found.0 > best.0 {
                    *best = found
                }
            })
            .or_insert(found);
    }
    Ok(())
}
