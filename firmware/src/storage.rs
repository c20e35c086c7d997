//! Storage: one thing kept in two flash slots so that a power cut at any moment leaves the old or the new one, whole.
//!
//! Terms. A **slot** is an erasable piece of flash. It is **whole** when its header and its payload's CRC-32 are right and its version is the
//! store's. Each slot has a log of **activations**; one that was not **retired** is live. The **active** slot is the whole one with the newest
//! live activation. A store never touches its active slot, except to append an activation or to invalidate one.
//!
//! ```text
//! word  0        magic "CSL2"
//!       1        kind in the high half, schema version in the low half
//!       2        length of the payload in bytes
//!       3        CRC-32 of the payload
//!       4        CRC-32 of words 0 to 3; written last of the header
//!       8..248   activations, appended: the sequence number in three codes, and a word that stays erased until it is retired
//!       256..    payload
//! ```
//!
//! Where flash is programmed in units of more than a word ([`Flash::PROGRAM_WORDS`]), each unit once, an activation and the word that retires it
//! have a unit each, so there are fewer of them.
//!
//! An upload erases the other slot, writes the payload, reads it back, then writes the header: from then on the slot is whole but not
//! active. Activation is three words; it is the one moment at which old becomes new. Then the activation before it is retired. Rolling back is
//! activating the other slot.
//!
//! # Damage and interruption
//!
//! An interrupted change and damage must not be mistaken for each other: the one is no fault, and the other must never bring older contents
//! back unsaid.
//! * A single wrong bit in an activation is corrected. That is also the last state before an activation is complete, so it is the new state.
//! * A retired slot never becomes active again by itself. When no live slot is whole, the newer one is damaged. The same holds when a slot that is
//!   not whole has a newer live activation than the one that is.
//! * Flash that was never activated has empty logs, but for a first activation that was cut short. Everything else without a live slot is damage.
//!
//! # Why not sequential-storage
//!
//! The crate `sequential-storage` (8.0.2, a map with one key of 600 bytes over two pages of 16 KiB) was put through the same two sweeps. It passes every
//! power cut: 18,678 cuts before and within every word and erase of 59 saves leave the old or the new settings, and the next save works. But of the
//! 262,144 bits of its flash after five saves, 4,872 bring older settings back unsaid when they flip: an item with a wrong checksum is passed
//! over. Here none does (`firmware/tests/storage.rs`): older limits may be laxer ones, so damage must be told.

mod slots;

use model_export::blob::crc32;

pub use slots::{Flash, MappedFlash, SectorError, Sectors, Slot};

const MAGIC: u32 = u32::from_be_bytes(*b"CSL2");
const ERASED: u32 = u32::MAX;
/// Bytes of a slot that are not payload.
pub const HEADER_BYTES: u32 = 1024;
const LOG_FIRST_WORD: u32 = 8;
/// Words of an activation's number, and of an entry as it is read.
const ACTIVATION_WORDS: u32 = 3;
const ENTRY_WORDS: u32 = ACTIVATION_WORDS + 1;
const LOG_WORDS: u32 = HEADER_BYTES / WORD_BYTES - LOG_FIRST_WORD;
/// A retired activation's last word. Half of its bits decide, so that a flipped one does not.
const RETIRED: u32 = 0;
const WORD_BYTES: u32 = 4;

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
    /// Whether the payload has its checksum and the version is the store's.
    pub is_whole: bool,
}

/// Which slot counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// The active slot. With damage the other one, if it is whole: for reading, not for relying on it.
    pub active: Option<Slot>,
    /// What was activated last is damaged, or cannot be told.
    pub is_damaged: bool,
}

/// An entry of an activation log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Activation {
    sequence: u32,
    is_retired: bool,
}

/// The words of an activation before it is retired. A bit of the sequence number lies at three places and once inverted, so that bits which
/// an interrupted erase sets at one place of every word do not make another number of it.
const fn activation_words(sequence: u32) -> [u32; 3] {
    [sequence, !sequence, sequence.rotate_left(11)]
}

