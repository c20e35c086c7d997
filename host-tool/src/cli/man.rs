//! `catheter man`: a page of the manual for each command.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Command;

use super::Outcome;
use crate::{output, say};

/// Write the manual pages of all commands into a folder.
#[derive(clap::Args)]
pub struct Arguments {
    /// The folder, as `~/.local/share/man/man1`.
    #[arg(value_name = "DIR", value_parser = output::folder_argument())]
    folder: PathBuf,
}

/// Writes the pages of a command line; pages of an earlier version are replaced.
///
/// # Errors
/// When one cannot be written.
pub fn run(arguments: &Arguments, mut command: Command) -> Result<Outcome> {
    command.build();
    let pages = write(&command, "catheter", &arguments.folder)?;
    say!("{pages} pages in {}; `man -l {}` shows the first", arguments.folder.display(), arguments.folder.join("catheter.1").display());
    Ok(Outcome::Success)
}

/// The page of a command and those of the commands below it; gives their number.
fn write(command: &Command, name: &str, folder: &Path) -> Result<usize> {
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).title(name).render(&mut page).with_context(|| format!("the page of {name}"))?;
    output::write_atomic(&folder.join(format!("{name}.1")), &page)?;
    let below = command.get_subcommands().filter(|one| !one.is_hide_set() && one.get_name() != "help");
    below.map(|one| write(one, &format!("{name}-{}", one.get_name()), folder)).sum::<Result<usize>>().map(|pages| pages + 1)
}
