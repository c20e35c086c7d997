//! Storage: one thing kept in two flash slots so that a power cut at any moment leaves the old or the new one, whole.
//!
//! Terms. A **slot** is an erasable piece of flash. It is **whole** when its header and its payload's CRC-32 are right, and **active** when of
//! all whole slots its last activation has the highest sequence number. A store never touches its active slot, except to append an
//! activation.
//!
//! ```text
//! word  0        magic "CSL1"
//!       1        kind in the high half, schema version in the low half
//!       2        length of the payload in bytes
//!       3        CRC-32 of the payload
//!       4        CRC-32 of words 0 to 3; written last of the header
//!       8..128   activations: pairs (sequence, inverted sequence), appended; the last sound pair counts
//!       128..    payload
//! ```
//!
//! Flash can only clear bits when programming and set them when erasing. Half a program or half an erase therefore moves bits one way, and
//! a pair of a number and its inverse that moved one way is never sound again unless it is complete.
//!
//! An upload erases the other slot, writes the payload, reads it back, then writes the header: from then on the slot is whole but not
//! active. Activation is two words; it is the one moment at which old becomes new. Rolling back is activating the other slot.

use model_export::blob::crc32;

const MAGIC: u32 = u32::from_be_bytes(*b"CSL1");
const ERASED: u32 = u32::MAX;
/// Bytes of a slot that are not payload.
pub const HEADER_BYTES: u32 = 512;
const LOG_FIRST_WORD: u32 = 8;
const LOG_PAIRS: u32 = 60;
const WORD_BYTES: u32 = 4;

/// One of the two slots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Slot {
    /// The first.
    A,
    /// The second.
    B,
}

impl Slot {
    /// Both.
    pub const BOTH: [Self; 2] = [Self::A, Self::B];

    /// The other one.
    pub const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }
}

/// Two slots of flash: what a board must bring. Both have the same length, a multiple of four bytes.
///
/// Erasing and programming may stop the whole processor for as long as they take (on the STM32F405 up to some seconds for a slot of 128 KiB), so
/// a store is written only while vented.
pub trait Flash {
    /// What can go wrong.
    type Error;

    /// The slot's bytes; internal flash is mapped into memory.
    fn contents(&self, slot: Slot) -> &[u8];

    /// Sets every bit of the slot.
    ///
    /// # Errors
    /// When the hardware says so; the slot may hold anything then.
    fn erase(&mut self, slot: Slot) -> Result<(), Self::Error>;

    /// Clears the zero bits of `word` at a byte offset that is a multiple of four.
    ///
    /// # Errors
    /// When the hardware says so; the word may hold anything then.
    fn program(&mut self, slot: Slot, offset: u32, word: u32) -> Result<(), Self::Error>;

    /// From now on, what lies in `slot` is in use; flash that can refuse to change it does.
    fn hold(&self, _slot: Option<Slot>) {}
}

/// Why something could not be stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StorageError {
    /// The flash reports an error.
    Flash,
    /// The payload is longer than a slot takes; in bytes.
    TooLong(u32),
    /// A piece does not continue where the last one ended; it goes on at this offset.
    Offset(u32),
    /// A piece is not a multiple of four bytes although it is not the last, or goes beyond the announced length.
    PieceLength,
    /// The payload read back has another checksum than announced, or is incomplete.
    Checksum,
    /// The slot is not whole.
    NotWhole,
    /// The activation log of the slot is full: upload again.
    LogFull,
}

/// What a slot holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contents {
    /// Length of the payload.
    pub length: u32,
    /// CRC-32 of the payload.
    pub crc32: u32,
    /// Schema version of the payload.
    pub version: u16,
    /// Sequence number of the last activation, if there was one.
    pub sequence: Option<u32>,
    /// Whether the payload's CRC-32 is right.
    pub is_whole: bool,
}

/// Which slot counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// The active slot; `None` before the first activation.
    pub active: Option<Slot>,
    /// The slot that should be active is damaged, and the other one stands in, if there is one.
    pub is_fallback: bool,
}

/// A pair of slots for one kind of thing.
#[derive(Debug)]
pub struct Store<F> {
    flash: F,
    kind: u16,
    version: u16,
}

/// An upload under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Upload {
    slot: Slot,
    length: u32,
    crc32: u32,
    written: u32,
}

impl Upload {
    /// Offset at which the upload goes on.
    pub fn next_offset(&self) -> u32 {
        self.written
    }

    /// Whether everything announced is written and has the announced checksum.
    pub fn is_complete(&self, checksum: u32) -> bool {
        self.written == self.length && checksum == self.crc32
    }
}

