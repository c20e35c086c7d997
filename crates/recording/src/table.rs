//! The text of a file as rows of cells: which character separates them, which line names the columns.

use std::io::Read;

use csv::{ByteRecord, ReaderBuilder};
use memchr::memchr;

use super::lines::{LONGEST_LINE, LineError, Lines};

/// What stands between the cells of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    Comma,
    Semicolon,
    Tab,
    Spaces,
}

impl Separator {
    const ALL: [Self; 4] = [Self::Comma, Self::Semicolon, Self::Tab, Self::Spaces];

    /// As said in a note.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Comma => "commas",
            Self::Semicolon => "semicolons",
            Self::Tab => "tabs",
            Self::Spaces => "spaces",
        }
    }

    pub(super) fn byte(self) -> u8 {
        match self {
            Self::Comma => b',',
            Self::Semicolon => b';',
            Self::Tab => b'\t',
            Self::Spaces => b' ',
        }
    }

    /// The cells of one line, without regard to quotes.
    fn split(self, line: &str) -> Vec<&str> {
        match self {
            Self::Spaces => line.split_whitespace().collect(),
            _ => line.split(char::from(self.byte())).map(|cell| cell.trim().trim_matches('"')).collect(),
        }
    }
}

/// How a text is laid out.
pub(super) struct Layout {
    pub(super) separator: Separator,
    /// Lines of titles above the header that are no comments.
    pub(super) titles: usize,
    /// Where the header begins, in bytes.
    pub(super) start: usize,
    /// Lines before the header.
    pub(super) lines_before: u64,
}

/// Lines that are looked through for the header.
const MOST_TITLES: usize = 100;

/// Finds the header in the beginning of a text: the first line that names all wanted columns; else, for the sake of a clear message, the
/// first line that is no comment.
pub(super) fn layout(text: &str, names_columns: impl Fn(&[&str]) -> bool) -> Layout {
    let mut offset = 0;
    let mut titles = 0;
    let mut first: Option<Layout> = None;
    for (index, line) in text.split_inclusive('\n').enumerate() {
        let start = offset;
        offset += line.len();
        let bare = line.trim();
        if bare.is_empty() || bare.starts_with('#') {
            continue;
        }
        let at = |separator, titles| Layout { separator, titles, start, lines_before: index as u64 };
        if let Some(separator) = Separator::ALL.into_iter().find(|separator| names_columns(&separator.split(bare))) {
            return at(separator, titles);
        }
        first.get_or_insert_with(|| {
            let several = Separator::ALL.into_iter().find(|separator| separator.split(bare).len() > 1);
            at(several.unwrap_or(Separator::Comma), 0)
        });
        titles += 1;
        if titles > MOST_TITLES {
            break;
        }
    }
    first.unwrap_or(Layout { separator: Separator::Comma, titles: 0, start: 0, lines_before: 0 })
}

/// The cells of one row, blanks around them taken off.
pub(super) struct Cells<'a> {
    bytes: &'a [u8],
    places: &'a [(usize, usize)],
}

impl<'a> Cells<'a> {
    pub(super) fn len(&self) -> usize {
        self.places.len()
    }

    pub(super) fn get(&self, index: usize) -> &'a [u8] {
        let (start, end) = self.places[index];
        trimmed(&self.bytes[start..end])
    }

    /// The cell as text; what is no UTF-8 is shown as such.
    pub(super) fn text(&self, index: usize) -> String {
        String::from_utf8_lossy(self.get(index)).into_owned()
    }
}

/// Without blanks at both ends; most cells have none.
fn trimmed(cell: &[u8]) -> &[u8] {
    match (cell.first(), cell.last()) {
        (Some(first), Some(last)) if *first > b' ' && *last > b' ' && last.is_ascii() => cell,
        (Some(_), Some(_)) => std::str::from_utf8(cell).map_or(cell.trim_ascii(), |text| text.trim().as_bytes()),
        _ => cell,
    }
}

/// Why the rows end early.
pub(super) enum RowError<E> {
    /// The text cannot be read on.
    Line(LineError),
    /// Bytes that are no UTF-8, on this line.
    NotText(u64),
    /// What was done with a row failed.
    Row(E),
}

/// Takes the rows of a text.
pub(super) trait TakesRows {
    /// Why a row cannot be taken.
    type Error;

    /// Takes as many rows as it can from the beginning of a text, which begins with this line: how many bytes these are, and how many lines.
    fn plain(&mut self, line: u64, text: &[u8]) -> (usize, u64);

