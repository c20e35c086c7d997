//! The lines of a text that is read piece by piece: the text itself is never in memory as a whole.

use std::io::{ErrorKind, Read};

use memchr::memchr;

/// A line is no longer than this; a file without line ends is none of ours.
pub(super) const LONGEST_LINE: usize = 1 << 20;

/// Why there is no next line.
pub(super) enum LineError {
    /// The system said so.
    Io(std::io::Error),
    /// The line with this number is too long.
    TooLong(u64),
}

/// Hands out lines without their ends.
pub(super) struct Lines<R> {
    reader: R,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    ended: bool,
    /// Number of the line handed out last, counted from 1.
    line: u64,
}

impl<R: Read> Lines<R> {
    pub(super) fn new(reader: R) -> Self {
        Self { reader, buffer: vec![0; LONGEST_LINE], start: 0, end: 0, ended: false, line: 0 }
    }

    /// Reads until the buffer is full or the text ends.
    fn fill(&mut self) -> std::io::Result<()> {
        self.buffer.copy_within(self.start..self.end, 0);
        (self.start, self.end) = (0, self.end - self.start);
        while self.end < self.buffer.len() && !self.ended {
            match self.reader.read(&mut self.buffer[self.end..]) {
                Ok(0) => self.ended = true,
                Ok(count) => self.end += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// The beginning of what was not handed out yet, and whether it is all there is.
    pub(super) fn head(&mut self) -> std::io::Result<(&[u8], bool)> {
        self.fill()?;
        Ok((&self.buffer[self.start..self.end], self.ended))
    }

    /// What was read and not handed out yet, and the number of its first line.
    pub(super) fn buffered(&self) -> (u64, &[u8]) {
        (self.line + 1, &self.buffer[self.start..self.end])
    }

    /// Passes over the next `bytes`, which hold `lines` whole lines.
    pub(super) fn skip(&mut self, bytes: usize, lines: u64) {
        self.start += bytes;
        self.line += lines;
    }

    /// The next line with its number; nothing at the end.
    pub(super) fn next(&mut self) -> Result<Option<(u64, &[u8])>, LineError> {
        let found = memchr(b'\n', &self.buffer[self.start..self.end]);
        let length = match found {
            Some(length) => length,
            None => {
                self.fill().map_err(LineError::Io)?;
                match memchr(b'\n', &self.buffer[self.start..self.end]) {
                    Some(length) => length,
                    None if !self.ended => return Err(LineError::TooLong(self.line + 1)),
                    None if self.start == self.end => return Ok(None),
                    None => self.end - self.start,
                }
            }
        };
        let begin = self.start;
        self.start = (begin + length + 1).min(self.end);
        self.line += 1;
        let line = &self.buffer[begin..begin + length];
        Ok(Some((self.line, line.strip_suffix(b"\r").unwrap_or(line))))
    }
}