impl<F: Flash> Store<F> {
    /// A store for things of `kind` in schema `version`. Things of another kind in the slots are not seen.
    pub fn new(flash: F, kind: u16, version: u16) -> Self {
        Self { flash, kind, version }
    }

    /// The flash.
    pub fn flash(&self) -> &F {
        &self.flash
    }

    /// Gives the flash back.
    pub fn release(self) -> F {
        self.flash
    }

    /// Longest payload, in bytes.
    pub fn capacity(&self) -> u32 {
        u32::try_from(self.flash.contents(Slot::A).len()).unwrap_or(0).saturating_sub(HEADER_BYTES)
    }

    /// What a slot holds; `None` without a sound header.
    pub fn inspect(&self, slot: Slot) -> Option<Contents> {
        let bytes = self.flash.contents(slot);
        let word = |index: u32| {
            let at = usize::try_from(index * WORD_BYTES).ok()?;
            bytes.get(at..)?.first_chunk::<4>().map(|word| u32::from_le_bytes(*word))
        };
        let header = bytes.get(..16)?;
        if word(0)? != MAGIC || word(4)? != crc32(0, header) || word(1)? >> 16 != u32::from(self.kind) {
            return None;
        }
        let (length, checksum) = (word(2)?, word(3)?);
        let payload = payload(bytes, length)?;
        let sequence = (0..LOG_PAIRS).filter_map(|pair| self.activation(slot, pair)).max();
        let version = u16::try_from(word(1)? & 0xffff).ok()?;
        Some(Contents { length, crc32: checksum, version, sequence, is_whole: crc32(0, payload) == checksum })
    }

    /// Which slot counts.
    pub fn select(&self) -> Selection {
        let sequence = |slot| self.inspect(slot).and_then(|contents| contents.sequence.map(|sequence| (sequence, contents.is_whole)));
        let (a, b) = (sequence(Slot::A), sequence(Slot::B));
        let (newer, older) = match (a, b) {
            (None, None) => return Selection::default(),
            (Some(a), b) if b.is_none_or(|b| a.0 > b.0) => ((Slot::A, a.1), b.map(|b| (Slot::B, b.1))),
            (a, Some(b)) => ((Slot::B, b.1), a.map(|a| (Slot::A, a.1))),
            (Some(a), None) => ((Slot::A, a.1), None),
        };
        if newer.1 {
            return Selection { active: Some(newer.0), is_fallback: false };
        }
        Selection { active: older.filter(|older| older.1).map(|older| older.0), is_fallback: true }
    }

    /// The payload of a slot, if it is whole.
    pub fn payload(&self, slot: Slot) -> Option<&[u8]> {
        let contents = self.inspect(slot).filter(|contents| contents.is_whole)?;
        payload(self.flash.contents(slot), contents.length)
    }

    /// The active payload.
    pub fn active_payload(&self) -> Option<&[u8]> {
        self.payload(self.select().active?)
    }

    /// Begins an upload into the slot that is not active, which is erased.
    ///
    /// # Errors
    /// [`StorageError::TooLong`] or [`StorageError::Flash`].
    pub fn begin(&mut self, length: u32, crc32: u32) -> Result<Upload, StorageError> {
        if length > self.capacity() {
            return Err(StorageError::TooLong(self.capacity()));
        }
        let slot = self.select().active.map_or(Slot::A, Slot::other);
        self.flash.erase(slot).map_err(|_| StorageError::Flash)?;
        Ok(Upload { slot, length, crc32, written: 0 })
    }

    /// Writes the next piece. All but the last are a multiple of four bytes long.
    ///
    /// # Errors
    /// [`StorageError::Offset`], [`StorageError::PieceLength`] or [`StorageError::Flash`].
    pub fn write(&mut self, upload: &mut Upload, offset: u32, bytes: &[u8]) -> Result<(), StorageError> {
        if offset != upload.written {
            return Err(StorageError::Offset(upload.written));
        }
        let length = u32::try_from(bytes.len()).map_err(|_| StorageError::PieceLength)?;
        let end = offset.checked_add(length).filter(|end| *end <= upload.length).ok_or(StorageError::PieceLength)?;
        if !length.is_multiple_of(WORD_BYTES) && end != upload.length {
            return Err(StorageError::PieceLength);
        }
        let mut at = HEADER_BYTES.saturating_add(offset);
        for piece in bytes.chunks(4) {
            let mut word = ERASED.to_le_bytes();
            word.iter_mut().zip(piece).for_each(|(byte, new)| *byte = *new);
            self.flash.program(upload.slot, at, u32::from_le_bytes(word)).map_err(|_| StorageError::Flash)?;
            at = at.saturating_add(WORD_BYTES);
        }
        upload.written = end;
        Ok(())
    }

