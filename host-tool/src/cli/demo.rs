//! `catheter demo`.

use anyhow::{Result, bail};

use super::{Common, Outcome};

/// From nothing to a verified blob and a report.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let _ = &arguments.common;
    bail!("not there yet")
}
