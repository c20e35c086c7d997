//! What can be wrong with a recording; every message names the file, the line where there is one, and what to do.

use std::path::PathBuf;

/// Why a recording could not be read or written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what each field is")]
pub enum RecordingError {
    /// The file or folder does not exist or cannot be opened.
    #[error("{}: cannot be read ({reason}); check the path and its permissions", path.display())]
    Open { path: PathBuf, reason: std::io::Error },
    /// A folder was given where one file is wanted.
    #[error("{}: is a folder, a CSV file is wanted here; name one of the files in it", path.display())]
    IsFolder { path: PathBuf },
    /// A folder without any CSV file.
    #[error("{}: the folder and its subfolders hold no .csv file, and no .csv.gz, .npz, .mat or .mcap; point to the folder with the recordings", path.display())]
    NoFiles { path: PathBuf },
    /// No path at all.
    #[error("no recordings were given; name at least one CSV file or folder")]
    NoPaths,
    /// Nothing in the file.
    #[error("{}: the file is empty; a header line such as `time_s,pressure_bar,displacement_mm` and rows are wanted", path.display())]
    Empty { path: PathBuf },
    /// Bytes that are not UTF-8 text.
    #[error("{}:{line}: the text is not UTF-8; save the file again as CSV in UTF-8", path.display())]
    NotText { path: PathBuf, line: u64 },
    /// The first line is data.
    #[error("{}:{line}: the first line holds numbers, not column names; put a header line such as `time_s,pressure_bar,displacement_mm` on top", path.display())]
    NoHeader { path: PathBuf, line: u64 },
    /// A wanted column does not exist.
    #[error("{}: there is no column `{column}` (the file has {found}); {hint}", place(path, *line))]
    MissingColumn { path: PathBuf, line: u64, column: String, found: String, hint: String },
    /// A column name occurs twice.
    #[error("{}: the column `{column}` occurs twice; remove or rename one", place(path, *line))]
    DuplicateColumn { path: PathBuf, line: u64, column: String },
    /// A column that our own format does not know.
    #[error("{}:{line}: the column `{column}` is not part of our format; remove it, or say which columns to read with `--columns time=time_s,input=pressure_bar,output=displacement_mm`", path.display())]
    UnknownColumn { path: PathBuf, line: u64, column: String },
    /// More columns than a recording has.
    #[error("{}:{line}: the row has {columns} columns, up to 4096 are read; is this a table of another kind?", path.display())]
    TooManyColumns { path: PathBuf, line: u64, columns: usize },
    /// A line without an end.
    #[error("{}:{line}: the line is longer than 1 MB; is this a text file with a row a line?", path.display())]
    LongLine { path: PathBuf, line: u64 },
    /// More samples than fit.
    #[error("{}:{line}: the file holds more than 50 million numbers; split it into several files, or record at a lower rate", path.display())]
    TooLong { path: PathBuf, line: u64 },
    /// A compressed file that unfolds into far more than a recording does.
    #[error("{}: unfolds to more than {times} times its size; is this a recording? Unpack it and look", path.display())]
    Unfolds { path: PathBuf, times: u64 },
    /// A file of another kind, or a damaged one.
    #[error("{}: {problem}", path.display())]
    Format { path: PathBuf, problem: String },
    /// Arrays that should have one value a sample.
    #[error("{}: `{column}` has {rows} values and `{other}` has {other_rows}; the arrays of a recording must be equally long", path.display())]
    UnequalArrays { path: PathBuf, column: String, rows: usize, other: String, other_rows: usize },
    /// A number that no sensor gives.
    #[error("{}:{line}: column `{column}` holds {}, which no sensor gives in any unit; correct or remove the row", path.display(), shown(text))]
    TooLarge { path: PathBuf, line: u64, column: String, text: String },
    /// A signal that is nearly nothing.
    #[error("{}: `{column}` never exceeds {most:e}, which no sensor gives in any unit; check the columns and their units", path.display())]
    TooSmall { path: PathBuf, column: String, most: f64 },
    /// A clock that runs faster than any logger.
    #[error("{}: a sample every {period_s:e} s, that is {rate_hz:e} a second; is the time column in another unit? Say it, for example `--columns time=t:s,...`", path.display())]
    TooFast { path: PathBuf, period_s: f64, rate_hz: f64 },
    /// An even clock that would need far more samples than were recorded.
    #[error("{}: on an even clock of {period_s} s it would have {samples:e} samples instead of {recorded}; give --resample a {} period", path.display(), if *samples < 1.0 { "shorter" } else { "longer" })]
    Resample { path: PathBuf, period_s: f64, samples: f64, recorded: usize },
    /// A recording of which nothing is left.
    #[error("{}: lasts {length_s:e} s, and --skip-s leaves out {skip_s:e} s; skip less", path.display())]
    Skipped { path: PathBuf, length_s: f64, skip_s: f64 },
    /// The map of columns cannot be understood.
    #[error("--columns `{text}`: {problem}; write for example `time=t_s,input=voltage_V,output=displacement_um`")]
    Columns { text: String, problem: String },
    /// A header and nothing below it, or a single row.
    #[error("{}: has {rows} row(s) of data, at least two are needed; was the recording interrupted?", path.display())]
    TooShort { path: PathBuf, rows: usize },
    /// A row with more or fewer cells than the header.
    #[error("{}:{line}: the row has {cells} cell(s), the header has {columns}; was the file cut off or edited? Correct or remove the row", path.display())]
    Ragged { path: PathBuf, line: u64, cells: usize, columns: usize },
    /// A cell that is no number.
    #[error("{}:{line}: column `{column}` holds {}, a number is wanted; correct or remove the row", path.display(), shown(text))]
    NotANumber { path: PathBuf, line: u64, column: String, text: String },
    /// A cell that is infinite or not a number.
    #[error("{}:{line}: column `{column}` holds {}, a finite number is wanted; remove the row (a gap is better than an invented value)", path.display(), shown(text))]
    NotFinite { path: PathBuf, line: u64, column: String, text: String },
    /// A time that stands still or runs backwards for good.
    #[error("{}:{line}: the time {time_s} s does not come after the {previous_s} s of the row before; were two recordings joined? Split them into files of their own, or name the column that tells them apart with `recording=`; a clock that stands still is replaced by --rate-hz", path.display())]
    TimeNotIncreasing { path: PathBuf, line: u64, previous_s: f64, time_s: f64 },
    /// A sequence number that is no whole number or does not increase.
    #[error("{}:{line}: the sequence number {text} is not a whole number above that of the row before; were two recordings joined? Split them into files of their own", path.display())]
    Sequence { path: PathBuf, line: u64, text: String },
    /// A sampling rate that is none.
    #[error("--rate-hz {rate_hz}: the sampling rate must be above zero; write for example --rate-hz 100")]
    Rate { rate_hz: f64 },
    /// Several recordings where one is wanted.
    #[error("{}: holds {count} recordings, one is wanted here; put it into a file of its own", path.display())]
    Several { path: PathBuf, count: usize },
    /// Columns of unequal length, in memory.
    #[error("{}: {time} times, {input} inputs and {output} outputs; the lengths must be equal", path.display())]
    Lengths { path: PathBuf, time: usize, input: usize, output: usize },
    /// Writing failed.
    #[error("{}: cannot be written ({problem}); check the folder and the free space", path.display())]
    Write { path: PathBuf, problem: String },
}

/// File and line; binary files have no lines.
fn place(path: &std::path::Path, line: u64) -> String {
    if line == 0 { path.display().to_string() } else { format!("{}:{line}", path.display()) }
}

/// A cell as shown in a message: quoted, shortened, an empty one called so.
fn shown(text: &str) -> String {
    if text.is_empty() {
        return "nothing".to_owned();
    }
    let short: String = text.chars().take(40).collect();
    if short.len() < text.len() { format!("`{short}…`") } else { format!("`{short}`") }
}