    /// The bytes written so far, for checks that go beyond the checksum.
    pub fn uploaded(&self, upload: &Upload) -> &[u8] {
        payload(self.flash.contents(upload.slot), upload.written).unwrap_or(&[])
    }

    /// Checks what was written and makes the slot whole; it is not active yet.
    ///
    /// # Errors
    /// [`StorageError::Checksum`] or [`StorageError::Flash`].
    pub fn finish(&mut self, upload: Upload) -> Result<Slot, StorageError> {
        if !upload.is_complete(crc32(0, self.uploaded(&upload))) {
            return Err(StorageError::Checksum);
        }
        let kind_and_version = (u32::from(self.kind) << 16) | u32::from(self.version);
        let words = [MAGIC, kind_and_version, upload.length, upload.crc32];
        let mut header_crc = 0;
        let mut at = 0;
        for word in words {
            header_crc = crc32(header_crc, &word.to_le_bytes());
            self.flash.program(upload.slot, at, word).map_err(|_| StorageError::Flash)?;
            at += WORD_BYTES;
        }
        self.flash.program(upload.slot, at, header_crc).map_err(|_| StorageError::Flash)?;
        if self.payload(upload.slot).is_some() { Ok(upload.slot) } else { Err(StorageError::Flash) }
    }

    /// Makes a whole slot the active one.
    ///
    /// # Errors
    /// [`StorageError::NotWhole`], [`StorageError::LogFull`] or [`StorageError::Flash`].
    pub fn activate(&mut self, slot: Slot) -> Result<(), StorageError> {
        if self.payload(slot).is_none() {
            return Err(StorageError::NotWhole);
        }
        let last = Slot::BOTH.into_iter().filter_map(|slot| self.inspect(slot).and_then(|contents| contents.sequence)).max();
        let sequence = last.unwrap_or(0).checked_add(1).ok_or(StorageError::LogFull)?;
        let free = (0..LOG_PAIRS).find(|pair| self.log_words(slot, *pair) == Some((ERASED, ERASED)));
        let at = (LOG_FIRST_WORD + 2 * free.ok_or(StorageError::LogFull)?) * WORD_BYTES;
        self.flash.program(slot, at, sequence).map_err(|_| StorageError::Flash)?;
        self.flash.program(slot, at + WORD_BYTES, !sequence).map_err(|_| StorageError::Flash)?;
        if self.select().active == Some(slot) { Ok(()) } else { Err(StorageError::Flash) }
    }

    /// Uploads and activates in one go.
    ///
    /// # Errors
    /// As the single steps.
    pub fn save(&mut self, bytes: &[u8]) -> Result<(), StorageError> {
        let length = u32::try_from(bytes.len()).map_err(|_| StorageError::TooLong(self.capacity()))?;
        let mut upload = self.begin(length, crc32(0, bytes))?;
        self.write(&mut upload, 0, bytes)?;
        // The bytes never left this device: what reads back wrong, the flash did not take.
        let slot = self.finish(upload).map_err(|error| if error == StorageError::Checksum { StorageError::Flash } else { error })?;
        self.activate(slot)
    }

    /// The slot that could be activated next: whole, and not active.
    pub fn inactive_whole(&self) -> Option<Slot> {
        let active = self.select().active;
        Slot::BOTH.into_iter().find(|slot| Some(*slot) != active && self.payload(*slot).is_some())
    }

    fn log_words(&self, slot: Slot, pair: u32) -> Option<(u32, u32)> {
        let at = usize::try_from((LOG_FIRST_WORD + 2 * pair) * WORD_BYTES).ok()?;
        let (first, rest) = self.flash.contents(slot).get(at..)?.split_first_chunk::<4>()?;
        Some((u32::from_le_bytes(*first), u32::from_le_bytes(*rest.first_chunk::<4>()?)))
    }

    fn activation(&self, slot: Slot, pair: u32) -> Option<u32> {
        self.log_words(slot, pair).filter(|(sequence, inverted)| *sequence == !*inverted).map(|(sequence, _)| sequence)
    }
}

fn payload(slot: &[u8], length: u32) -> Option<&[u8]> {
    let first = usize::try_from(HEADER_BYTES).ok()?;
    let length = usize::try_from(length).ok()?;
    slot.get(first..)?.get(..length)
}