impl Activation {
    /// Reads an entry with at most one wrong bit in its number.
    fn decode(words: [u32; ENTRY_WORDS as usize]) -> Option<Self> {
        let [first, inverted, rotated, retired] = words;
        let (second, third) = (!inverted, rotated.rotate_right(11));
        let sequence = (first & second) | (second & third) | (third & first);
        let wrong = (first ^ sequence).count_ones() + (second ^ sequence).count_ones() + (third ^ sequence).count_ones();
        (wrong <= 1).then_some(Self { sequence, is_retired: (retired ^ RETIRED).count_ones() <= u32::BITS / 2 })
    }
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
        let word = |index: u32| self.word(slot, index);
        let header = bytes.get(..16)?;
        if word(0)? != MAGIC || word(4)? != crc32(0, header) || word(1)? >> 16 != u32::from(self.kind) {
            return None;
        }
        let (length, checksum) = (word(2)?, word(3)?);
        let payload = payload(bytes, length)?;
        let version = u16::try_from(word(1)? & 0xffff).ok()?;
        let is_whole = version == self.version && crc32(0, payload) == checksum;
        Some(Contents { length, crc32: checksum, version, is_whole })
    }

    /// Which slot counts.
    pub fn select(&self) -> Selection {
        let mut newest: Option<(u32, Slot)> = None;
        let mut newest_lost = None;
        for slot in Slot::BOTH {
            let Some(sequence) = self.live(slot) else { continue };
            if self.payload(slot).is_none() {
                newest_lost = newest_lost.max(Some(sequence));
            } else if newest.is_none_or(|newest| sequence > newest.0) {
                newest = Some((sequence, slot));
            }
        }
        match newest {
            Some((sequence, slot)) => Selection { active: Some(slot), is_damaged: newest_lost > Some(sequence) },
            None => {
                let is_damaged = Slot::BOTH.into_iter().any(|slot| !self.is_log_fresh(slot));
                let whole = Slot::BOTH.into_iter().find(|slot| self.payload(*slot).is_some());
                Selection { active: whole.filter(|_| is_damaged), is_damaged }
            }
        }
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
            at = self.program(upload.slot, at, &[u32::from_le_bytes(word)])?;
        }
        if end == upload.length {
            self.fill_unit(upload.slot, at)?;
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
        let header_crc = words.iter().fold(0, |crc, word| crc32(crc, &word.to_le_bytes()));
        let at = self.program(upload.slot, 0, &words)?;
        let at = self.program(upload.slot, at, &[header_crc])?;
        self.fill_unit(upload.slot, at)?;
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
        let Selection { active, is_damaged } = self.select();
        if active == Some(slot) && !is_damaged {
            return Ok(());
        }
        let last = Slot::BOTH.into_iter().flat_map(|slot| self.log(slot)).map(|(_, activation)| activation.sequence).max();
        let sequence = last.unwrap_or(0).checked_add(1).ok_or(StorageError::LogFull)?;
        let free = (0..Self::LOG_ENTRIES).find(|entry| self.entry(slot, *entry) == Some([ERASED; ENTRY_WORDS as usize]));
        let [first, _] = Self::entry_places(free.ok_or(StorageError::LogFull)?);
        let at = self.program(slot, first * WORD_BYTES, &activation_words(sequence))?;
        self.fill_unit(slot, at)?;
        // Every activation before it, so that none can come back when this one is lost.
        for slot in Slot::BOTH {
            for entry in 0..Self::LOG_ENTRIES {
                let is_live = |words: &[u32; ENTRY_WORDS as usize]| {
                    Activation::decode(*words).is_some_and(|other| other.sequence != sequence && !other.is_retired)
                };
                if let Some([.., ERASED]) = self.entry(slot, entry).filter(is_live) {
                    let [_, retirement] = Self::entry_places(entry);
                    let at = self.program(slot, retirement * WORD_BYTES, &[RETIRED])?;
                    self.fill_unit(slot, at)?;
                }
            }
        }
        if self.select() == (Selection { active: Some(slot), is_damaged: false }) { Ok(()) } else { Err(StorageError::Flash) }
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

    /// Words of an activation and of its retirement: whole units each.
    const ENTRY_PARTS: [u32; 2] = [ACTIVATION_WORDS.next_multiple_of(F::PROGRAM_WORDS), F::PROGRAM_WORDS];
    /// Activations in a slot's log.
    const LOG_ENTRIES: u32 = LOG_WORDS / (Self::ENTRY_PARTS[0] + Self::ENTRY_PARTS[1]);

    /// First words of an entry's activation and of its retirement.
    const fn entry_places(entry: u32) -> [u32; 2] {
        let [activation, retirement] = Self::ENTRY_PARTS;
        let first = LOG_FIRST_WORD.next_multiple_of(F::PROGRAM_WORDS) + (activation + retirement) * entry;
        [first, first + activation]
    }

    /// Programs words at a byte offset; gives the offset behind them.
    fn program(&mut self, slot: Slot, at: u32, words: &[u32]) -> Result<u32, StorageError> {
        let mut at = at;
        for word in words {
            self.flash.program(slot, at, *word).map_err(|_| StorageError::Flash)?;
            at = at.saturating_add(WORD_BYTES);
        }
        Ok(at)
    }

    /// Fills the unit that ends before or at this byte offset, if it is not full.
    fn fill_unit(&mut self, slot: Slot, at: u32) -> Result<(), StorageError> {
        let mut at = at;
        while !at.is_multiple_of(WORD_BYTES * F::PROGRAM_WORDS) {
            at = self.program(slot, at, &[ERASED])?;
        }
        Ok(())
    }

    fn word(&self, slot: Slot, index: u32) -> Option<u32> {
        let at = usize::try_from(index * WORD_BYTES).ok()?;
        self.flash.contents(slot).get(at..)?.first_chunk::<4>().map(|word| u32::from_le_bytes(*word))
    }

    fn entry(&self, slot: Slot, entry: u32) -> Option<[u32; ENTRY_WORDS as usize]> {
        let [at, retirement] = Self::entry_places(entry);
        Some([self.word(slot, at)?, self.word(slot, at + 1)?, self.word(slot, at + 2)?, self.word(slot, retirement)?])
    }

    /// The activations of a slot, each with its place.
    fn log(&self, slot: Slot) -> impl Iterator<Item = (u32, Activation)> {
        (0..Self::LOG_ENTRIES).filter_map(move |entry| Some((entry, Activation::decode(self.entry(slot, entry)?)?)))
    }

    /// Sequence number of a slot's newest activation that is not retired.
    fn live(&self, slot: Slot) -> Option<u32> {
        self.log(slot).filter(|(_, activation)| !activation.is_retired).map(|(_, activation)| activation.sequence).max()
    }

    /// Whether a slot was never activated: a first activation may have been cut short, and one bit of the rest may have flipped.
    fn is_log_fresh(&self, slot: Slot) -> bool {
        let cleared: u32 = (1..Self::LOG_ENTRIES).filter_map(|entry| self.entry(slot, entry)).flatten().map(u32::count_zeros).sum();
        self.log(slot).next().is_none() && cleared <= 1
    }
}

fn payload(slot: &[u8], length: u32) -> Option<&[u8]> {
    let first = usize::try_from(HEADER_BYTES).ok()?;
    let length = usize::try_from(length).ok()?;
    slot.get(first..)?.get(..length)
}
