//! The rows of a file as recordings: where each column stands, where one recording ends and the next begins.

use std::path::Path;

use super::columns::OPTIONAL;
use super::table::{self, Layout, Separator};
use super::{Channel, ColumnMap, ExtraColumn, Note, Recording, RecordingError, Signal, Subject, condition, header, repair};

/// What a file holds.
pub(super) struct Read {
    pub(super) columns: Columns,
    pub(super) parts: Vec<Part>,
    /// What concerns the whole file.
    pub(super) notes: Vec<Note>,
}

/// A column of numbers that is read.
struct Wanted {
    index: usize,
    /// What its values are multiplied by.
    factor: f64,
}

/// Where the wanted columns stand.
pub(super) struct Columns {
    headers: Vec<String>,
    /// Time (where there is one), inputs, output, carried columns.
    wanted: Vec<Wanted>,
    more_inputs: Vec<Signal>,
    /// Names of the carried columns.
    extra: Vec<String>,
    /// Position of the sequence numbers in `wanted`.
    sequence: Option<usize>,
    /// Columns whose text sets recordings and groups apart.
    recording: Option<usize>,
    group: Option<usize>,
}

/// The rows of one recording.
#[derive(Default)]
pub(super) struct Part {
    /// What the columns that set recordings apart say.
    pub(super) name: String,
    group: String,
    lines: Vec<u64>,
    /// As [`Columns::wanted`].
    values: Vec<Vec<f64>>,
}

/// Reads the text of a file.
pub(super) fn read(path: &Path, text: &str, map: &ColumnMap) -> Result<Read, RecordingError> {
    let layout = table::layout(text, |cells| names_columns(cells, map));
    let mut columns: Option<Columns> = None;
    let mut parts: Vec<Part> = Vec::new();
    let mut decimal_commas = 0;
    table::rows(text, &layout, |line, cells| {
        let Some(columns) = &columns else {
            columns = Some(Columns::find(path, line, cells, map)?);
            return Ok(());
        };
        if cells.len() != columns.headers.len() {
            return Err(RecordingError::Ragged { path: path.into(), line, cells: cells.len(), columns: columns.headers.len() });
        }
        let words = |column: Option<usize>| column.map_or("", |index| cells[index]);
        let (recording, group) = (words(columns.recording), words(columns.group));
        let name = if columns.recording.is_some() { recording } else { group };
        if parts.last().is_none_or(|part| part.name != name || part.group != group) {
            let values = columns.wanted.iter().map(|_| Vec::new()).collect();
            parts.push(Part { name: name.to_owned(), group: group.to_owned(), values, ..Part::default() });
        }
        // Note(unwrap): one was pushed above if there was none.
        let part = parts.last_mut().expect("a part");
        for (wanted, values) in columns.wanted.iter().zip(&mut part.values) {
            let text = cells[wanted.index];
            let comma = layout.separator != Separator::Comma && text.matches(',').count() == 1 && !text.contains('.');
            decimal_commas += usize::from(comma);
            let pointed = if comma { text.replace(',', ".") } else { String::new() };
            values.push(wanted.factor * number(path, line, &columns.headers[wanted.index], if comma { &pointed } else { text })?);
        }
        part.lines.push(line);
        let increases = columns.sequence.is_none_or(|column| increases(&part.values[column]));
        let text = || columns.sequence.map_or("", |column| cells[columns.wanted[column].index]).to_owned();
        if !increases {
            return Err(RecordingError::Sequence { path: path.into(), line, text: text() });
        }
        Ok(())
    })?;
    let Some(columns) = columns else { return Err(RecordingError::Empty { path: path.into() }) };
    let notes = layout_notes(&layout, decimal_commas, map, parts.len());
    Ok(Read { columns, parts, notes })
}

/// Whether a row of cells is the header that the map asks for.
fn names_columns(cells: &[&str], map: &ColumnMap) -> bool {
    let headers: Vec<String> = cells.iter().map(|&cell| cell.to_owned()).collect();
    map.main_columns().all(|name| header::position(&headers, &name.header).is_some())
}

/// What there is to say about the layout.
fn layout_notes(layout: &Layout, decimal_commas: usize, map: &ColumnMap, parts: usize) -> Vec<Note> {
    let mut notes = Vec::new();
    if layout.separator != Separator::Comma {
        notes.push(Note::new(Subject::Layout, format!("The columns are separated by {}.", layout.separator.name())));
    }
    if layout.titles > 0 {
        notes.push(Note::new(Subject::Layout, format!("{} title line(s) above the header were passed over.", layout.titles)));
    }
    if decimal_commas > 0 {
        notes.push(Note { count: decimal_commas, ..Note::new(Subject::Layout, "Numbers have decimal commas; they were read as points.") });
    }
    if let Some(rate_hz) = map.rate_hz {
        let unused = map.unused_time.as_ref().map_or_else(String::new, |name| format!(" A column `{name}` is not read."));
        notes.push(Note::new(Subject::Rate, format!("The clock is made from --rate-hz {rate_hz}.{unused}")));
    }
    if parts > 1 {
        let by = map.recording.as_ref().or(map.group.as_ref()).map_or("", String::as_str);
        notes.push(Note {
            count: parts,
            ..Note::new(Subject::Layout, format!("The column `{by}` sets {parts} recordings apart in this file."))
        });
    }
    notes
}

