//! Reading recordings: what is wrong is named with its line, nothing is skipped or filled in.

use std::path::{Path, PathBuf};

use csv::{ReaderBuilder, StringRecord, Trim};
use sha2::{Digest, Sha256};

use super::columns::OPTIONAL;
use super::{ColumnMap, ExtraColumn, Recording, RecordingError};

/// Reads all recordings under `paths` (files, or folders searched for `.csv` files recursively in sorted order); `columns` is the
/// text of a [`ColumnMap`] for foreign files.
///
/// # Errors
/// The first problem of the first bad file.
pub fn load(paths: &[PathBuf], columns: Option<&str>) -> Result<Vec<Recording>, RecordingError> {
    let map = columns.map_or_else(|| Ok(ColumnMap::own()), ColumnMap::parse)?;
    files(paths)?.iter().map(|path| read(path, &map)).collect::<Result<Vec<_>, _>>()
}

/// The CSV files under `paths`: files as given, folders searched recursively in sorted order without hidden files.
///
/// # Errors
/// When a path does not exist or a folder holds no CSV file.
pub fn files(paths: &[PathBuf]) -> Result<Vec<PathBuf>, RecordingError> {
    if paths.is_empty() {
        return Err(RecordingError::NoPaths);
    }
    let mut found = Vec::new();
    for path in paths {
        let open = |source| RecordingError::Open { path: path.clone(), source };
        if std::fs::metadata(path).map_err(open)?.is_dir() {
            let before = found.len();
            search(path, &mut found)?;
            if found.len() == before {
                return Err(RecordingError::NoFiles { path: path.clone() });
            }
        } else {
            found.push(path.clone());
        }
    }
    Ok(found)
}

/// Adds the CSV files of a folder and its subfolders.
fn search(folder: &Path, found: &mut Vec<PathBuf>) -> Result<(), RecordingError> {
    let open = |source| RecordingError::Open { path: folder.to_path_buf(), source };
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
            search(&entry, found)?;
        } else if entry.is_file() && entry.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv")) {
            found.push(entry);
        }
    }
    Ok(())
}

/// Reads one file.
///
/// # Errors
/// Any [`RecordingError`] about the file, with the line.
pub fn read(path: &Path, map: &ColumnMap) -> Result<Recording, RecordingError> {
    let open = |source| RecordingError::Open { path: path.to_path_buf(), source };
    if std::fs::metadata(path).map_err(open)?.is_dir() {
        return Err(RecordingError::IsFolder { path: path.to_path_buf() });
    }
    parse(path, &std::fs::read(path).map_err(open)?, map)
}

/// Reads a recording from the bytes of a file; `path` is only a name.
///
/// # Errors
/// Any [`RecordingError`] about the content, with the line.
pub fn parse(path: &Path, bytes: &[u8], map: &ColumnMap) -> Result<Recording, RecordingError> {
    let file = || path.to_path_buf();
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if let Err(error) = std::str::from_utf8(text) {
        let line = LineCounter { text, counted: 0, line: 1 }.line_at(error.valid_up_to() as u64 + 1);
        return Err(RecordingError::NotText { path: file(), line });
    }
    if text.iter().all(u8::is_ascii_whitespace) {
        return Err(RecordingError::Empty { path: file() });
    }
    let mut reader = ReaderBuilder::new().has_headers(false).flexible(true).trim(Trim::All).comment(Some(b'#')).from_reader(text);
    let mut row = StringRecord::new();
    let mut columns: Option<Columns> = None;
    let mut samples = Samples::default();
    let mut previous_end: Option<f64> = None;
    let mut lines = LineCounter { text, counted: 0, line: 1 };
    loop {
        // Note(unwrap): the text is in memory and UTF-8, and rows may be of any length.
        let more = reader.read_record(&mut row).expect("nothing is left that a reader could refuse");
        if !more {
            break;
        }
        let line = lines.line_at(reader.position().byte());
        // A line of blanks says nothing, wherever it stands.
        if row.len() == 1 && row[0].is_empty() {
            continue;
        }
        let Some(columns) = &columns else {
            columns = Some(Columns::find(path, line, &row, map)?);
            continue;
        };
        if row.len() != columns.count {
            return Err(RecordingError::Ragged { path: file(), line, cells: row.len(), columns: columns.count });
        }
        let cell = |index: usize| number(path, line, &columns.headers[index], &row[index]);
        let time_s = cell(columns.time)? * map.time_unit_s;
        if let Some(previous_s) = previous_end.replace(time_s)
            && time_s <= previous_s
        {
            return Err(RecordingError::TimeNotIncreasing { path: file(), line, previous_s, time_s });
        }
        samples.time_s.push(time_s);
        samples.input.push(cell(columns.input)?);
        samples.output.push(cell(columns.output)?);
        samples.extra.resize(columns.extra.len(), Vec::new());
        for (values, &index) in samples.extra.iter_mut().zip(&columns.extra) {
            values.push(cell(index)?);
        }
        if let Some(sequence) = columns.sequence {
            samples.check_sequence(path, line, &row[columns.extra[sequence]], sequence)?;
        }
    }
    // The header was found: the text is not blank.
    let Some(columns) = columns else { return Err(RecordingError::Empty { path: file() }) };
    let Samples { time_s, input, output, extra, lost } = samples;
    let mut recording = Recording::new(path, map.input.signal.clone(), map.output.signal.clone(), time_s, input, output)?;
    recording.gaps.extend(lost);
    recording.gaps.sort_unstable();
    recording.gaps.dedup();
    let names = columns.extra.iter().map(|&index| columns.headers[index].clone());
    recording.extra = names.zip(extra).map(|(name, values)| ExtraColumn { name, values }).collect();
    recording.sha256 = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(recording)
}

