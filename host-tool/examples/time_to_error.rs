//! How long training takes to an error: a streaming 2x64 LSTM on a folder of recordings, free running on those that validate.
//!
//! `cargo run --release -p host-tool --example time_to_error -- FOLDER TARGET_MM SEED THREADS BUDGET_CPU_S`; one line of JSON with the
//! recordings kept out, for the other side of `cargo xtask bench time-to-error`. Everything counts: preparation, steps, validations.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use cpu_time::ProcessTime;
use host_tool::recording;
use host_tool::train::{CheckpointPlan, TrainConfig, train};
use serde_json::json;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let mut next = |what: &str| arguments.next().with_context(|| format!("{what} is missing"));
    let folder = PathBuf::from(next("the folder")?);
    let target_mm: f64 = next("the target")?.parse()?;
    let seed: u64 = next("the seed")?.parse()?;
    let threads: usize = next("the number of threads")?.parse()?;
    let budget_cpu_s: f64 = next("the budget")?.parse()?;
    let recordings = recording::load(&[folder], None)?;
    // Without recordings of our own making: both sides learn from the same.
    let preset = TrainConfig::preset("stream-2x64").context("the preset is gone")?;
    let config = TrainConfig { budget_cpu_s, synthetic: 0, ..preset };
    let plan = CheckpointPlan { path: None, resume: false, stop_after: None };
    let (wall, cpu) = (Instant::now(), ProcessTime::now());
    let mut history: Vec<serde_json::Value> = Vec::new();
    let mut last = None;
    let mut reached = None;
    let (_, report) = train(&recordings, &config, seed, threads, &plan, &mut |progress| {
        if progress.validation_rmse == last {
            return;
        }
        last = progress.validation_rmse;
        let (wall_s, cpu_s) = (wall.elapsed().as_secs_f64(), cpu.elapsed().as_secs_f64());
        history.push(json!({ "steps": progress.steps, "wall_s": wall_s, "cpu_s": cpu_s, "rmse_mm": last }));
        if reached.is_none() && last.is_some_and(|rmse| rmse <= target_mm) {
            reached = history.last().cloned();
        }
    })?;
    let kept_out: Vec<String> =
        report.validation.iter().filter_map(|one| Some(PathBuf::from(&one.path).file_name()?.to_string_lossy().into_owned())).collect();
    println!("{}", json!({ "seed": seed, "reached": reached, "kept_out": kept_out, "steps": report.optimiser_steps, "history": history }));
    Ok(())
}
