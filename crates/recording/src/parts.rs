//! The rows of a file as recordings: where each column stands, where one recording ends and the next begins.

use std::path::Path;

use super::arrays::Arrays;
use super::columns::OPTIONAL;
use super::extremes::{self, Extremes};
use super::row_lines::RowLines;
use super::scale::Scale;
use super::table::{Layout, Separator};
use super::{Channel, ColumnMap, ExtraColumn, Note, Recording, RecordingError, Signal, Subject, condition, header, repair};

/// More columns than this are a table of another kind.
pub(super) const MOST_COLUMNS: usize = 4096;
/// A longer name of a column is text of another kind.
const LONGEST_NAME: usize = 300;
/// Numbers that are kept of one file, at most: 384 MB.
pub(super) const MOST_VALUES: usize = 48 << 20;
/// No sensor reads more, in any unit: squares and products of such numbers stay finite.
pub const LARGEST: f64 = 1e30;
/// A signal that never exceeds this is none: squares of such numbers vanish in a float.
const SMALLEST: f64 = 1e-30;

/// What a file holds.
pub(super) struct Read {
    pub(super) columns: Columns,
    pub(super) parts: Vec<Part>,
    /// What concerns the whole file.
    pub(super) notes: Vec<Note>,
}

/// A column of numbers that is read.
pub(super) struct Wanted {
    pub(super) index: usize,
    /// Into the unit that is worked in.
    pub(super) scale: Scale,
}

/// Where the wanted columns stand.
pub(super) struct Columns {
    pub(super) headers: Vec<String>,
    /// Time (where there is one), inputs, output, carried columns.
    pub(super) wanted: Vec<Wanted>,
    more_inputs: Vec<Signal>,
    /// Names of the carried columns.
    extra: Vec<String>,
    /// Position of the sequence numbers in `wanted`.
    pub(super) sequence: Option<usize>,
    /// Columns whose text sets recordings and groups apart.
    pub(super) recording: Option<usize>,
    pub(super) group: Option<usize>,
    /// What is converted.
    pub(super) conversions: Vec<Note>,
}

/// The rows of one recording.
#[derive(Default)]
pub(super) struct Part {
    /// What the columns that set recordings apart say.
    pub(super) name: String,
    pub(super) group: String,
    pub(super) lines: RowLines,
    /// As [`Columns::wanted`].
    pub(super) values: Vec<Vec<f64>>,
}

/// Whether a sensor can give this value.
pub(super) fn is_readable(value: f64) -> bool {
    // What is not a number is not.
    value.abs() <= LARGEST
}

/// The error about a value that is not finite, or larger than any sensor reads.
pub(super) fn refused(path: &Path, line: u64, column: &str, value: f64, text: String) -> RecordingError {
    let (path, column) = (path.to_path_buf(), column.to_owned());
    match value.is_finite() {
        true => RecordingError::TooLarge { path, line, column, text },
        false => RecordingError::NotFinite { path, line, column, text },
    }
}

/// Reads the arrays of a binary file; samples take the place of lines, counted from 1.
pub(super) fn read_arrays(path: &Path, arrays: Arrays, map: &ColumnMap) -> Result<Read, RecordingError> {
    let Arrays { names, mut columns, mut notes } = arrays;
    let found = Columns::find(path, 0, names, map, Others::PassedOver)?;
    let rows = found.wanted.first().map_or(0, |wanted| columns[wanted.index].len());
    let needed = found.wanted.iter().map(|wanted| wanted.index).chain(found.recording).chain(found.group);
    if let Some(other) = needed.clone().find(|&index| columns[index].len() != rows) {
        let name = |index: usize| found.headers[index].clone();
        return Err(RecordingError::UnequalArrays {
            path: path.into(),
            column: name(found.wanted[0].index),
            rows,
            other: name(other),
            other_rows: columns[other].len(),
        });
    }
    let words = |column: Option<usize>, sample: usize| column.map_or_else(String::new, |index| columns[index][sample].to_string());
    let mut parts: Vec<Part> = Vec::new();
    let mut bounds: Vec<usize> = Vec::new();
    for sample in 0..rows {
        if sample == 0 || found.recording.is_some() || found.group.is_some() {
            let before = parts.len();
            found.part(&mut parts, words(found.recording, sample), words(found.group, sample));
            if parts.len() > before {
                bounds.push(sample);
            }
        }
    }
    bounds.push(rows);
    // A column that plays two roles is copied, all others are moved.
    for (place, wanted) in found.wanted.iter().enumerate() {
        let again = found.wanted[place + 1..].iter().any(|other| other.index == wanted.index);
        let column = if again { columns[wanted.index].clone() } else { std::mem::take(&mut columns[wanted.index]) };
        let mut values: Vec<f64> = column;
        for (sample, value) in values.iter_mut().enumerate() {
            let raw = *value;
            *value = wanted.scale.apply(raw);
            if !is_readable(*value) {
                return Err(refused(path, sample as u64 + 1, &found.headers[wanted.index], *value, raw.to_string()));
            }
        }
        if let [part] = &mut parts[..] {
            part.values[place] = values;
            continue;
        }
        for (part, bound) in parts.iter_mut().zip(bounds.windows(2)) {
            part.values[place] = values[bound[0]..bound[1]].to_vec();
        }
    }
    for (part, bound) in parts.iter_mut().zip(bounds.windows(2)) {
        (bound[0]..bound[1]).for_each(|sample| part.lines.push(sample as u64 + 1));
        if let Some(column) = found.sequence
            && let Some(wrong) = (0..part.values[column].len()).find(|&sample| !increases(&part.values[column][..=sample]))
        {
            let text = part.values[column][wrong].to_string();
            return Err(RecordingError::Sequence { path: path.into(), line: part.lines.line(wrong), text });
        }
    }
    notes.extend(found.conversions.iter().cloned());
    Ok(Read { columns: found, parts, notes })
}

