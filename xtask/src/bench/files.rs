//! The built command, the folders it works in, and the figures it leaves there.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::process::{answer, command, shown, target_folder};

/// What the figures were measured on.
pub fn machine() -> Value {
    let processor = std::fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
        text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':').map(|(_, name)| name.trim().to_owned()))
    });
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let compiler = answer(command("rustc").arg("--version")).map(|text| text.trim().to_owned());
    println!(
        "Measured on {} ({cores} cores), {}.\n",
        processor.as_deref().unwrap_or("an unknown processor"),
        compiler.as_deref().unwrap_or("rustc")
    );
    json!({ "processor": processor, "cores": cores, "compiler": compiler })
}

/// The built command, with the words of `line`.
pub fn catheter(folder: &Path, line: &str) -> Command {
    let mut command = command(target_folder().join("release/catheter"));
    // Benchmarks write where they wrote before.
    command.env("CATHETER_FORCE", "1");
    command.args(line.split_whitespace()).current_dir(folder);
    command
}

/// Runs the built command silently in `folder` and reads the JSON it leaves in `NAME.json`; `--json` is added here.
pub fn catheter_json(folder: &Path, name: &str, line: &str) -> Result<Value> {
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

pub fn read_json(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{}: no JSON", path.display()))
}

/// A fresh folder for one measurement, below cargo's target folder.
pub fn fresh_folder(name: &str) -> Result<PathBuf> {
    let folder = target_folder().join("bench").join(name);
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| format!("cannot empty {}", folder.display()))?;
    }
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    Ok(folder)
}

pub fn number(value: &Value, key: &str) -> Result<f64> {
    value[key].as_f64().with_context(|| format!("the number `{key}` is missing from {value}"))
}

pub fn write_json(path: &Path, value: &Value) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    std::fs::write(path, serde_json::to_string_pretty(value)? + "\n").with_context(|| format!("cannot write {}", path.display()))
}