    /// Takes the row on this line.
    fn row(&mut self, line: u64, cells: &Cells<'_>) -> Result<(), Self::Error>;
}

/// Has every row from here on taken; rows of blanks and comments are passed over.
pub(super) fn rows<R: Read, T: TakesRows>(lines: &mut Lines<R>, separator: Separator, taker: &mut T) -> Result<(), RowError<T::Error>> {
    let mut places: Vec<(usize, usize)> = Vec::new();
    loop {
        let (first, text) = lines.buffered();
        let (bytes, count) = taker.plain(first, text);
        lines.skip(bytes, count);
        let Some((number, line)) = lines.next().map_err(RowError::Line)? else { return Ok(()) };
        if !line.is_ascii() && std::str::from_utf8(line).is_err() {
            return Err(RowError::NotText(number));
        }
        if separator != Separator::Spaces && begins_a_quote(line, separator.byte()) {
            let record = line.to_vec();
            let record = whole_record(lines, record)?;
            quoted(&record, separator, &mut places, |cells| taker.row(number, cells)).map_err(RowError::Row)?;
            continue;
        }
        let Some(&first) = line.iter().find(|byte| !byte.is_ascii_whitespace()) else { continue };
        if first == b'#' {
            continue;
        }
        places.clear();
        if separator == Separator::Spaces {
            let text = std::str::from_utf8(line).unwrap_or_default();
            let offset = |part: &str| part.as_ptr() as usize - text.as_ptr() as usize;
            places.extend(text.split_whitespace().map(|part| (offset(part), offset(part) + part.len())));
        } else {
            let byte = separator.byte();
            let mut start = 0;
            for (index, &found) in line.iter().enumerate() {
                if found == byte {
                    places.push((start, index));
                    start = index + 1;
                }
            }
            places.push((start, line.len()));
        }
        taker.row(number, &Cells { bytes: line, places: &places }).map_err(RowError::Row)?;
    }
}

/// Whether a cell of a line begins with a quotation mark.
fn begins_a_quote(line: &[u8], separator: u8) -> bool {
    let mut from = 0;
    while let Some(found) = memchr(b'"', &line[from..]) {
        let before = line[..from + found].trim_ascii_end();
        if before.is_empty() || before.last() == Some(&separator) || line[..from + found].last() == Some(&separator) {
            return true;
        }
        from += found + 1;
    }
    false
}

/// A record whose quotes may hold line ends.
fn whole_record<R: Read, E>(lines: &mut Lines<R>, mut record: Vec<u8>) -> Result<Vec<u8>, RowError<E>> {
    let quotes = |bytes: &[u8]| bytes.iter().filter(|&&byte| byte == b'"').count();
    let mut open = quotes(&record) % 2 == 1;
    while open {
        let Some((number, line)) = lines.next().map_err(RowError::Line)? else { break };
        if std::str::from_utf8(line).is_err() {
            return Err(RowError::NotText(number));
        }
        record.push(b'\n');
        record.extend_from_slice(line);
        open ^= quotes(line) % 2 == 1;
        if record.len() > LONGEST_LINE {
            return Err(RowError::Line(LineError::TooLong(number)));
        }
    }
    Ok(record)
}

/// The cells of a record with quotes, by the rules of CSV.
fn quoted<E>(
    record: &[u8],
    separator: Separator,
    places: &mut Vec<(usize, usize)>,
    take: impl FnOnce(&Cells<'_>) -> Result<(), E>,
) -> Result<(), E> {
    // A blank before a quotation mark is no part of the cell.
    let mut tight = Vec::with_capacity(record.len());
    let mut inside = false;
    for (index, &byte) in record.iter().enumerate() {
        inside ^= byte == b'"';
        let next = record[index..].iter().find(|byte| !matches!(byte, b' ' | b'\t'));
        let between = tight.last().is_none_or(|last| *last == separator.byte()) && next == Some(&b'"');
        if inside || byte == b'"' || !(matches!(byte, b' ' | b'\t') && byte != separator.byte() && between) {
            tight.push(byte);
        }
    }
    let mut reader = ReaderBuilder::new().has_headers(false).flexible(true).delimiter(separator.byte()).from_reader(tight.as_slice());
    let mut cells = ByteRecord::new();
    // Note(unwrap): the bytes are in memory and rows may be of any length.
    if reader.read_byte_record(&mut cells).expect("nothing is left that a reader could refuse") {
        places.clear();
        places.extend((0..cells.len()).map(|index| cells.range(index).map_or((0, 0), |range| (range.start, range.end))));
        return take(&Cells { bytes: cells.as_slice(), places });
    }
    Ok(())
}