/// Whether a row of cells is the header that the map asks for.
pub(super) fn names_columns(cells: &[&str], map: &ColumnMap) -> bool {
    let headers: Vec<String> = cells.iter().map(|&cell| cell.to_owned()).collect();
    map.with_own_units(&headers).main_columns().all(|name| header::position(&headers, &name.header).is_some())
}

/// What there is to say about the layout.
pub(super) fn layout_notes(layout: &Layout, decimal_commas: usize, map: &ColumnMap, parts: usize) -> Vec<Note> {
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
pub(super) fn increases(numbers: &[f64]) -> bool {
    numbers.split_last().is_none_or(|(&newest, before)| is_next(before.last().copied(), newest))
}

/// Whether a sequence number is whole and above the one before.
fn is_next(previous: Option<f64>, newest: f64) -> bool {
    newest.fract() == 0.0 && newest >= 0.0 && previous.is_none_or(|previous| newest > previous)
}

impl Columns {
    pub(super) fn find(path: &Path, line: u64, headers: Vec<String>, map: &ColumnMap, others: Others) -> Result<Self, RecordingError> {
        let map = &map.with_own_units(&headers);
        if !headers.is_empty() && headers.iter().all(|name| name.parse::<f64>().is_ok()) {
            return Err(RecordingError::NoHeader { path: path.into(), line });
        }
        if let Some(long) = headers.iter().find(|name| name.len() > LONGEST_NAME) {
            let begin: String = long.chars().take(40).collect();
            let problem = format!("a column is called `{begin}…`, {} bytes long; is this the header?", long.len());
            return Err(RecordingError::Format { path: path.into(), problem });
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
                found: listed(&headers),
                hint: if map.own {
                    "say which columns to read, for example `--columns time=t_s,input=voltage_V,output=displacement_um`, with the unit behind a \
                     colon where a name has none (`input=force:N`)"
                        .to_owned()
                } else {
                    "correct the name in --columns".to_owned()
                },
            })
        };
        let mut wanted = Vec::new();
        if let Some(time) = &map.time {
            wanted.push(Wanted { index: find(&time.header)?, scale: time.scale });
        }
        wanted.push(Wanted { index: find(&map.input.header)?, scale: map.input.scale });
        let mut more_inputs = Vec::new();
        for name in &map.more_inputs {
            wanted.push(Wanted { index: find(&name.header)?, scale: name.scale });
            more_inputs.push(name.signal.clone());
        }
        let output = Wanted { index: find(&map.output.header)?, scale: map.output.scale };
        let (mut extra, mut carried) = (Vec::new(), Vec::new());
        for (name, column) in &map.carried {
            carried.push(Wanted { index: find(&column.header)?, scale: column.scale });
            extra.push(name.clone());
        }
        let unused = |name: &str| map.unused_time.as_deref() == Some(name);
        for (index, name) in headers.iter().enumerate().filter(|(_, name)| map.own && !main(name) && !unused(name)) {
            if let Some(signal) = own_further_input(name, more_inputs.len()) {
                wanted.push(Wanted { index, scale: Scale::NONE });
                more_inputs.push(signal);
            } else if OPTIONAL.contains(&name.as_str()) {
                carried.push(Wanted { index, scale: Scale::NONE });
                extra.push(name.clone());
            } else if others == Others::Refused {
                return Err(RecordingError::UnknownColumn { path: path.into(), line, column: name.clone() });
            }
        }
        wanted.push(output);
        let sequence = extra.iter().position(|name| name == "sequence").map(|place| wanted.len() + place);
        wanted.extend(carried);
        let text = |column: &Option<String>| column.as_deref().map(&find).transpose();
        let (recording, group) = (text(&map.recording)?, text(&map.group)?);
        let conversions = map.conversions();
        Ok(Self { wanted, more_inputs, extra, sequence, recording, group, headers, conversions })
    }

    /// Begins a new part where what the columns say differs from the newest one.
    pub(super) fn part(&self, parts: &mut Vec<Part>, recording: String, group: String) {
        let name = if self.recording.is_some() { &recording } else { &group };
        if parts.last().is_none_or(|part| part.name != *name || part.group != group) {
            let values = self.wanted.iter().map(|_| Vec::new()).collect();
            parts.push(Part { name: name.clone(), group, values, ..Part::default() });
        }
    }
}

