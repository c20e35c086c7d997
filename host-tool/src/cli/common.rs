//! What computing commands share: how they end, and where their results go.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use serde::Serialize;

use crate::output;
use crate::report::{self, Page};

/// How a command ended; the exit code is a contract.
pub enum Outcome {
    /// Everything worked: 0.
    Success,
    /// The command ran and a check it makes failed: 1.
    CheckFailed,
}

/// Where a command's result goes.
#[derive(Args, Clone, Debug)]
pub struct Results {
    /// Write the result as JSON to this file; folders on the way are created.
    #[arg(long, value_name = "FILE", value_parser = output::file_argument(""))]
    pub json: Option<PathBuf>,
    /// Write the result as a page with figures and plots to this file.
    #[arg(long, alias = "report", value_name = "FILE.html", value_parser = output::file_argument("html"))]
    pub html: Option<PathBuf>,
}

/// Options that every command takes that makes random choices or computes in parallel.
#[derive(Args, Clone, Debug)]
pub struct Common {
    /// Where the result goes.
    #[command(flatten)]
    pub results: Results,
    /// Seed of every random choice; equal seeds give equal results.
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub seed: u64,
    /// Worker threads; all cores when absent. Results are bit-identical for an equal count.
    #[arg(long, value_name = "N", value_parser = thread_count)]
    pub threads: Option<usize>,
}

impl Results {
    /// The files that it names.
    pub(super) fn files(&self) -> impl Iterator<Item = &Path> {
        self.json.as_deref().into_iter().chain(self.html.as_deref())
    }

    /// Writes a result to where it was asked for: as JSON, and as a page with the same figures below what `draw` puts there.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub(super) fn write(&self, title: &str, lead: &str, result: &impl Serialize, draw: impl FnOnce(&mut Page)) -> Result<()> {
        if let Some(path) = &self.json {
            output::write_result(path, result)?;
        }
        if let Some(path) = &self.html {
            let figures = serde_json::to_value(result)?;
            output::write_atomic(path, report::result::page(title, lead, &figures, draw).as_bytes())?;
            crate::say!("report: {}", path.display());
        }
        Ok(())
    }

    /// Copies the page that a command left in its folder to where `--html` wants one.
    ///
    /// # Errors
    /// When a file cannot be read or written.
    pub(super) fn copy_page(&self, page: &Path) -> Result<()> {
        self.html.as_ref().map_or(Ok(()), |path| output::write_atomic(path, &output::read(page)?))
    }
}

/// More threads than this is a slip of the finger.
const MOST_THREADS: usize = 1024;

fn thread_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if (1..=MOST_THREADS).contains(&count) => Ok(count),
        _ => Err(format!("a whole number from 1 to {MOST_THREADS} is wanted")),
    }
}
