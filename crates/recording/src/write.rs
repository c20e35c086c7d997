//! Writing recordings: whole or not at all, with as many digits as it takes to read the same numbers back.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::format::{self, Kind};
use super::{Recording, RecordingError};

/// Writes a recording as CSV, atomically. Reading it back gives the same bits.
///
/// # Errors
/// When a column's length differs, or the file cannot be written.
pub fn write(path: &Path, recording: &Recording) -> Result<(), RecordingError> {
    check_lengths(path, recording)?;
    output::write_atomic(path, encode(recording).as_bytes())
        .map_err(|error| RecordingError::Write { path: path.into(), problem: format!("{error:#}") })
}

/// Endings of the files that [`write_as`] writes.
pub const ENDINGS: [&str; 5] = ["csv", "csv.gz", "npz", "mat", "mcap"];

/// Writes a recording in the format that the file's name ends in, one of [`ENDINGS`], with a line on where it came from. Reading it back gives
/// the same bits.
///
/// # Errors
/// When the ending is another one, the format has no room for something, or the file cannot be written.
pub fn write_as(path: &Path, recording: &Recording, provenance: &str) -> Result<(), RecordingError> {
    check_lengths(path, recording)?;
    let name = path.to_string_lossy().to_ascii_lowercase();
    let problem = |problem: String| RecordingError::Write { path: path.into(), problem };
    let text = || match provenance.is_empty() {
        true => encode(recording),
        false => format!("# {}\n{}", provenance.replace(['\n', '\r'], " "), encode(recording)),
    };
    let bytes = match ENDINGS.into_iter().rev().find(|ending| name.ends_with(&format!(".{ending}"))) {
        Some("csv") => text().into_bytes(),
        Some("csv.gz") => {
            let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(text().as_bytes()).and_then(|()| encoder.finish()).map_err(|error| problem(error.to_string()))?
        }
        Some("npz") => format::encode(Kind::Npz, recording, provenance).map_err(problem)?,
        Some("mat") => format::encode(Kind::Mat, recording, provenance).map_err(problem)?,
        Some("mcap") => format::encode(Kind::Mcap, recording, provenance).map_err(problem)?,
        _ => return Err(problem(format!("the name must end in one of .{}", ENDINGS.join(", .")))),
    };
    output::write_atomic(path, &bytes).map_err(|error| problem(format!("{error:#}")))
}

/// All columns have one value a sample.
fn check_lengths(path: &Path, recording: &Recording) -> Result<(), RecordingError> {
    let rows = recording.len();
    let more = recording.more_inputs.iter().map(|channel| &channel.values);
    let mut columns = more.chain(recording.extra.iter().map(|extra| &extra.values));
    if recording.input.len() != rows || recording.output.len() != rows || columns.any(|values| values.len() != rows) {
        let (input, output) = (recording.input.len(), recording.output.len());
        return Err(RecordingError::Lengths { path: path.into(), time: rows, input, output });
    }
    Ok(())
}

/// The text of the CSV file: one header line, `\n` line ends.
#[must_use]
pub fn encode(recording: &Recording) -> String {
    let mut text = format!("time_s,{}", recording.input_signal.column());
    for signal in recording.more_inputs.iter().map(|channel| &channel.signal).chain([&recording.output_signal]) {
        text.push(',');
        text.push_str(&signal.column());
    }
    for extra in &recording.extra {
        text.push(',');
        text.push_str(&extra.name);
    }
    text.push('\n');
    for index in 0..recording.len() {
        push(&mut text, recording.time_s[index]);
        for value in recording.inputs().into_iter().map(|values| values[index]).chain([recording.output[index]]) {
            text.push(',');
            push(&mut text, value);
        }
        for extra in &recording.extra {
            text.push(',');
            push(&mut text, extra.values[index]);
        }
        text.push('\n');
    }
    text
}

/// Adds the shortest decimal that reads back as the same number.
fn push(text: &mut String, value: f64) {
    let plain = value == 0.0 || (1e-5..1e15).contains(&value.abs());
    // Note(unwrap): writing into a String cannot fail.
    if plain { write!(text, "{value}") } else { write!(text, "{value:e}") }.expect("a String takes any text");
}
