//! `catheter completions`: the completion script of a shell, on standard output.

use anyhow::Result;
use clap::Command;

use super::Outcome;
use crate::output;

/// Print the completion script of a shell.
#[derive(clap::Args)]
pub struct Arguments {
    /// Which shell.
    shell: clap_complete::Shell,
}

/// Prints the script of a command line.
///
/// # Errors
/// Never.
pub fn run(arguments: &Arguments, command: &mut Command) -> Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, command, "catheter", &mut script);
    output::print_bytes(&script);
    Ok(Outcome::Success)
}
