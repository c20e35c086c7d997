//! How fast a large CSV is read, beside the bare byte records of the `csv` crate: both on the same file, in turns, in one process.

use std::time::Duration;

use anyhow::{Context, Result};
use serde_json::Value;

use super::files::{fresh_folder, number};
use super::table::markdown;
use crate::process::{answer_within, command, target_folder};

/// Measures, prints the table and gives the figures.
pub fn measure() -> Result<Value> {
    let folder = fresh_folder("reading")?;
    let mut program = command(target_folder().join("release/examples/reading_rate"));
    let line = answer_within(Duration::from_secs(600), program.arg(folder.join("large.csv")))?;
    let mut figures: Value = serde_json::from_str(&line).with_context(|| format!("no line of JSON: {line}"))?;
    let (rows, bytes) = (number(&figures, "rows")?, number(&figures, "bytes")?);
    let (ours_s, bare_s) = (number(&figures, "recording_cpu_s")?, number(&figures, "byte_records_cpu_s")?);
    let row = |name: &str, seconds: f64| {
        vec![name.to_owned(), format!("{seconds:.2}"), format!("{:.1}", rows / seconds * 1e-6), format!("{:.0}", bytes / seconds * 1e-6)]
    };
    let table = [row("a recording, as commands read it", ours_s), row("byte records of the csv crate", bare_s)];
    println!("Reading {rows} rows, {:.0} MB, one thread\n", bytes * 1e-6);
    println!("{}", markdown(&["what", "CPU s", "million rows/s", "MB/s"], &table));
    println!("rate of the recording over the rate of the byte records: {:.2} (target 0.5)\n", bare_s / ours_s);
    figures["ratio"] = (bare_s / ours_s).into();
    // 130 MB that nobody needs.
    std::fs::remove_dir_all(&folder).with_context(|| format!("cannot remove {}", folder.display()))?;
    Ok(figures)
}