/// Whether the newest sequence number is whole and above the one before.
fn increases(numbers: &[f64]) -> bool {
    let newest = numbers[numbers.len() - 1];
    let previous = numbers.len().checked_sub(2).map(|index| numbers[index]);
    newest.fract() == 0.0 && newest >= 0.0 && previous.is_none_or(|previous| newest > previous)
}

impl Columns {
    fn find(path: &Path, line: u64, cells: &[&str], map: &ColumnMap) -> Result<Self, RecordingError> {
        let headers: Vec<String> = cells.iter().map(|&cell| cell.to_owned()).collect();
        if headers.iter().all(|name| name.parse::<f64>().is_ok()) {
            return Err(RecordingError::NoHeader { path: path.into(), line });
        }
        let main = |name: &str| map.main_columns().any(|column| column.header == name);
        for (index, name) in headers.iter().enumerate() {
            let wanted = main(name) || (map.own && OPTIONAL.contains(&name.as_str()));
            if wanted && headers[..index].contains(name) {
                return Err(RecordingError::DuplicateColumn { path: path.into(), line, column: name.clone() });
            }
        }
        let find = |column: &str| {
            header::position(&headers, column).ok_or_else(|| RecordingError::MissingColumn {
                path: path.into(),
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
        let mut wanted = Vec::new();
        if let Some(time) = &map.time {
            wanted.push(Wanted { index: find(&time.header)?, factor: map.time_unit_s });
        }
        wanted.push(Wanted { index: find(&map.input.header)?, factor: 1.0 });
        let mut more_inputs = Vec::new();
        for name in &map.more_inputs {
            wanted.push(Wanted { index: find(&name.header)?, factor: 1.0 });
            more_inputs.push(name.signal.clone());
        }
        let (mut output, mut extra, mut carried) = (Some(Wanted { index: find(&map.output.header)?, factor: 1.0 }), Vec::new(), Vec::new());
        for (name, column, factor) in &map.carried {
            carried.push(Wanted { index: find(&column.header)?, factor: *factor });
            extra.push(name.clone());
        }
        let unused = |name: &str| map.unused_time.as_deref() == Some(name);
        for (index, name) in headers.iter().enumerate().filter(|(_, name)| map.own && !main(name) && !unused(name)) {
            if let Some(signal) = own_further_input(name, more_inputs.len()) {
                wanted.push(Wanted { index, factor: 1.0 });
                more_inputs.push(signal);
            } else if OPTIONAL.contains(&name.as_str()) {
                carried.push(Wanted { index, factor: 1.0 });
                extra.push(name.clone());
            } else {
                return Err(RecordingError::UnknownColumn { path: path.into(), line, column: name.clone() });
            }
        }
        wanted.extend(output.take());
        let sequence = extra.iter().position(|name| name == "sequence").map(|place| wanted.len() + place);
        wanted.extend(carried);
        let text = |column: &Option<String>| column.as_deref().map(&find).transpose();
        let (recording, group) = (text(&map.recording)?, text(&map.group)?);
        Ok(Self { wanted, more_inputs, extra, sequence, recording, group, headers })
    }
}

/// The signal of `pressure2_bar` to `pressure9_bar` in our own files, when it is the next one.
fn own_further_input(name: &str, so_far: usize) -> Option<Signal> {
    let quantity = format!("pressure{}", so_far + 2);
    (name == format!("{quantity}_bar") && so_far < 8).then(|| Signal { quantity, unit: "bar".into() })
}

impl Part {
    /// Repairs the clock and makes a recording called `name` of the rows.
    pub(super) fn into_recording(self, path: &Path, name: &Path, map: &ColumnMap, columns: &Columns) -> Result<Recording, RecordingError> {
        let Self { group, lines, mut values, .. } = self;
        let rows = lines.len();
        if rows < 2 {
            return Err(RecordingError::TooShort { path: name.into(), rows });
        }
        let mut notes = Vec::new();
        let (time_s, order) = if let Some(rate_hz) = map.rate_hz {
            ((0..rows).map(|row| row as f64 / rate_hz).collect(), (0..rows).collect())
        } else {
            let stamps_s = values.remove(0);
            let same = |one: usize, other: usize| values.iter().all(|values| values[one] == values[other]);
            let repaired = repair::repair(&stamps_s, same).map_err(|row| RecordingError::TimeNotIncreasing {
                path: path.into(),
                line: lines[row],
                previous_s: stamps_s[row.saturating_sub(1)],
                time_s: stamps_s[row],
            })?;
            notes.extend(repaired.notes(&lines));
            (repaired.time_s, repaired.order)
        };
        let mut values = values.into_iter().map(|values| order.iter().map(|&row| values[row]).collect::<Vec<f64>>());
        let mut next = || values.next().unwrap_or_default();
        let input = next();
        let more_inputs: Vec<Channel> =
            columns.more_inputs.iter().map(|signal| Channel { signal: signal.clone(), values: next() }).collect();
        let output = next();
        let extra = columns.extra.iter().map(|name| ExtraColumn { name: name.clone(), values: next() }).collect();
        let mut recording =
            Recording::new(path, map.input.signal.clone(), map.output.signal.clone(), time_s, input, output)?.with_more_inputs(more_inputs);
        recording.path = name.to_path_buf();
        recording.group = group;
        recording.extra = extra;
        recording.mark_lost_samples();
        recording.notes = notes;
        let lines: Vec<u64> = order.iter().map(|&row| lines[row]).collect();
        let found = condition::notes(&recording, &lines);
        recording.notes.extend(found);
        Ok(recording)
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
