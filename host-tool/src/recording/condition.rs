//! What a recording's samples show by themselves.

use super::{Note, Recording, Subject};

/// Everything worth saying; `lines` are those of the samples in the file.
pub(super) fn notes(recording: &Recording, lines: &[u64]) -> Vec<Note> {
    let mut notes = Vec::new();
    if let Some(&first) = recording.gaps.first() {
        let count = recording.gaps.len();
        notes.push(Note::counted(Subject::Gap, count, lines[first], format!("{count} gap(s): samples are missing there.")));
    }
    notes
}
