//! The headline measurements, as tables ready for the README and as JSON: accuracy over fresh seeds, measured recordings, training speed,
//! the firmware's instructions and memory, what discovery finds in hidden cases, controllers.
//!
//! Nothing of ours is linked in: every figure comes from running the built commands, as a user would.

mod accuracy;
mod board_model;
mod control;
mod discover;
mod firmware;
mod jumps;
mod measured;
mod table;
mod time_to_error;
mod training;

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::{Map, Value, json};

use crate::process::{cargo, command, run, shown, target_folder};

/// Run the headline measurements; hours with the default budgets, so name the ones you want.
#[derive(clap::Args)]
pub struct Arguments {
    /// Which measurements; all of them when none is named.
    what: Vec<What>,
    /// Write the results as JSON to this file. With `firmware` or `board-model` alone it holds these figures and nothing else.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Seeds per figure. They are 9001, 9002 and so on, used nowhere else in the project.
    #[arg(long, default_value_t = 5, value_name = "N")]
    seeds: u64,
    /// Processor seconds each training may use, instead of what the figure is stated for.
    #[arg(long, value_name = "S")]
    budget_cpu_s: Option<u64>,
    /// Of `accuracy`, only the data of this name: paper, rich or all-effects.
    #[arg(long, value_name = "NAME")]
    only: Option<String>,
    /// Folder with the public measured sets (`piezo-picma` and so on); docs/how-to/import-recordings.md says where to get them.
    #[arg(long, value_name = "FOLDER")]
    recordings: Option<PathBuf>,
    /// Of `measured`, only these maps of tests/baselines/maps.toml. Tune on `development`, publish `reporting`.
    #[arg(long, value_name = "WHICH", default_value = "development")]
    maps: measured::Maps,
    /// Of `measured`, options of `catheter fit` for a quick look, as in `--fit-options=--no-networks`; published figures go without.
    #[arg(long, value_name = "OPTIONS", default_value = "", hide_default_value = true, allow_hyphen_values = true)]
    fit_options: String,
    /// Of `measured`, also whether `fit` can be fooled: copies, other names, other units, outputs that inputs cannot explain. Needs
    /// --maps development or all.
    #[arg(long)]
    checks: bool,
    /// Of `measured`, the Python (3.11 or newer, with numpy, scipy and scikit-learn) that fits the baselines; of `time-to-error`, the one with
    /// torch and numpy.
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: String,
    /// Of `time-to-error`, the error on the test recordings, free running, in mm.
    #[arg(long, default_value_t = 0.003, value_name = "MM")]
    target_mm: f64,
    /// Record the firmware's instruction counts as those that the tests compare with.
    #[arg(long)]
    bless: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum What {
    /// RMSE on the simulated sets, per test family, over several seeds, in f32 and fixed point.
    Accuracy,
    /// RMSE on the measured recordings; needs --recordings.
    Measured,
    /// What the jumps of the all-effects plant allow an estimator.
    Jumps,
    /// Tracking of the controllers on the all-effects rig, side by side.
    Control,
    /// Training throughput, beside PyTorch where python3 has it.
    Training,
    /// Time of training to an error, beside PyTorch where --python has it.
    TimeToError,
    /// Instructions per step and tick counted in the emulator, flash, RAM and stack; error of the quantised networks.
    Firmware,
    /// The flashable image on the model of its chip: closed loop for ten virtual minutes, registers, faults.
    BoardModel,
    /// Hidden effects of two virtual rigs: which are named right, false alarms, unknown ones, gap closed, time.
    Discover,
}

/// First of the seeds that figures are reported with.
const FIRST_REPORTING_SEED: u64 = 9001;

/// Runs the measurements asked for and prints their tables.
pub fn bench(arguments: &Arguments) -> Result<()> {
    let wanted = |what| arguments.what.is_empty() || arguments.what.contains(&what);
    if arguments.what == [What::BoardModel] {
        let figures = board_model::measure()?;
        return arguments.json.as_ref().map_or(Ok(()), |path| write_json(path, &figures));
    }
    if arguments.what == [What::Firmware] {
        let figures = firmware::measure(arguments.bless)?;
        return arguments.json.as_ref().map_or(Ok(()), |path| write_json(path, &figures));
    }
    run(
        "build",
        cargo().args([
            "build",
            "--release",
            "--package",
            "host-tool",
            "--bin",
            "catheter",
            "--example",
            "training_throughput",
            "--example",
            "time_to_error",
        ]),
    )?;
    let mut results = Map::new();
    results.insert("machine".to_owned(), machine());
    if wanted(What::Training) {
        results.insert("training".to_owned(), training::measure()?);
    }
    if wanted(What::TimeToError) {
        results.insert("time_to_error".to_owned(), time_to_error::measure(arguments)?);
    }
    if wanted(What::Control) {
        results.insert("control".to_owned(), control::measure(arguments)?);
    }
    if wanted(What::Measured) {
        match &arguments.recordings {
            Some(folder) => {
                let folder = std::path::absolute(folder)?;
                results.insert("measured".to_owned(), measured::measure(&folder, arguments)?);
            }
            None if arguments.what.contains(&What::Measured) => {
                anyhow::bail!(
                    "the measured sets are not part of the project; name their folder with --recordings (docs/how-to/import-recordings.md says where to get them)"
                )
            }
            None => eprintln!("the measured sets are left out: no --recordings"),
        }
    }
    if wanted(What::Jumps) {
        results.insert("jumps".to_owned(), jumps::measure(arguments)?);
    }
    if wanted(What::Firmware) {
        results.insert("firmware".to_owned(), firmware::measure(arguments.bless)?);
    }
    if wanted(What::BoardModel) {
        results.insert("board_model".to_owned(), board_model::measure()?);
    }
    if wanted(What::Discover) {
        results.insert("discover".to_owned(), discover::measure(arguments)?);
    }
    if wanted(What::Accuracy) {
        results.insert("accuracy".to_owned(), accuracy::measure(arguments)?);
    }
    if let Some(path) = &arguments.json {
        write_json(path, &Value::Object(results))?;
    }
    Ok(())
}

/// What the figures were measured on.
fn machine() -> Value {
    let processor = std::fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
        text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':').map(|(_, name)| name.trim().to_owned()))
    });
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let compiler = crate::process::answer(command("rustc").arg("--version")).map(|text| text.trim().to_owned());
    println!(
        "Measured on {} ({cores} cores), {}.\n",
        processor.as_deref().unwrap_or("an unknown processor"),
        compiler.as_deref().unwrap_or("rustc")
    );
    json!({ "processor": processor, "cores": cores, "compiler": compiler })
}

