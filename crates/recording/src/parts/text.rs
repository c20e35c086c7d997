//! The rows of a text: the header, then one row at a time, or many at a time where they are plain.

use std::path::Path;

use super::plain::PlainRows;
use super::{Columns, MOST_COLUMNS, MOST_VALUES, Others, Part, increases, is_next, is_readable, refused};
use crate::table::{Cells, Separator, TakesRows};
use crate::{ColumnMap, RecordingError, number};

/// What was read of a text so far.
pub(super) struct TextRows<'a> {
    path: &'a Path,
    map: &'a ColumnMap,
    separator: Separator,
    pub(super) columns: Option<Columns>,
    /// Where every row goes to the one recording of the file.
    plain: Option<PlainRows>,
    pub(super) parts: Vec<Part>,
    /// Numbers that were kept.
    values: usize,
    pub(super) decimal_commas: usize,
}

impl<'a> TextRows<'a> {
    pub(super) fn new(path: &'a Path, map: &'a ColumnMap, separator: Separator) -> Self {
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
        let mut row = vec![0.0; columns.wanted.len()];
        let mut room = (MOST_VALUES - self.values) / row.len();
        let taken = plain.take(text, |numbers| {
            let mut readable = room > 0;
            for (value, wanted) in row.iter_mut().zip(&columns.wanted) {
                *value = wanted.scale.apply(numbers[wanted.index]);
                readable &= is_readable(*value);
            }
            if !readable || columns.sequence.is_some_and(|column| !is_next(part.values[column].last().copied(), row[column])) {
                return false;
            }
            part.values.iter_mut().zip(&row).for_each(|(values, value)| values.push(*value));
            room -= 1;
            true
        });
        part.lines.extend(line, taken.rows);
        self.values += taken.rows * row.len();
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
