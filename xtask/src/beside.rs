//! The builds that the later stages of `test` need, made beside its tests with the processor time these leave idle: many tests wait for a rig,
//! and most test programs end with one thread. A process of its own at the lowest priority, its output in a file.

use std::path::PathBuf;
use std::process::{Child, Stdio};

use anyhow::{Context, Result, bail};

use crate::process::{command, exists, target_folder};
use crate::{board_model, checks, demo, firmware, publish};

/// The name of the task that makes them.
pub const TASK: &str = "builds";
/// Lines of the output that a failure shows.
const SHOWN: usize = 60;

/// Makes them, one after the other.
pub fn builds() -> Result<()> {
    checks::target_builds()?;
    for board in &firmware::BOARDS {
        firmware::build(board)?;
    }
    board_model::build()?;
    demo::build()?;
    firmware::reproducible(&firmware::BOARDS[0])?;
    firmware::panic_free()?;
    board_model::checks()?;
    publish::check()
}

/// The process that makes them.
pub struct Builds {
    process: Child,
    log: PathBuf,
}

impl Builds {
    /// Starts it.
    pub fn start() -> Result<Self> {
        let own = std::env::current_exe().context("the path of this program")?;
        let mut started = if exists("nice") {
            let mut lowest = command("nice");
            lowest.args(["-n", "19"]).arg(own);
            lowest
        } else {
            command(own)
        };
        let log = target_folder().join("builds.log");
        std::fs::create_dir_all(target_folder())?;
        let file = std::fs::File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
        eprintln!("\n==> builds for later stages begin beside; their output is in {}", log.display());
        let process =
            started.arg(TASK).stdin(Stdio::null()).stdout(file.try_clone()?).stderr(file).spawn().context("cannot start the builds")?;
        Ok(Self { process, log })
    }

    /// Waits until all are made; says how long each took, or what the one that failed has said.
    pub fn finish(mut self) -> Result<()> {
        eprintln!("\n==> waiting for the builds beside");
        let status = self.process.wait()?;
        let text = String::from_utf8_lossy(&std::fs::read(&self.log)?).into_owned();
        if !status.success() {
            let lines: Vec<&str> = text.lines().collect();
            bail!(
                "a build beside the tests failed:\n{}\n(all of it is in {})",
                lines[lines.len().saturating_sub(SHOWN)..].join("\n"),
                self.log.display()
            );
        }
        text.lines().filter(|line| line.starts_with("==> ") && line.contains(": done in ")).for_each(|line| eprintln!("{line}"));
        Ok(())
    }
}

impl Drop for Builds {
    /// A failed test leaves no builds behind, but for the one step under way.
    fn drop(&mut self) {
        if matches!(self.process.try_wait(), Ok(None)) {
            // It may have ended since.
            let _ = self.process.kill();
            let _ = self.process.wait();
        }
    }
}