/// What becomes of columns that nobody asked for in a file of our own format.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Others {
    Refused,
    PassedOver,
}

/// Names for a message, the first of them when there are many.
fn listed(names: &[String]) -> String {
    const MOST: usize = 40;
    const LONGEST: usize = 800;
    let mut text = names.iter().take(MOST).map(String::as_str).collect::<Vec<_>>().join(",");
    if names.len() > MOST || text.len() > LONGEST {
        text = text.chars().take(LONGEST).collect();
        text.push_str(&format!(",... {} in all", names.len()));
    }
    text
}

/// The signal of `pressure2_bar` to `pressure9_bar` in our own files, when it is the next one.
fn own_further_input(name: &str, so_far: usize) -> Option<Signal> {
    let quantity = format!("pressure{}", so_far + 2);
    (name == format!("{quantity}_bar") && so_far < 8).then(|| Signal { quantity, unit: "bar".into() })
}

impl Recording {
    /// Refuses a signal that moves by less than any sensor tells; one that is zero throughout is told as constant.
    fn refuse_nothing(&self, channels: &[Extremes]) -> Result<(), RecordingError> {
        for ((_, signal, _), extremes) in condition::channels(self).into_iter().zip(channels) {
            let most = extremes.most();
            if most > 0.0 && most < SMALLEST {
                return Err(RecordingError::TooSmall { path: self.path.clone(), column: signal.column(), most });
            }
        }
        Ok(())
    }
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
        // No order means that of the file.
        let made: Option<Vec<f64>> = map.rate_hz.map(|rate_hz| (0..rows).map(|row| row as f64 / rate_hz).collect());
        let steps = extremes::step_bounds(made.as_ref().unwrap_or(&values[0]));
        let (time_s, order): (Vec<f64>, Option<Vec<usize>>) = if let Some(made) = made {
            (made, None)
        } else if steps.0 > 0.0 {
            (values.remove(0), None)
        } else {
            let stamps_s = values.remove(0);
            let same = |one: usize, other: usize| values.iter().all(|values| values[one] == values[other]);
            let repaired = repair::repair(&stamps_s, same).map_err(|row| RecordingError::TimeNotIncreasing {
                path: path.into(),
                line: lines.line(row),
                previous_s: stamps_s[row.saturating_sub(1)],
                time_s: stamps_s[row],
            })?;
            notes.extend(repaired.notes(&lines));
            (repaired.time_s, Some(repaired.order))
        };
        let mut values = values.into_iter().map(|values| match &order {
            Some(order) => order.iter().map(|&row| values[row]).collect::<Vec<f64>>(),
            None => values,
        });
        let mut next = || values.next().unwrap_or_default();
        let input = next();
        let more_inputs: Vec<Channel> =
            columns.more_inputs.iter().map(|signal| Channel { signal: signal.clone(), values: next() }).collect();
        let output = next();
        let extra = columns.extra.iter().map(|name| ExtraColumn { name: name.clone(), values: next() }).collect();
        let signals = (map.input.signal.clone(), map.output.signal.clone());
        let steps = if order.is_some() { extremes::step_bounds(&time_s) } else { steps };
        let rows = time_s.len();
        let more = more_inputs.iter().map(|channel| channel.values.len());
        let (inputs, outputs) = (more.fold(input.len(), usize::min), output.len());
        if inputs != rows || outputs != rows {
            return Err(RecordingError::Lengths { path: path.into(), time: rows, input: inputs, output: outputs });
        }
        // Every value is readable; a clock at a rate without end does not increase.
        let mut recording = if steps.0 > 0.0 && steps.1.is_finite() {
            Recording::of_checked(path, signals, (time_s, input, output), steps)?
        } else {
            Recording::new(path, signals.0, signals.1, time_s, input, output)?
        };
        recording = recording.with_more_inputs(more_inputs);
        recording.path = name.to_path_buf();
        let channels: Vec<Extremes> = condition::channels(&recording).into_iter().map(|(_, _, values)| Extremes::of(values)).collect();
        recording.refuse_nothing(&channels)?;
        recording.group = group;
        recording.extra = extra;
        recording.mark_lost_samples();
        recording.notes = notes;
        let lines = match &order {
            Some(order) => order.iter().map(|&row| lines.line(row)).collect(),
            None => lines,
        };
        let found = condition::notes(&recording, steps, &channels, &lines);
        recording.notes.extend(found);
        Ok(recording)
    }
}
