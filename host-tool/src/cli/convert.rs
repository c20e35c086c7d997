//! `catheter convert`.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};

use super::{Outcome, Reading};
use crate::recording::{self, ENDINGS, Recording};
use crate::{output, say};

/// Turn recordings of one format into another: CSV, gzipped CSV, NPZ (numpy), MAT (MATLAB), MCAP (PlotJuggler, Foxglove).
#[derive(clap::Args)]
pub struct Arguments {
    /// Recordings, or a folder of them.
    #[arg(required = true, num_args = 1.., value_name = "PATH")]
    inputs: Vec<PathBuf>,
    /// The file to write, its ending is the format; with several recordings a folder, and `--to` is the format.
    #[arg(long, value_name = "FILE|DIR")]
    out: PathBuf,
    /// Format of the files in a folder.
    #[arg(long, value_name = "FORMAT", value_parser = ENDINGS)]
    to: Option<String>,
    #[command(flatten)]
    reading: Reading,
}

/// Runs the command.
///
/// # Errors
/// On bad input, when a file exists already, or the format has no room for a column.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let recordings = arguments.reading.load(&arguments.inputs)?;
    let names = names(&recordings, arguments)?;
    let inputs: Vec<PathBuf> = recordings.iter().map(Recording::file).collect();
    let outputs: Vec<&Path> = names.iter().map(PathBuf::as_path).collect();
    output::refuse_overwriting(&inputs, &outputs)?;
    names.iter().try_for_each(|path| output::refuse_any(path))?;
    for (recording, path) in recordings.iter().zip(&names) {
        recording::write_as(path, recording, &output::provenance::line())?;
        let own =
            recording.input_signal == recording::Signal::pressure_bar() && recording.output_signal == recording::Signal::displacement_mm();
        let hint = match own {
            true => String::new(),
            false => {
                let (input, output) = (recording.input_signal.column(), recording.output_signal.column());
                format!("; read it with --columns time=time_s,input={input},output={output}")
            }
        };
        say!("{}: {} samples{hint}", path.display(), recording.len());
    }
    Ok(Outcome::Success)
}

/// The file of each recording.
fn names(recordings: &[Recording], arguments: &Arguments) -> Result<Vec<PathBuf>> {
    let Some(ending) = &arguments.to else {
        ensure!(
            recordings.len() == 1,
            "{} recordings were read: name a folder with --out and a format with --to, for example --to npz",
            recordings.len()
        );
        return Ok(vec![arguments.out.clone()]);
    };
    let mut names: Vec<PathBuf> = Vec::new();
    for recording in recordings {
        let name = recording.path.file_name().map_or_else(|| "recording".to_owned(), |name| name.to_string_lossy().into_owned());
        // Parts of one file are told apart by what stands behind the `#`.
        let (file, part) = match name.split_once('#') {
            Some((file, part)) if !recording.path.exists() => (file, format!("_{part}")),
            _ => (name.as_str(), String::new()),
        };
        let known = [&ENDINGS[..], &["tsv", "dat", "tsv.gz"]].concat();
        let stem = known.iter().rev().find_map(|known| file.strip_suffix(&format!(".{known}"))).unwrap_or(file);
        let plain: String =
            format!("{stem}{part}").chars().map(|letter| if matches!(letter, '/' | '\\' | '\0') { '_' } else { letter }).collect();
        let mut path = arguments.out.join(format!("{plain}.{ending}"));
        let mut number = 2;
        while names.contains(&path) {
            path = arguments.out.join(format!("{plain}_{number}.{ending}"));
            number += 1;
        }
        names.push(path);
    }
    Ok(names)
}
