//! The image's logs: defmt frames from its RTT buffer in RAM, as a debug probe takes them.

use defmt_decoder::{DecodeError, StreamDecoder, Table};
use rigless::emulator::Memory;
use rigless::soc::Width;
use rigless::symbols::Symbols;

/// Place of the first up channel in the control block, behind its name (16 bytes) and the two counts.
const CHANNEL: u64 = 24;

/// The reader of one channel.
pub struct Log {
    block: u64,
    decoder: Box<dyn StreamDecoder + Send + Sync>,
}

impl std::fmt::Debug for Log {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Log").field("block", &self.block).finish_non_exhaustive()
    }
}

impl Log {
    /// A reader for this image; `None` if it has no logs.
    pub fn of(image: &[u8]) -> Option<Self> {
        let table: &'static Table = Box::leak(Box::new(Table::parse(image).ok()??));
        let block = Symbols::read(image, |address| address).ok()?.get("_SEGGER_RTT").ok()?;
        Some(Self { block, decoder: table.new_stream_decoder() })
    }

    /// Takes what is there, as lines of text.
    pub fn take(&mut self, memory: &mut dyn Memory) -> String {
        let mut text = String::new();
        if let Some(bytes) = self.bytes(memory) {
            self.decoder.received(&bytes);
            loop {
                match self.decoder.decode() {
                    Ok(frame) => {
                        text.push_str(&format!(
                            "{:>8} {:<5} {}\n",
                            frame.display_timestamp().map_or_else(String::new, |time| time.to_string()),
                            frame.level().map_or("", |level| level.as_str()),
                            frame.display_message()
                        ));
                    }
                    Err(DecodeError::UnexpectedEof) => break,
                    // A frame that a reset tore; the encoding finds the next one.
                    Err(DecodeError::Malformed) => {}
                }
            }
        }
        text
    }

    fn bytes(&self, memory: &mut dyn Memory) -> Option<Vec<u8>> {
        let mut word = |offset: u64| memory.read(self.block + offset, Width::W32).ok();
        let (buffer, size, write, read) = (word(CHANNEL + 4)?, word(CHANNEL + 8)?, word(CHANNEL + 12)?, word(CHANNEL + 16)?);
        if write == read || write >= size || read >= size || size > 1 << 16 {
            return None;
        }
        let count = (write + size - read) % size;
        let bytes = (0..count).map_while(|at| memory.read(buffer + (read + at) % size, Width::W8).ok());
        let bytes = bytes.filter_map(|byte| u8::try_from(byte).ok()).collect();
        memory.write(self.block + CHANNEL + 16, Width::W32, write).ok()?;
        Some(bytes)
    }
}
