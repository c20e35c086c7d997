//! Reading recordings: what is wrong is named with its line, what is repaired is noted, nothing is filled in.

use std::io::{Cursor, Read as _};
use std::path::{Path, PathBuf};

use super::hashed::Hashed;
use super::lines::Lines;
use super::parts::{self, Part};
use super::text;
use super::unfold::Unfold;
use super::{ColumnMap, ReadOptions, Recording, RecordingError, format, groups, header, prepare};

/// Reads all recordings under `paths` (files, or folders searched for `.csv` files recursively in sorted order); `columns` is the
/// text of a [`ColumnMap`] for foreign files.
///
/// # Errors
/// The first problem of the first bad file.
pub fn load(paths: &[PathBuf], columns: Option<&str>) -> Result<Vec<Recording>, RecordingError> {
    load_with(paths, &ReadOptions::columns(columns))
}

/// Endings of text, our own first, and of other files.
const TEXT: [&str; 5] = ["csv", "csv.gz", "tsv", "dat", "tsv.gz"];
const BINARY: [&str; 3] = ["npz", "mat", "mcap"];

/// Reads all recordings under `paths` as the options say, groups and prepares them. A folder is searched for text (`.csv` and `.csv.gz`, with
/// a map of columns also `.tsv` and `.dat`); where it has none, for `.npz`, `.mat` and `.mcap`: a folder may hold the same recordings twice.
///
/// # Errors
/// The first problem of the first bad file.
pub fn load_with(paths: &[PathBuf], options: &ReadOptions) -> Result<Vec<Recording>, RecordingError> {
    let map = options.map()?;
    let mut recordings = Vec::new();
    for path in files_named(paths, if map.own { &TEXT[..2] } else { &TEXT })? {
        recordings.extend(read_parts(&path, &map)?);
    }
    groups::assign(&mut recordings);
    prepare::prepare(recordings, &options.prepare)
}

/// The CSV files under `paths`: files as given, folders searched recursively in sorted order without hidden files.
///
/// # Errors
/// When a path does not exist or a folder holds no CSV file.
pub fn files(paths: &[PathBuf]) -> Result<Vec<PathBuf>, RecordingError> {
    files_named(paths, &TEXT[..2])
}

/// The same for files with one of these extensions.
fn files_named(paths: &[PathBuf], extensions: &[&str]) -> Result<Vec<PathBuf>, RecordingError> {
    if paths.is_empty() {
        return Err(RecordingError::NoPaths);
    }
    let mut found = Vec::new();
    for path in paths {
        let open = |reason| RecordingError::Open { path: path.clone(), reason };
        if std::fs::metadata(path).map_err(open)?.is_dir() {
            let before = found.len();
            search(path, extensions, &mut found)?;
            if found.len() == before {
                search(path, &BINARY, &mut found)?;
            }
            if found.len() == before {
                return Err(RecordingError::NoFiles { path: path.clone() });
            }
        } else {
            found.push(path.clone());
        }
    }
    Ok(found)
}

/// Adds the files with these extensions of a folder and its subfolders.
fn search(folder: &Path, extensions: &[&str], found: &mut Vec<PathBuf>) -> Result<(), RecordingError> {
    let open = |reason| RecordingError::Open { path: folder.to_path_buf(), reason };
    let entries = std::fs::read_dir(folder).map_err(open)?.collect::<Result<Vec<_>, _>>().map_err(open)?;
    let mut entries: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).collect();
    entries.sort();
    for entry in entries {
        let hidden = entry.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        let is_link = std::fs::symlink_metadata(&entry).map_err(open)?.file_type().is_symlink();
        if hidden {
            continue;
        }
        // A link to a folder could lead in a circle; a link to a file is a file.
        if entry.is_dir() && !is_link {
            search(&entry, extensions, found)?;
        } else if entry.is_file() && has_ending(&entry, extensions) {
            found.push(entry);
        }
    }
    Ok(())
}

/// Whether a file's name ends in one of these, whatever their case.
fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let name = path.file_name().map(|name| name.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    endings.iter().any(|ending| name.strip_suffix(ending).is_some_and(|stem| stem.len() > 1 && stem.ends_with('.')))
}

/// Reads one file that holds one recording.
///
/// # Errors
/// Any [`RecordingError`] about the file, with the line.
pub fn read(path: &Path, map: &ColumnMap) -> Result<Recording, RecordingError> {
    single(path, read_parts(path, map)?)
}

/// Reads a recording from the bytes of a file that holds one; `path` is only a name.
///
/// # Errors
/// Any [`RecordingError`] about the content, with the line.
pub fn parse(path: &Path, bytes: &[u8], map: &ColumnMap) -> Result<Recording, RecordingError> {
    single(path, parse_parts(path, bytes, map)?)
}