/// Counts lines: the reader's own position of a row is that of the blank lines above it.
struct LineCounter<'a> {
    text: &'a [u8],
    counted: usize,
    line: u64,
}

impl LineCounter<'_> {
    /// The line of the row that ends (with its line end) at this byte; ask in ascending order.
    fn line_at(&mut self, end: u64) -> u64 {
        let last = usize::try_from(end).map_or(self.text.len(), |end| end.min(self.text.len())).saturating_sub(1);
        if let Some(passed) = self.text.get(self.counted..last) {
            self.line += passed.iter().filter(|&&byte| byte == b'\n').count() as u64;
            self.counted = last;
        }
        self.line
    }
}

/// What was read so far.
#[derive(Default)]
struct Samples {
    time_s: Vec<f64>,
    input: Vec<f64>,
    output: Vec<f64>,
    extra: Vec<Vec<f64>>,
    /// Index of the first sample after each jump of the sequence number.
    lost: Vec<usize>,
}

impl Samples {
    /// Checks the newest sequence number against the one before and notes a jump.
    fn check_sequence(&mut self, path: &Path, line: u64, text: &str, column: usize) -> Result<(), RecordingError> {
        let values = &self.extra[column];
        let newest = values[values.len() - 1];
        let previous = values.len().checked_sub(2).map(|index| values[index]);
        if newest.fract() != 0.0 || newest < 0.0 || previous.is_some_and(|previous| newest <= previous) {
            return Err(RecordingError::Sequence { path: path.to_path_buf(), line, text: text.to_owned() });
        }
        if previous.is_some_and(|previous| newest > previous + 1.0) {
            self.lost.push(values.len() - 1);
        }
        Ok(())
    }
}

/// Where the wanted columns stand.
struct Columns {
    headers: Vec<String>,
    count: usize,
    time: usize,
    input: usize,
    output: usize,
    /// Optional columns of our own format.
    extra: Vec<usize>,
    /// Position of `sequence` among `extra`.
    sequence: Option<usize>,
}

impl Columns {
    fn find(path: &Path, line: u64, header: &StringRecord, map: &ColumnMap) -> Result<Self, RecordingError> {
        let file = || path.to_path_buf();
        let headers: Vec<String> = header.iter().map(str::to_owned).collect();
        if headers.iter().all(|name| name.parse::<f64>().is_ok()) {
            return Err(RecordingError::NoHeader { path: file(), line });
        }
        if headers.len() == 1 {
            for (character, separator) in [(';', "semicolons"), ('\t', "tabs"), (' ', "spaces")] {
                if headers[0].contains(character) {
                    return Err(RecordingError::Separator { path: file(), line, separator });
                }
            }
        }
        let known = |name: &str| name == map.time.header || name == map.input.header || name == map.output.header;
        for (index, name) in headers.iter().enumerate() {
            let wanted = known(name) || (map.own && OPTIONAL.contains(&name.as_str()));
            if wanted && headers[..index].contains(name) {
                return Err(RecordingError::DuplicateColumn { path: file(), line, column: name.clone() });
            }
        }
        let find = |column: &str| {
            headers.iter().position(|name| name == column).ok_or_else(|| RecordingError::MissingColumn {
                path: file(),
                line,
                column: column.to_owned(),
                found: headers.join(","),
                hint: if map.own {
                    "say which columns to read, for example `--columns time=t_s,input=voltage_V,output=displacement_um`".to_owned()
                } else {
                    "correct the name in --columns".to_owned()
                },
            })
        };
        let (time, input, output) = (find(&map.time.header)?, find(&map.input.header)?, find(&map.output.header)?);
        let mut extra = Vec::new();
        if map.own {
            for (index, name) in headers.iter().enumerate().filter(|(_, name)| !known(name)) {
                if !OPTIONAL.contains(&name.as_str()) {
                    return Err(RecordingError::UnknownColumn { path: file(), line, column: name.clone() });
                }
                extra.push(index);
            }
        }
        let sequence = extra.iter().position(|&index| headers[index] == "sequence");
        Ok(Self { count: headers.len(), headers, time, input, output, extra, sequence })
    }
}

/// The finite number in a cell.
fn number(path: &Path, line: u64, column: &str, text: &str) -> Result<f64, RecordingError> {
    let place = || (path.to_path_buf(), column.to_owned(), text.to_owned());
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => {
            let (path, column, text) = place();
            Err(RecordingError::NotFinite { path, line, column, text })
        }
        Err(_) => {
            let (path, column, text) = place();
            Err(RecordingError::NotANumber { path, line, column, text })
        }
    }
}
