//! Binary files of recordings: archives of numpy, MAT files, MCAP. Each is read into named arrays and written from them.

mod mat;
mod mcap_file;
mod npz;

use std::path::Path;

use super::arrays::Arrays;
use super::{Recording, RecordingError};

/// What a file is, by how it begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Rows of text.
    Text,
    /// Text, compressed.
    Gzip,
    /// `np.savez`.
    Npz,
    /// MATLAB, version 5 (also called 6 and 7).
    Mat,
    /// Foxglove's container.
    Mcap,
}

/// Recognises a file by its first bytes.
///
/// # Errors
/// For files that people take for recordings and that are none we read, with what to do.
pub(super) fn kind(path: &Path, head: &[u8]) -> Result<Kind, RecordingError> {
    let refuse = |problem: &str| Err(RecordingError::Format { path: path.to_path_buf(), problem: problem.to_owned() });
    match head {
        [0x1f, 0x8b, ..] => Ok(Kind::Gzip),
        [b'P', b'K', 3 | 5, 4 | 6, ..] => Ok(Kind::Npz),
        [0x89, b'M', b'C', b'A', b'P', ..] => Ok(Kind::Mcap),
        [0x93, b'N', b'U', b'M', b'P', b'Y', ..] => refuse(
            "is a single array of numpy, and its columns have no names; save them with np.savez(file, time_s=..., pressure_bar=..., displacement_mm=...)",
        ),
        [0x89, b'H', b'D', b'F', ..] => refuse("is an HDF5 file; of MATLAB's formats version 5 is read: save it with -v7, or export CSV"),
        _ if head.starts_with(b"MATLAB 7.3") => refuse("is a MAT file of version 7.3; save it with `save(file, ..., '-v7')`"),
        _ if head.starts_with(b"MATLAB 5.0") => Ok(Kind::Mat),
        [0xd0, 0xcf, 0x11, 0xe0, ..] => refuse("is a workbook of Excel; save the sheet as CSV (UTF-8)"),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => refuse("is text in UTF-16; save it as CSV in UTF-8"),
        // Without its mark: every second byte of Latin letters is zero.
        [0, letter, 0, next, ..] | [letter, 0, next, 0, ..] if letter.is_ascii_graphic() && next.is_ascii_graphic() => {
            refuse("is text in UTF-16; save it as CSV in UTF-8")
        }
        _ => Ok(Kind::Text),
    }
}

/// The arrays of a binary file; `is_wanted` tells the names of all wanted columns from others.
pub(super) fn arrays(path: &Path, kind: Kind, bytes: &[u8], is_wanted: &dyn Fn(&[String]) -> bool) -> Result<Arrays, RecordingError> {
    let arrays = match kind {
        Kind::Npz => npz::read(bytes),
        Kind::Mat => mat::read(bytes),
        Kind::Mcap => mcap_file::read(bytes, is_wanted),
        Kind::Text | Kind::Gzip => Err("is text".to_owned()),
    };
    arrays.map_err(|problem| RecordingError::Format { path: path.to_path_buf(), problem })
}

/// The bytes of a recording in a binary format, with a line on where it came from.
///
/// # Errors
/// What the format has no room for, in words.
pub(super) fn encode(kind: Kind, recording: &Recording, provenance: &str) -> Result<Vec<u8>, String> {
    let more = recording.more_inputs.iter().map(|channel| (channel.signal.column(), &channel.values[..]));
    let extra = recording.extra.iter().map(|column| (column.name.clone(), &column.values[..]));
    let columns: Vec<(String, &[f64])> =
        [("time_s".to_owned(), &recording.time_s[..]), (recording.input_signal.column(), &recording.input)]
            .into_iter()
            .chain(more)
            .chain([(recording.output_signal.column(), &recording.output[..])])
            .chain(extra)
            .collect();
    match kind {
        Kind::Npz => npz::write(&columns, provenance),
        Kind::Mat => mat::write(&columns, provenance),
        Kind::Mcap => mcap_file::write(&columns, provenance),
        Kind::Text | Kind::Gzip => Err("is text".to_owned()),
    }
}
