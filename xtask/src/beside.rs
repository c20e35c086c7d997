//! Builds beside tests, with the processor time that these leave idle: many tests wait for a rig, and most test programs end with one thread.
//! A process of its own at the lowest priority, its output in a file.

use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, bail};

use crate::process::{command, exists, target_folder};
use crate::{board_model, checks, demo, firmware, publish};

/// Lines of the output that a failure shows.
const SHOWN: usize = 60;

/// What goes on beside tests.
#[derive(Clone, Copy, Debug)]
pub enum Task {
    /// What later stages need.
    Builds,
    /// What is shown by building it.
    Proofs,
}

impl Task {
    /// As on the command line.
    fn name(self) -> &'static str {
        match self {
            Self::Builds => "builds",
            Self::Proofs => "proofs",
        }
    }
}

/// What later stages need, one after the other.
pub fn builds() -> Result<()> {
    checks::target_builds()?;
    for board in &firmware::BOARDS {
        firmware::build(board)?;
    }
    board_model::build()?;
    demo::build()
}

/// What is shown by building it, one after the other.
pub fn proofs() -> Result<()> {
    board_model::checks()?;
    firmware::reproducible(&firmware::BOARDS[0])?;
    firmware::panic_free()?;
    publish::check()
}

/// A process that works beside the tests.
pub struct Beside {
    task: Task,
    process: Child,
    log: PathBuf,
}

/// Starts it.
pub fn start(task: Task) -> Result<Beside> {
    let own = std::env::current_exe().context("the path of this program")?;
    let mut started = if exists("nice") {
        let mut lowest = command("nice");
        lowest.args(["-n", "19"]).arg(own);
        lowest
    } else {
        command(own)
    };
    std::fs::create_dir_all(target_folder())?;
    let log = target_folder().join(format!("{}.log", task.name()));
    let file = std::fs::File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
    eprintln!("\n==> {} go on beside the tests; their output is in {}", task.name(), log.display());
    started.arg(task.name()).stdin(Stdio::null()).stdout(file.try_clone()?).stderr(file);
    let process = started.spawn().with_context(|| format!("cannot start the {}", task.name()))?;
    Ok(Beside { task, process, log })
}

impl Beside {
    /// Waits for its end; says how long each step took, or what the one that failed has said.
    pub fn finish(mut self) -> Result<()> {
        let name = self.task.name();
        eprintln!("\n==> waiting for the {name}");
        let begun = Instant::now();
        let status = self.process.wait()?;
        let text = String::from_utf8_lossy(&std::fs::read(&self.log)?).into_owned();
        if !status.success() {
            let lines: Vec<&str> = text.lines().collect();
            let last = lines[lines.len().saturating_sub(SHOWN)..].join("\n");
            bail!("{name}, beside the tests, failed:\n{last}\n(all of it is in {})", self.log.display());
        }
        text.lines().filter(|line| line.starts_with("==> ") && line.contains(": done in ")).for_each(|line| eprintln!("{line}"));
        eprintln!("==> the {name} were waited for {:.1} s", begun.elapsed().as_secs_f64());
        Ok(())
    }
}

impl Drop for Beside {
    /// A failed test leaves nothing behind, but for the one step under way.
    fn drop(&mut self) {
        if matches!(self.process.try_wait(), Ok(None)) {
            // It may have ended since.
            let _ = self.process.kill();
            let _ = self.process.wait();
        }
    }
}