/// The built command, with the words of `line`.
fn catheter(folder: &Path, line: &str) -> Command {
    let mut command = command(target_folder().join("release/catheter"));
    // Benchmarks write where they wrote before.
    command.env("CATHETER_FORCE", "1");
    command.args(line.split_whitespace()).current_dir(folder);
    command
}

/// Runs the built command silently in `folder` and reads the JSON it leaves in `NAME.json`; `--json` is added here.
fn catheter_json(folder: &Path, name: &str, line: &str) -> Result<Value> {
    let mut command = catheter(folder, line);
    command.args(["--json", &format!("{name}.json")]);
    let output = command.output().with_context(|| format!("cannot start `{}`", shown(&command)))?;
    // 1 is a failed check of the acceptance suite: the figures are there all the same, and are what we came for.
    if !matches!(output.status.code(), Some(0 | 1)) {
        anyhow::bail!("`{}` ended with {}: {}", shown(&command), output.status, String::from_utf8_lossy(&output.stderr).trim());
    }
    let said = || format!("`{}` left no figures and said: {}", shown(&command), String::from_utf8_lossy(&output.stderr).trim());
    read_json(&folder.join(format!("{name}.json"))).with_context(said)
}

fn read_json(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{}: no JSON", path.display()))
}

/// A fresh folder for one measurement, below cargo's target folder.
fn fresh_folder(name: &str) -> Result<PathBuf> {
    let folder = target_folder().join("bench").join(name);
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| format!("cannot empty {}", folder.display()))?;
    }
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    Ok(folder)
}

fn number(value: &Value, key: &str) -> Result<f64> {
    value[key].as_f64().with_context(|| format!("the number `{key}` is missing from {value}"))
}

fn write_json(path: &Path, value: &Value) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    std::fs::write(path, serde_json::to_string_pretty(value)? + "\n").with_context(|| format!("cannot write {}", path.display()))
}
