//! `catheter replay`.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use serde::Serialize;

use super::{Outcome, Results};
use crate::history::{self, DumpRow};
use crate::replay_log::{ReplayLog, Story, story};
use crate::say;

/// Run a replay log again on this computer, bit for bit, and say why the rig did what it did.
#[derive(clap::Args)]
pub struct Arguments {
    /// The replay log, or the recording beside which it lies, or the dump of a rig's last seconds (`catheter rig explain --dump`).
    #[arg(value_name = "FILE")]
    replay_log: PathBuf,
    /// Say what was in force at this moment and why, in s after the beginning of the replay log.
    #[arg(long, value_name = "SECONDS")]
    at: Option<f64>,
    #[command(flatten)]
    results: Results,
}

#[derive(Serialize)]
struct Written<'a> {
    identical: bool,
    complete: bool,
    program: &'a str,
    backend: &'a str,
    blob_sha256: Option<String>,
    #[serde(flatten)]
    story: &'a Story,
}

/// Runs the command.
///
/// # Errors
/// When the file is no replay log.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let is_recording = arguments.replay_log.extension().is_some_and(|ending| ending == "csv");
    if is_recording
        && !arguments.replay_log.with_extension("journal").exists()
        && let Some(rows) = history::read(&arguments.replay_log)?
    {
        return dump(&rows, arguments);
    }
    let path = if is_recording { arguments.replay_log.with_extension("journal") } else { arguments.replay_log.clone() };
    let replay_log = ReplayLog::read(&path)?;
    if is_recording && arguments.replay_log.exists() {
        replay_log.check_recording(&arguments.replay_log)?;
    }
    let told = story(&replay_log, arguments.at)?;
    ensure!(
        arguments.at.is_none_or(|at| at.is_finite() && (0.0..=told.duration_s).contains(&at)),
        "--at: a moment from 0 to {:.3} s is wanted, the replay log is no longer",
        told.duration_s
    );
    let identical = told.replay.is_identical();
    let cut = told.replay.cut;
    let header = &replay_log.header;
    let blob_sha256 = header.blob_sha256();
    say!("{}: {:.3} s on the backend `{}`, written by catheter {}", path.display(), told.duration_s, header.backend, header.program);
    say!("model at the start: {}", blob_sha256.as_deref().unwrap_or("none"));
    match &told.replay.first_difference {
        None => say!("{} ticks run again, every output identical to the bit", told.replay.ticks),
        Some(difference) => say!(
            "DIFFERENT from tick {} on ({:.3} s)\n  recorded {:?}\n  replayed {:?}",
            difference.tick,
            difference.time_s,
            difference.recorded,
            difference.replayed
        ),
    }
    if let Some(cut) = cut {
        say!("CUT at {:.3} s, and what followed cannot be run again: {}", told.duration_s, cut.in_words());
    }
    for turning in &told.turnings {
        say!("{:>10.3} s  {} -> {}: {}", turning.time_s, turning.from, turning.to, turning.cause.in_words());
    }
    if let Some(moment) = &told.moment {
        say!("\nAt {:.3} s:", moment.time_s);
        moment.why.iter().for_each(|sentence| say!("  {sentence}"));
        let number = |value: Option<f32>, unit: &str| value.map_or("not believed".to_owned(), |value| format!("{value:.4} {unit}"));
        say!("  measured pressure {}", number(moment.pressure_bar, "bar"));
        say!("  measured displacement {}", number(moment.displacement_mm, "mm"));
        say!("  model {}", moment.estimate_mm.map_or("none".to_owned(), |value| format!("{value:.4} mm")));
    }
    let written =
        Written { identical, complete: cut.is_none(), program: &header.program, backend: &header.backend, blob_sha256, story: &told };
    let lead = format!("{}: {:.3} s on the backend {}, run again.", path.display(), told.duration_s, header.backend);
    arguments.results.write("A replay log, run again", &lead, &written, |_| {})?;
    Ok(if identical && cut.is_none() { Outcome::Success } else { Outcome::CheckFailed })
}

#[derive(Serialize)]
struct DumpWritten<'a> {
    rows: usize,
    duration_s: f64,
    ends_in_a_fault: bool,
    events: &'a [String],
    at: Option<&'a DumpRow>,
}

/// Tells what a rig's last seconds hold.
fn dump(rows: &[DumpRow], arguments: &Arguments) -> Result<Outcome> {
    let duration_s = rows.last().map_or(0.0, |row| row.time_s);
    ensure!(
        arguments.at.is_none_or(|at| at.is_finite() && (0.0..=duration_s).contains(&at)),
        "--at: a moment from 0 to {duration_s:.3} s is wanted, the dump is no longer"
    );
    let events = history::events(rows);
    say!("{}: the last {duration_s:.3} s of a rig, {} rows", arguments.replay_log.display(), rows.len());
    events.iter().for_each(|event| say!("{event}"));
    let moment = arguments.at.unwrap_or(duration_s);
    let at = history::at(rows, moment);
    if let Some(row) = at {
        say!(
            "{:.3} s  state `{}`: {:.3} bar to the valve, {:.3} bar and {:.3} mm measured (codes {} and {})",
            row.time_s,
            row.state,
            row.pressure_bar,
            row.pressure_measured_bar,
            row.displacement_mm,
            row.pressure_code,
            row.laser_code
        );
    }
    let written = DumpWritten { rows: rows.len(), duration_s, ends_in_a_fault: history::ends_in_a_fault(rows), events: &events, at };
    let lead = format!("{}: the last {duration_s:.3} s of a rig.", arguments.replay_log.display());
    arguments.results.write("A rig's last seconds", &lead, &written, |_| {})?;
    Ok(Outcome::Success)
}
