//! A recording that somebody has: read as every command reads it, and put beside those that were made here.

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::json;

use crate::audit;
use crate::recorder::check_name;

/// A larger file is not taken: it is held in memory while it is read.
pub(crate) const MOST_BYTES: usize = 128 << 20;

/// A file as it came.
#[derive(Clone, Copy, Debug)]
pub struct Foreign<'a> {
    /// Its name, for what is said of it.
    pub name: &'a str,
    /// Its bytes.
    pub bytes: &'a [u8],
    /// What its columns mean, as `--columns` says it.
    pub columns: Option<&'a str>,
}

/// What was read of it.
#[derive(Clone, Debug, Serialize)]
pub struct Loaded {
    /// How many samples there are.
    pub samples: usize,
    /// How long it is, s.
    pub seconds: f64,
    /// SHA-256 of the file.
    pub sha256: String,
    /// What reading chose and found.
    pub notes: Vec<String>,
}

/// Reads a file and writes it as a CSV with the columns of a recording made here; the error is why it is none.
pub type Loader = fn(&Foreign<'_>, &Path) -> Result<Loaded, String>;

/// A file that goes away again unless it is kept.
struct Reserved(Option<PathBuf>);

impl Drop for Reserved {
    fn drop(&mut self) {
        if let Some(path) = self.0.take() {
            let _ = std::fs::remove_file(path);
        }
    }
}

/// Loads a file as the recording `name`; there must be none of that name.
pub(crate) fn load(loader: Loader, folder: &Path, name: &str, file: &Foreign<'_>) -> Result<Loaded, String> {
    check_name(name)?;
    let path = folder.join(format!("{name}.csv"));
    // Nobody else takes the name meanwhile.
    OpenOptions::new().write(true).create_new(true).open(&path).map_err(|error| match error.kind() {
        std::io::ErrorKind::AlreadyExists => format!("there is a recording {name} already; choose another name"),
        _ => format!("{}: cannot be written ({error})", path.display()),
    })?;
    let mut reserved = Reserved(Some(path.clone()));
    let loaded = loader(file, &path)?;
    let about = json!({
        "name": name, "note": format!("loaded from {}", file.name), "begun": audit::now(), "samples": loaded.samples, "left_out": 0,
        "seconds": loaded.seconds, "source": { "file": file.name, "sha256": loaded.sha256, "columns": file.columns }, "notes": loaded.notes,
        "written_by": concat!("catheter dashboard ", env!("CARGO_PKG_VERSION")),
    });
    let beside = path.with_extension("json");
    std::fs::write(&beside, format!("{about:#}\n")).map_err(|error| format!("{}: {error}", beside.display()))?;
    reserved.0 = None;
    Ok(loaded)
}
