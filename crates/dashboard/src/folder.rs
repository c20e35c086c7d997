//! The recordings in the session's folder, and what each of them is: files of others may lie beside them, and a server may have died.

use std::fs::{DirEntry, File};
use std::io::{BufRead, BufReader, Read as _};
use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use crate::recorder::HEADER;

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum State {
    /// It is being recorded.
    Running,
    /// It was recorded to its end.
    Complete,
    /// A recording that nobody ended: the server died first, and its last row may be cut.
    Interrupted,
    /// Somebody put it here.
    Foreign,
}

/// A file of the folder.
#[derive(Debug, Serialize)]
pub(crate) struct Entry {
    name: String,
    bytes: u64,
    state: State,
    /// What the recorder wrote beside it at its end.
    about: Option<Value>,
}

/// The CSV files of a folder, the newest last, as if nothing were recorded now.
pub(crate) fn list(folder: &Path) -> Vec<Entry> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<Entry> = entries.filter_map(|entry| of(&entry)).collect();
    let begun = |entry: &Entry| entry.about.as_ref().and_then(|about| about["begun"].as_str()).unwrap_or_default().to_owned();
    found.sort_by_cached_key(|entry| (begun(entry), entry.name.clone()));
    found
}

/// Marks the recording of this name as one that runs, unless it has ended since.
pub(crate) fn mark_running(entries: &mut [Entry], name: &str) {
    entries.iter_mut().filter(|entry| entry.name == name && entry.about.is_none()).for_each(|entry| entry.state = State::Running);
}

fn of(entry: &DirEntry) -> Option<Entry> {
    let path = entry.path();
    let name = path.file_stem()?.to_str().filter(|_| path.extension().is_some_and(|kind| kind == "csv"))?.to_owned();
    let about = about(&path);
    let state = match &about {
        Some(_) => State::Complete,
        None if has_our_header(&path) => State::Interrupted,
        None => State::Foreign,
    };
    Some(Entry { name, bytes: entry.metadata().map_or(0, |about| about.len()), state, about })
}

/// What stands beside a recording; another program's JSON says nothing about it.
fn about(path: &Path) -> Option<Value> {
    let about: Value = serde_json::from_slice(&std::fs::read(path.with_extension("json")).ok()?).ok()?;
    (about["samples"].is_u64() && about["seconds"].is_number()).then_some(about)
}

fn has_our_header(path: &Path) -> bool {
    let mut line = String::new();
    let read = File::open(path).and_then(|file| BufReader::new(file.take(2 * HEADER.len() as u64)).read_line(&mut line));
    read.is_ok() && line.trim_end() == HEADER
}
