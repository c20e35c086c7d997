//! Compressed text, unfolded as far as a recording goes: a few bytes can stand for as many as one likes.

use std::io::{BufReader, Error, Read, Result};

use flate2::read::MultiGzDecoder;

/// Text of recordings shrinks to a third or a tenth; this much is never more than a hundredfold.
const MOST_TIMES: u64 = 100;
/// Up to here nobody minds how often a file is unfolded.
const FREE: u64 = 64 << 20;

/// The error of a file that unfolds too often.
#[derive(Debug)]
struct Unfolds(u64);

impl std::fmt::Display for Unfolds {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "unfolds to more than {} times its size", self.0)
    }
}

impl std::error::Error for Unfolds {}

/// How many times its size an error complains about, if it is that error.
pub(super) fn times(error: &Error) -> Option<u64> {
    error.get_ref()?.downcast_ref::<Unfolds>().map(|unfolds| unfolds.0)
}

/// Counts bytes.
struct Counted<R> {
    reader: R,
    bytes: u64,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let count = self.reader.read(buffer)?;
        self.bytes += count as u64;
        Ok(count)
    }
}

/// The text of a gzip file.
pub(super) struct Unfold<R: Read> {
    decoder: MultiGzDecoder<BufReader<Counted<R>>>,
    bytes: u64,
}

impl<R: Read> Unfold<R> {
    pub(super) fn new(reader: R) -> Self {
        Self { decoder: MultiGzDecoder::new(BufReader::with_capacity(1 << 16, Counted { reader, bytes: 0 })), bytes: 0 }
    }
}

impl<R: Read> Read for Unfold<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let count = self.decoder.read(buffer)?;
        self.bytes += count as u64;
        let folded = self.decoder.get_ref().get_ref().bytes;
        if self.bytes > FREE && self.bytes / MOST_TIMES > folded {
            return Err(Error::other(Unfolds(MOST_TIMES)));
        }
        Ok(count)
    }
}
