//! `catheter rig record`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use serde::Serialize;

use super::Which;
use super::state::RecordWritten;
use crate::backend::Rig;
use crate::cli::Outcome;
use crate::excitation::{self, Limits};
use crate::experiment::{self, OverTheLink};
use crate::interrupt;
use crate::link::{Account, Client};
use crate::recording;
use crate::{output, say};

/// What to play and where to leave what came of it.
#[derive(Args)]
pub struct Arguments {
    /// The excitation to play.
    #[arg(long, value_name = "FILE")]
    excitation: PathBuf,
    /// The recording. Beside it lies the replay log, `.journal` instead of `.csv`, for `catheter replay`.
    #[arg(long, value_name = "FILE", value_parser = output::file_argument(".csv"))]
    out: PathBuf,
    /// The model that a board runs, for its replay log: the device gives none out.
    #[arg(long, value_name = "FILE.blob")]
    model: Option<PathBuf>,
    /// Leave no replay log. A board begins again, as after a start, to tell one over the link.
    #[arg(long = "no-journal", conflicts_with = "model")]
    no_replay_log: bool,
    /// Refuse an excitation above this, in bar; never above the device's own ceiling.
    #[arg(long, default_value_t = Limits::default().maximum_bar, value_name = "BAR")]
    maximum_pressure_bar: f64,
    /// Refuse an excitation faster than this, in bar/s.
    #[arg(long, default_value_t = Limits::default().maximum_slew_bar_per_s, value_name = "BAR/S")]
    maximum_slew_bar_per_s: f64,
}

#[derive(Serialize)]
struct Written<'a> {
    recording: &'a Path,
    #[serde(rename = "journal")]
    replay_log: Option<&'a Path>,
    samples: usize,
    points: usize,
    gaps: usize,
    account: &'a Account,
    fault: Option<RecordWritten>,
    model_id: Option<String>,
}

impl Arguments {
    /// Checks everything that can be checked without a rig.
    pub fn check(&self, which: &Which) -> Result<()> {
        let replay_log = self.out.with_extension("journal");
        let outputs: Vec<&Path> = [self.out.as_path(), &replay_log].into_iter().chain(which.json.as_deref()).collect();
        let inputs: Vec<PathBuf> = std::iter::once(&self.excitation).chain(&self.model).cloned().collect();
        output::refuse_overwriting(&inputs, &outputs)?;
        if !self.no_replay_log {
            output::refuse_any(&self.out.with_extension("journal"))?;
        }
        excitation::read(&self.excitation)?.sample_within(&self.limits()).with_context(|| self.excitation.display().to_string())?;
        Ok(())
    }

    fn limits(&self) -> Limits {
        Limits { maximum_bar: self.maximum_pressure_bar, maximum_slew_bar_per_s: self.maximum_slew_bar_per_s, ..Limits::default() }
    }
}

/// Plays, listens, writes.
pub fn run(arguments: &Arguments, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    interrupt::watch();
    let excitation = excitation::read(&arguments.excitation)?;
    let read = |path: &PathBuf| output::read(path).with_context(|| format!("cannot read {}", path.display()));
    let blob = arguments.model.as_ref().map(read).transpose()?;
    let traced_as = rig.transport().traced_as().filter(|_| !arguments.no_replay_log);
    let wanted = traced_as.map(|backend| OverTheLink { backend, blob: blob.as_deref() });
    let outcome = experiment::record(rig, &excitation, &arguments.limits(), wanted)?;
    let recording = outcome.recording(&arguments.out)?;
    recording::write(&arguments.out, &recording)?;
    let replay_log = arguments.out.with_extension("journal");
    let from_simulation = rig.transport().replay_log().filter(|_| !arguments.no_replay_log);
    let kept =
        outcome.replay_log.as_ref().or(from_simulation).map(|kept| kept.write_beside(&replay_log, &arguments.out)).transpose()?.is_some();
    let id = rig.hello().model_id;
    let written = Written {
        recording: &arguments.out,
        replay_log: kept.then_some(replay_log.as_path()),
        samples: recording.len(),
        points: outcome.points,
        gaps: recording.gaps.len(),
        account: &outcome.account,
        fault: outcome.fault.as_ref().map(RecordWritten::new),
        model_id: (id != [0; 8]).then(|| id.iter().map(|byte| format!("{byte:02x}")).collect()),
    };
    say!("{} samples of {} points in {}", written.samples, written.points, arguments.out.display());
    let Account { dropped_by_device, lost_on_the_line, damaged_frames, .. } = written.account;
    say!(
        "{dropped_by_device} samples dropped by the device, {lost_on_the_line} lost on the line, {damaged_frames} damaged frames, {} gaps",
        written.gaps
    );
    if kept {
        say!("replay log in {}; `catheter replay` runs it again", replay_log.display());
    }
    if let Some(record) = &written.fault {
        say!("The experiment ended early: {}", record.line());
    }
    which.write(&written)?;
    let complete = written.fault.is_none();
    Ok(if complete { Outcome::Success } else { Outcome::CheckFailed })
}
