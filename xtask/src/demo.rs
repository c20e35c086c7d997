//! The README's first command, run as a newcomer would.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use crate::process::{cargo, run, target_folder};

/// The longest the demo may take once built; it promises 90 s on two idle cores, and test machines are not idle.
const LIMIT: Duration = Duration::from_secs(300);

/// Builds the command as the README's first command does.
pub fn build() -> Result<()> {
    run("build", cargo().args(["build", "--release", "--bin", "catheter"]))
}

/// The demo ends well and leaves its report and a blob for each of its rigs.
pub fn runs() -> Result<()> {
    build()?;
    let folder = target_folder().join("demo");
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| format!("cannot empty {}", folder.display()))?;
    }
    let start = Instant::now();
    run("demo", cargo().args(["run", "--release", "--bin", "catheter", "--", "demo", "--out"]).arg(&folder))?;
    if start.elapsed() > LIMIT {
        bail!("the demo took {:.0} s, at most {} s are allowed", start.elapsed().as_secs_f64(), LIMIT.as_secs());
    }
    for file in ["report.html", "demo.json", "paper-hybrid.blob", "effects-hybrid.blob"] {
        if !folder.join(file).is_file() {
            bail!("the demo left no {file} in {}", folder.display());
        }
    }
    Ok(())
}

/// The page that it has left.
pub fn page() -> Result<PathBuf> {
    Ok(std::path::absolute(target_folder().join("demo/report.html"))?)
}