fn single(path: &Path, mut recordings: Vec<Recording>) -> Result<Recording, RecordingError> {
    match recordings.len() {
        1 => Ok(recordings.remove(0)),
        count => Err(RecordingError::Several { path: path.to_path_buf(), count }),
    }
}

/// Reads all recordings of one file.
fn read_parts(path: &Path, map: &ColumnMap) -> Result<Vec<Recording>, RecordingError> {
    let open = |reason| RecordingError::Open { path: path.to_path_buf(), reason };
    if std::fs::metadata(path).map_err(open)?.is_dir() {
        return Err(RecordingError::IsFolder { path: path.to_path_buf() });
    }
    parts_of(path, output::open(path).map_err(open)?, map)
}

/// Reads all recordings from the bytes of a file; `path` is only a name.
fn parse_parts(path: &Path, bytes: &[u8], map: &ColumnMap) -> Result<Vec<Recording>, RecordingError> {
    parts_of(path, bytes, map)
}

/// Reads all recordings from a stream of bytes. Text goes by line by line and is never in memory as a whole.
fn parts_of(path: &Path, stream: impl std::io::Read, map: &ColumnMap) -> Result<Vec<Recording>, RecordingError> {
    let open = |reason| RecordingError::Open { path: path.to_path_buf(), reason };
    let mut stream = Hashed::new(stream);
    let mut head = Vec::new();
    (&mut stream).take(128).read_to_end(&mut head).map_err(open)?;
    let kind = format::kind(path, &head)?;
    let mut whole = Cursor::new(head).chain(&mut stream);
    let read = match kind {
        format::Kind::Text => text::read(path, &mut Lines::new(&mut whole), map)?,
        format::Kind::Gzip => {
            let mut lines = Lines::new(Unfold::new(&mut whole));
            text::read(path, &mut lines, map).map_err(|error| match error {
                RecordingError::Open { reason, .. } => unfolding(path, &reason),
                other => other,
            })?
        }
        kind => {
            let mut bytes = Vec::new();
            (&mut whole).take(output::MOST_BYTES + 1).read_to_end(&mut bytes).map_err(open)?;
            if bytes.len() as u64 > output::MOST_BYTES {
                let problem = format!("is larger than {} MB; save it as CSV, or in pieces", output::MOST_BYTES >> 20);
                return Err(RecordingError::Format { path: path.to_path_buf(), problem });
            }
            let is_wanted =
                |names: &[String]| map.with_own_units(names).main_columns().all(|column| header::position(names, &column.header).is_some());
            parts::read_arrays(path, format::arrays(path, kind, &bytes, &is_wanted)?, map)?
        }
    };
    let sha256 = stream.finish().map_err(open)?;
    output::provenance::read(path, &sha256);
    recordings_of(path, read, map, &sha256)
}

/// The error of a compressed file that cannot be unfolded.
fn unfolding(path: &Path, error: &std::io::Error) -> RecordingError {
    let path = path.to_path_buf();
    match super::unfold::times(error) {
        Some(times) => RecordingError::Unfolds { path, times },
        None => RecordingError::Format { path, problem: format!("is a damaged gzip file ({error}); copy it again") },
    }
}

fn recordings_of(path: &Path, read: parts::Read, map: &ColumnMap, sha256: &str) -> Result<Vec<Recording>, RecordingError> {
    let parts::Read { columns, parts, notes } = read;
    let mut recordings: Vec<Recording> = Vec::with_capacity(parts.len());
    let several = parts.len() > 1;
    for part in parts {
        let name = if several { part_path(path, &part, &recordings) } else { path.to_path_buf() };
        let mut recording = part.into_recording(path, &name, map, &columns)?;
        recording.notes.splice(0..0, notes.iter().cloned());
        recordings.push(recording);
    }
    // The header was found: the text is not blank.
    if recordings.is_empty() {
        return Err(RecordingError::TooShort { path: path.to_path_buf(), rows: 0 });
    }
    recordings.iter_mut().for_each(|recording| sha256.clone_into(&mut recording.sha256));
    Ok(recordings)
}

/// `file.csv#part`, with a running number where the name of the part occurred before.
fn part_path(path: &Path, part: &Part, before: &[Recording]) -> PathBuf {
    let name = format!("{}#{}", path.display(), part.name);
    let taken = |name: &str| before.iter().any(|recording| recording.path == Path::new(name));
    let mut unique = name.clone();
    let mut number = 2;
    while taken(&unique) {
        unique = format!("{name}-{number}");
        number += 1;
    }
    PathBuf::from(unique)
}
