//! A text as recordings: the header, then one row at a time, or many at a time where they are plain.

use std::path::Path;

use crate::lines::{LineError, Lines};
use crate::parts::{Columns, MOST_COLUMNS, MOST_VALUES, Others, Part, Read, increases, is_readable, layout_notes, names_columns, refused};
use crate::plain::PlainRows;
use crate::table::{self, Cells, RowError, Separator, TakesRows};
use crate::{ColumnMap, RecordingError, number};

/// Line ends of Unix or Windows are wanted.
const RETURNS: &str = "its lines end in a carriage return alone; save it with the line ends of Unix or Windows";

/// Reads the text of a file.
pub(crate) fn read<R: std::io::Read>(path: &Path, lines: &mut Lines<R>, map: &ColumnMap) -> Result<Read, RecordingError> {
    let broken = |reason| RecordingError::Open { path: path.into(), reason };
    let (mut head, whole) = lines.head().map_err(broken)?;
    let mark = head.starts_with(b"\xef\xbb\xbf");
    head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head);
    if whole && head.trim_ascii().is_empty() {
        return Err(RecordingError::Empty { path: path.into() });
    }
    if head.contains(&b'\r') && !head.contains(&b'\n') {
        return Err(RecordingError::Format { path: path.into(), problem: RETURNS.to_owned() });
    }
    let known = head.utf8_chunks().next().map_or("", |chunk| chunk.valid());
    let layout = table::layout(known, |cells| cells.len() <= MOST_COLUMNS && names_columns(cells, map));
    lines.skip(layout.start + if mark { 3 } else { 0 }, layout.lines_before);
    let mut rows = TextRows::new(path, map, layout.separator);
    table::rows(lines, layout.separator, &mut rows).map_err(|error| match error {
        RowError::Row(error) => error,
        RowError::NotText(line) => RecordingError::NotText { path: path.into(), line },
        RowError::Line(LineError::TooLong(line)) => RecordingError::LongLine { path: path.into(), line },
        RowError::Line(LineError::Io(source)) => broken(source),
    })?;
    let TextRows { columns: Some(columns), parts, decimal_commas, .. } = rows else {
        return Err(RecordingError::Empty { path: path.into() });
    };
    let mut notes = layout_notes(&layout, decimal_commas, map, parts.len());
    notes.extend(columns.conversions.iter().cloned());
    Ok(Read { columns, parts, notes })
}

/// What was read of a text so far.
struct TextRows<'a> {
    path: &'a Path,
    map: &'a ColumnMap,
    separator: Separator,
    columns: Option<Columns>,
    /// Where every row goes to the one recording of the file.
    plain: Option<PlainRows>,
    parts: Vec<Part>,
    /// Numbers that were kept.
    values: usize,
    decimal_commas: usize,
}

impl<'a> TextRows<'a> {
    fn new(path: &'a Path, map: &'a ColumnMap, separator: Separator) -> Self {
        Self { path, map, separator, columns: None, plain: None, parts: Vec::new(), values: 0, decimal_commas: 0 }
    }

    fn commas_are_points(&self) -> bool {
        self.separator != Separator::Comma
    }

    fn header(&mut self, line: u64, cells: &Cells<'_>) -> Result<(), RecordingError> {
        if cells.len() > MOST_COLUMNS {
            return Err(RecordingError::TooManyColumns { path: self.path.into(), line, columns: cells.len() });
        }
        let headers: Vec<String> = (0..cells.len()).map(|index| cells.text(index)).collect();
        let columns = Columns::find(self.path, line, headers, self.map, Others::Refused)?;
        if columns.recording.is_none() && columns.group.is_none() && self.separator != Separator::Spaces {
            let is_wanted = |index: usize| columns.wanted.iter().any(|wanted| wanted.index == index);
            self.plain = Some(PlainRows {
                separator: self.separator.byte(),
                decimal_comma: self.commas_are_points(),
                wanted: (0..columns.headers.len()).map(is_wanted).collect(),
            });
        }
        self.columns = Some(columns);
        Ok(())
    }
}

impl TakesRows for TextRows<'_> {
    type Error = RecordingError;

    fn plain(&mut self, line: u64, text: &[u8]) -> (usize, u64) {
        let (Some(plain), Some(columns), [part]) = (&self.plain, &self.columns, &mut self.parts[..]) else { return (0, 0) };
        let before = part.values.first().map_or(0, Vec::len);
        let most = (MOST_VALUES - self.values) / columns.wanted.len();
        let mut taken = plain.take(text, most, &columns.wanted, &mut part.values);
        if let Some(column) = columns.sequence
            && let Some(wrong) = (before..before + taken.rows).find(|&row| !increases(&part.values[column][..=row]))
        {
            // The row that goes back is named by its line.
            part.values.iter_mut().for_each(|values| values.truncate(before));
            taken = plain.take(text, wrong - before, &columns.wanted, &mut part.values);
        }
        part.lines.extend(line, taken.rows);
        self.values += taken.rows * columns.wanted.len();
        self.decimal_commas += taken.decimal_commas;
        (taken.bytes, taken.rows as u64)
    }

    fn row(&mut self, line: u64, cells: &Cells<'_>) -> Result<(), RecordingError> {
        let (path, commas_are_points) = (self.path, self.commas_are_points());
        let Some(columns) = &self.columns else { return self.header(line, cells) };
        self.values += columns.wanted.len();
        if self.values > MOST_VALUES {
            return Err(RecordingError::TooLong { path: path.into(), line });
        }
        if cells.len() != columns.headers.len() {
            return Err(RecordingError::Ragged { path: path.into(), line, cells: cells.len(), columns: columns.headers.len() });
        }
        if self.parts.is_empty() || columns.recording.is_some() || columns.group.is_some() {
            let words = |column: Option<usize>| column.map_or_else(String::new, |index| cells.text(index));
            columns.part(&mut self.parts, words(columns.recording), words(columns.group));
        }
        // Note(unwrap): one was made above if there was none.
        let part = self.parts.last_mut().expect("a part");
        for (wanted, values) in columns.wanted.iter().zip(&mut part.values) {
            let cell = cells.get(wanted.index);
            let Some(value) = number::parse(cell, commas_are_points) else {
                let (column, text) = (columns.headers[wanted.index].clone(), cells.text(wanted.index));
                return Err(RecordingError::NotANumber { path: path.into(), line, column, text });
            };
            self.decimal_commas += usize::from(commas_are_points && number::is_decimal_comma(cell));
            let value = wanted.scale.apply(value);
            if !is_readable(value) {
                return Err(refused(path, line, &columns.headers[wanted.index], value, cells.text(wanted.index)));
            }
            values.push(value);
        }
        part.lines.push(line);
        if let Some(column) = columns.sequence
            && !increases(&part.values[column])
        {
            return Err(RecordingError::Sequence { path: path.into(), line, text: cells.text(columns.wanted[column].index) });
        }
        Ok(())
    }
}
