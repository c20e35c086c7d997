//! The hash of a file that is read once, piece by piece.

use std::io::{Read, Result};

use sha2::{Digest, Sha256};

/// Bytes that are read at once, at most.
const PIECE: usize = 64 << 10;

/// Passes bytes on and hashes them.
pub(super) struct Hashed<R> {
    reader: R,
    hash: Sha256,
}

impl<R: Read> Hashed<R> {
    pub(super) fn new(reader: R) -> Self {
        Self { reader, hash: Sha256::new() }
    }

    /// SHA-256 of the whole file in hexadecimal, what nobody asked for included.
    pub(super) fn finish(mut self) -> Result<String> {
        std::io::copy(&mut self, &mut std::io::sink())?;
        Ok(self.hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

impl<R: Read> Read for Hashed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        // A piece is hashed while it lies in the nearest cache.
        let piece = buffer.len().min(PIECE);
        let count = self.reader.read(&mut buffer[..piece])?;
        self.hash.update(&buffer[..count]);
        Ok(count)
    }
}
