//! `catheter rig log`.

use std::time::Duration;

use anyhow::{Result, bail};
use serde::Serialize;

use super::Which;
use crate::backend::Rig;
use crate::cli::Outcome;
use crate::link::Client;
use crate::say;

/// Longest time that a rig is listened to.
const LONGEST_S: f64 = 3600.0;

/// Show what the image logs: its start, states, faults, refusals, flash errors.
#[derive(clap::Args)]
pub struct Arguments {
    /// Listen for this time, in s of the rig.
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0)]
    seconds: f64,
}

#[derive(Serialize)]
struct Written<'a> {
    lines: Vec<&'a str>,
}

/// Lets time pass and shows the log.
pub fn run(arguments: &Arguments, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    if !(0.0..=LONGEST_S).contains(&arguments.seconds) {
        bail!("--seconds: 0 to {LONGEST_S} s is wanted");
    }
    if rig.transport().log().is_none() {
        bail!(
            "this rig's log goes to a debug probe only: `cargo xtask flash` shows it, and `--backend board-model` shows that of the same image \
             on a model of its chip"
        );
    }
    rig.listen_for(Duration::from_secs_f64(arguments.seconds))?;
    let log = rig.transport().log().unwrap_or_default().to_owned();
    log.lines().for_each(|line| say!("{line}"));
    which.write(&Written { lines: log.lines().collect() })?;
    Ok(Outcome::Success)
}
