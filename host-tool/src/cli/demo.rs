//! `catheter demo`.

use std::path::PathBuf;

use anyhow::{Result, anyhow};

use super::{Common, Outcome};
use crate::demo::{self, DemoConfig};
use crate::output;

/// From nothing to a verified blob and a report.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folder of everything it leaves: recordings, models, blobs, demo.json and report.html. Where it holds something already, a number is
    /// added to its name.
    #[arg(long, default_value = "out/demo", value_name = "DIR")]
    out: PathBuf,
    /// A fraction of the data and of the training, in seconds: shows that everything works, not how well.
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    // Typed twice, the second leaves the first as it is.
    let out = output::free_folder(&arguments.out);
    output::check_folder(&out).map_err(|problem| anyhow!("{}: {problem}", out.display()))?;
    let config = DemoConfig {
        folder: out.clone(),
        seed: arguments.common.seed,
        threads: arguments.common.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from)),
        quick: arguments.quick,
    };
    let demo = demo::run(&config)?;
    demo::print_summary(&demo, &out);
    if let Some(path) = &arguments.common.results.json {
        output::write_result(path, &demo)?;
    }
    arguments.common.results.copy_page(&out.join("report.html"))?;
    Ok(if demo.passed { Outcome::Success } else { Outcome::CheckFailed })
}
