//! Writing recordings: whole or not at all, with as many digits as it takes to read the same numbers back.

use std::fmt::Write as _;
use std::path::Path;

use super::{Recording, RecordingError};

/// Writes a recording as CSV, atomically. Reading it back gives the same bits.
///
/// # Errors
/// When a column's length differs, or the file cannot be written.
pub fn write(path: &Path, recording: &Recording) -> Result<(), RecordingError> {
    let rows = recording.len();
    let more = recording.more_inputs.iter().map(|channel| &channel.values);
    let mut columns = more.chain(recording.extra.iter().map(|extra| &extra.values));
    if recording.input.len() != rows || recording.output.len() != rows || columns.any(|values| values.len() != rows) {
        let (input, output) = (recording.input.len(), recording.output.len());
        return Err(RecordingError::Lengths { path: path.into(), time: rows, input, output });
    }
    output::write_atomic(path, encode(recording).as_bytes())
        .map_err(|error| RecordingError::Write { path: path.into(), problem: format!("{error:#}") })
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
