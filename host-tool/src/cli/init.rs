//! `catheter init`.

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};

use super::lab::{FILE, Lab, Limits, Paths, Recordings, Rig};
use super::reading::{Period, Reading, seconds};
use super::{Outcome, check};
use crate::recording::Resample;
use crate::{output, say};

/// Write down how this lab's recordings are read, once for all commands.
///
/// Leaves `catheter.toml` in the folder. With `--recordings` they are read to see whether it is right.
#[derive(clap::Args)]
pub struct Arguments {
    /// The folder that gets the file.
    #[arg(long, value_name = "DIR", default_value = ".", value_parser = output::folder_argument())]
    folder: PathBuf,
    /// Recordings, or their folder: what commands read without `--data`.
    #[arg(long, value_name = "PATH")]
    recordings: Option<PathBuf>,
    /// What no pressure may exceed, bar.
    #[arg(long, value_name = "BAR", value_parser = seconds)]
    maximum_pressure_bar: Option<f64>,
    /// Which rig `rig`, `track` and `dashboard` speak to where nothing else is said, for example serial:/dev/ttyACM0.
    #[arg(long, value_name = "virtual|qemu|board-model|serial[:PORT]")]
    backend: Option<String>,
    #[command(flatten)]
    reading: Reading,
}

/// Runs the command.
///
/// # Errors
/// When there is a file already, an option makes no sense, or the recordings cannot be read so.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let path = arguments.folder.join(FILE);
    ensure!(output::may_replace() || !path.exists(), "{}: exists already; say --force to replace it", path.display());
    let reading = &arguments.reading;
    let lab = Lab {
        recordings: Recordings {
            columns: reading.columns.clone(),
            rate_hz: reading.rate_hz,
            keep_units: reading.keep_units,
            skip_s: reading.skip_s,
            tare_s: reading.tare,
            resample_s: match reading.resample {
                Some(Period(Resample::Period(period_s))) => Some(period_s),
                Some(Period(Resample::Common)) => bail!("--resample: in a lab's file a period is wanted, for example --resample=0.01"),
                None => None,
            },
        },
        paths: Paths { recordings: arguments.recordings.as_ref().map(|path| relative(path, &arguments.folder)) },
        limits: Limits { maximum_pressure_bar: arguments.maximum_pressure_bar },
        rig: Rig { backend: arguments.backend.clone() },
    };
    if let Some(problem) = lab.problem() {
        bail!("{problem}");
    }
    let text = format!(
        "# How recordings are read here, by every command of catheter; options on the command line come first.\n# {}\n\n{}",
        output::provenance::line(),
        toml::to_string_pretty(&lab)?
    );
    if let Some(recordings) = &arguments.recordings {
        let found = reading.load(std::slice::from_ref(recordings))?;
        let samples: usize = found.iter().map(crate::recording::Recording::len).sum();
        let first = &found[0];
        say!(
            "{} recordings, {samples} samples: {} -> {}, every {} s",
            found.len(),
            first.input_signal.column(),
            first.output_signal.column(),
            first.sample_period_s
        );
        check::tell_limits(&found, lab.limits.maximum_pressure_bar);
    }
    output::write_atomic(&path, text.as_bytes())?;
    say!("{}", path.display());
    Ok(Outcome::Success)
}

/// A path as it is told from the file's folder.
fn relative(path: &std::path::Path, folder: &std::path::Path) -> PathBuf {
    let (Ok(path_there), Ok(folder)) = (std::fs::canonicalize(path), std::fs::canonicalize(folder)) else { return path.to_path_buf() };
    path_there.strip_prefix(&folder).map_or(path_there.clone(), std::path::Path::to_path_buf)
}
