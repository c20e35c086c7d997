//! The text of a file as rows of cells: which character separates them, which line names the columns.

use csv::{ReaderBuilder, StringRecord, Trim};

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

    fn byte(self) -> u8 {
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
    start: usize,
    /// The header's line, counted from 1.
    first_line: u64,
}

/// Lines that are looked through for the header.
const MOST_TITLES: usize = 100;

/// Finds the header: the first line that names all wanted columns; else, for the sake of a clear message, the first line that is no comment.
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
        let at = |separator, titles| Layout { separator, titles, start, first_line: index as u64 + 1 };
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
    first.unwrap_or(Layout { separator: Separator::Comma, titles: 0, start: 0, first_line: 1 })
}

/// Hands every row from the header on to `take`, with its line; rows of blanks and comments are passed over.
pub(super) fn rows<E>(text: &str, layout: &Layout, mut take: impl FnMut(u64, &[&str]) -> Result<(), E>) -> Result<(), E> {
    let body = &text[layout.start..];
    if layout.separator == Separator::Spaces {
        for (index, line) in body.split('\n').enumerate() {
            let bare = line.trim();
            if !bare.is_empty() && !bare.starts_with('#') {
                take(layout.first_line + index as u64, &layout.separator.split(bare))?;
            }
        }
        return Ok(());
    }
    let mut builder = ReaderBuilder::new();
    builder.has_headers(false).flexible(true).trim(Trim::All).comment(Some(b'#')).delimiter(layout.separator.byte());
    let mut reader = builder.from_reader(body.as_bytes());
    let mut row = StringRecord::new();
    let mut lines = LineCounter { text: body.as_bytes(), counted: 0, line: layout.first_line };
    loop {
        // Note(unwrap): the text is in memory and UTF-8, and rows may be of any length.
        let more = reader.read_record(&mut row).expect("nothing is left that a reader could refuse");
        if !more {
            return Ok(());
        }
        let line = lines.line_at(reader.position().byte());
        // A line of blanks says nothing, wherever it stands.
        if row.len() == 1 && row[0].is_empty() {
            continue;
        }
        let cells: Vec<&str> = row.iter().collect();
        take(line, &cells)?;
    }
}

/// The line on which this byte of a text stands.
pub(super) fn line_of(text: &[u8], byte: usize) -> u64 {
    LineCounter { text, counted: 0, line: 1 }.line_at(byte as u64 + 1)
}

/// Counts lines: the reader's own position of a row is that of the blank lines above it.
struct LineCounter<'a> {
    text: &'a [u8],
    counted: usize,
    line: u64,
}

impl LineCounter<'_> {
    /// The line of the row that ends (with its line end) at this byte; ask in ascending order.
    fn line_at(&mut self, end: u64) -> u64 {
        let last = usize::try_from(end).map_or(self.text.len(), |end| end.min(self.text.len())).saturating_sub(1);
        if let Some(passed) = self.text.get(self.counted..last) {
            self.line += passed.iter().filter(|&&byte| byte == b'\n').count() as u64;
            self.counted = last;
        }
        self.line
    }
}
