//! `catheter check`.

use std::path::{Path, PathBuf};

use anyhow::Result;

use super::{Common, Data, Outcome};
use crate::recording::Recording;
use crate::recording::check::{Check, Checked, check};
use crate::{output, report, say};

/// Say what recordings show before anything is fitted to them.
///
/// Clock, gaps, staircases, resolution, clipping, steps and drift of the zero, noise, what the rig repeats, and the splits a fit would use.
#[derive(clap::Args)]
#[command(after_long_help = super::help::CHECK)]
pub struct Arguments {
    #[command(flatten)]
    data: Data,
    #[command(flatten)]
    common: Common,
}

/// Recordings of one file that are reported one by one; of more, each different line is reported once.
const TOLD_APART: usize = 3;

/// Runs the command.
///
/// # Errors
/// On bad input or when a result cannot be written.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let recordings = arguments.data.load()?;
    let inputs: Vec<PathBuf> = recordings.iter().map(Recording::file).collect();
    let outputs: Vec<&Path> = arguments.common.results.files().collect();
    output::refuse_overwriting(&inputs, &outputs)?;
    let working = output::working("check", "clocks, noise, what repeats");
    let check = check(&recordings);
    drop(working);
    print(&check, &recordings);
    tell_limits(&recordings, super::lab::find()?.and_then(|lab| lab.limits.maximum_pressure_bar));
    if let Some(path) = &arguments.common.results.json {
        output::write_result(path, &check)?;
    }
    if let Some(path) = &arguments.common.results.html {
        output::write_atomic(path, report::check::page(&check, &recordings).as_bytes())?;
    }
    Ok(Outcome::Success)
}

/// Names the recordings whose input exceeds the lab's limit.
pub(super) fn tell_limits(recordings: &[Recording], maximum_bar: Option<f64>) {
    let Some(maximum_bar) = maximum_bar else { return };
    for recording in recordings.iter().filter(|recording| recording.input_signal.unit == "bar") {
        let most = recording.input.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if most > maximum_bar {
            say!(
                "{}: the {} reaches {most} bar, above the lab's {maximum_bar} bar",
                recording.path.display(),
                recording.input_signal.quantity
            );
        }
    }
}

fn print(check: &Check, recordings: &[Recording]) {
    let files: Vec<PathBuf> = recordings.iter().map(Recording::file).collect();
    let mut start = 0;
    for file in files.chunk_by(|one, other| one == other) {
        let checked = &check.recordings[start..start + file.len()];
        start += file.len();
        if checked.len() <= TOLD_APART {
            for one in checked {
                say!("{}", one.path.display());
                one.lines().iter().for_each(|(name, value)| say!("  {name:<14} {value}"));
            }
        } else {
            say!("{} ({} recordings)", file[0].display(), checked.len());
            print_together(checked);
        }
    }
    let unit = recordings.first().map_or("", |recording| recording.output_signal.unit.as_str());
    say!("all recordings");
    check.lines(unit).iter().for_each(|(name, value)| say!("  {name:<14} {value}"));
}

/// Many recordings of one file: the first one's lines, then the notes with how many recordings they concern.
fn print_together(checked: &[Checked]) {
    let mut notes: Vec<(&str, usize)> = Vec::new();
    for note in checked.iter().flat_map(|one| &one.notes) {
        match notes.iter_mut().find(|(text, _)| *text == note.text) {
            Some((_, count)) => *count += 1,
            None => notes.push((&note.text, 1)),
        }
    }
    for (name, value) in checked[0].lines().iter().filter(|(name, _)| *name != "note") {
        say!("  {name:<14} {value} (in the first)");
    }
    for (text, count) in notes {
        if count == checked.len() {
            say!("  {:<14} {text}", "note");
        } else {
            say!("  {:<14} {text} (in {count} of {})", "note", checked.len());
        }
    }
}
