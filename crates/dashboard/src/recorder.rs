//! A recording of what is live: a CSV that every command reads, and beside it what it is.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::json;

use crate::audit;
use crate::rig::{Identity, Sample};

/// The columns of a recording.
pub(crate) const HEADER: &str = "time_s,pressure_bar,displacement_mm,pressure_measured_bar,sequence";

/// A name leads nowhere but into the folder.
pub(crate) fn check_name(name: &str) -> Result<(), String> {
    let sound = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '-' | '_' | '.');
    if name.is_empty() || name.len() > 80 || name.starts_with('.') || !name.chars().all(sound) {
        return Err("the name of a recording has letters, digits, `-`, `_` and `.`, at most 80, and does not begin with a dot".to_owned());
    }
    Ok(())
}

/// What a recording has so far.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Progress {
    pub name: String,
    pub samples: u32,
    pub left_out: u32,
    pub seconds: f64,
}

/// A recording that runs.
pub(crate) struct Recorder {
    path: PathBuf,
    file: BufWriter<File>,
    note: String,
    begun: String,
    first: Option<Sample>,
    progress: Progress,
}

impl Recorder {
    /// Begins a recording in the folder; a file of that name must not be there.
    pub fn begin(folder: &Path, name: &str, note: &str) -> Result<Self, String> {
        check_name(name)?;
        let path = folder.join(format!("{name}.csv"));
        let file = OpenOptions::new().write(true).create_new(true).open(&path);
        let file = file.map_err(|error| match error.kind() {
            std::io::ErrorKind::AlreadyExists => format!("there is a recording {name} already; choose another name"),
            _ => format!("{}: cannot be written ({error})", path.display()),
        })?;
        let mut file = BufWriter::new(file);
        // At once, for a recording is known by it should the server die.
        writeln!(file, "{HEADER}").and_then(|()| file.flush()).map_err(|error| format!("{}: {error}", path.display()))?;
        let progress = Progress { name: name.to_owned(), samples: 0, left_out: 0, seconds: 0.0 };
        Ok(Self { path, file, note: note.to_owned(), begun: audit::now(), first: None, progress })
    }

    /// Writes a sample; one without a believed displacement or pressure is left out, which makes a gap.
    pub fn write(&mut self, sample: &Sample) -> Result<(), String> {
        let (Some(displacement_mm), Some(pressure_bar)) = (sample.displacement_mm, sample.pressure_bar) else {
            self.progress.left_out += 1;
            return Ok(());
        };
        let first = *self.first.get_or_insert(*sample);
        let time_s = sample.time_ms.saturating_sub(first.time_ms) as f64 * 1e-3;
        let sequence = sample.sequence.wrapping_sub(first.sequence);
        self.progress.samples += 1;
        self.progress.seconds = time_s;
        writeln!(self.file, "{time_s},{},{displacement_mm},{pressure_bar},{sequence}", sample.command_bar)
            .map_err(|error| format!("{}: {error}", self.path.display()))
    }

    /// What it has so far.
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// Ends it, and writes down what it is.
    pub fn end(mut self, identity: &Identity) -> Result<Progress, String> {
        let problem = |error: std::io::Error| format!("{}: {error}", self.path.display());
        self.file.flush().map_err(problem)?;
        // A disk may take its time; heartbeats cannot wait for it.
        if let Ok(file) = self.file.get_ref().try_clone() {
            std::thread::spawn(move || file.sync_all());
        }
        let Progress { name, samples, left_out, seconds } = &self.progress;
        let about = json!({
            "name": name, "note": self.note, "begun": self.begun, "samples": samples, "left_out": left_out, "seconds": seconds,
            "place": identity.place, "board": identity.board, "firmware": identity.firmware, "plant": identity.plant,
            "written_by": concat!("catheter dashboard ", env!("CARGO_PKG_VERSION")),
        });
        let path = self.path.with_extension("json");
        std::fs::write(&path, format!("{about:#}\n")).map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(self.progress)
    }
}
