//! `catheter inspect`.

use anyhow::{Result, bail};

use super::{Common, Outcome};

/// Print everything about a model blob.
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
