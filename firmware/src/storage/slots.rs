//! Two slots of flash: what a board brings, and any `embedded-storage` flash as them.

use core::cell::Cell;

use embedded_storage::nor_flash::NorFlash;

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

    /// Words that the flash takes only together and only once between two erases, a power of two. A store programs them in order, beginning at a
    /// multiple of their length, and fills up with erased ones; what a unit holds can be read when all of it was programmed.
    const PROGRAM_WORDS: u32 = 1;

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

/// Flash that lies in memory: sectors of [`NorFlash::ERASE_SIZE`], each in one piece.
pub trait MappedFlash: NorFlash {
    /// The bytes of a sector; none beyond the last.
    fn mapped(&self, sector: usize) -> &[u8];
}

/// The first two sectors of any embedded-storage flash as slots.
#[derive(Debug)]
pub struct Sectors<F> {
    flash: F,
    in_use: Cell<Option<Slot>>,
}

/// Why a sector was not changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SectorError<E> {
    /// What lies in it is in use.
    InUse,
    /// The driver says so.
    Flash(E),
}

impl<F: MappedFlash> Sectors<F> {
    /// Over a driver.
    pub const fn new(flash: F) -> Self {
        Self { flash, in_use: Cell::new(None) }
    }

    /// Gives the driver back.
    pub fn release(self) -> F {
        self.flash
    }

    /// Where a slot begins.
    fn base(slot: Slot) -> u32 {
        match slot {
            Slot::A => 0,
            Slot::B => u32::try_from(F::ERASE_SIZE).unwrap_or(u32::MAX),
        }
    }

    fn change(&mut self, slot: Slot, operation: impl FnOnce(&mut F) -> Result<(), F::Error>) -> Result<(), SectorError<F::Error>> {
        if self.in_use.get() == Some(slot) {
            return Err(SectorError::InUse);
        }
        operation(&mut self.flash).map_err(SectorError::Flash)
    }
}

impl<F: MappedFlash> Flash for Sectors<F> {
    type Error = SectorError<F::Error>;

    fn contents(&self, slot: Slot) -> &[u8] {
        self.flash.mapped(usize::from(slot == Slot::B))
    }

    fn erase(&mut self, slot: Slot) -> Result<(), Self::Error> {
        let base = Self::base(slot);
        let sector = Self::base(Slot::B);
        self.change(slot, |flash| flash.erase(base, base.saturating_add(sector)))
    }

    fn program(&mut self, slot: Slot, offset: u32, word: u32) -> Result<(), Self::Error> {
        // Beyond slot A lies slot B, which the driver would take.
        let end = Self::base(Slot::B);
        let at = if offset < end { Self::base(slot).saturating_add(offset) } else { u32::MAX };
        self.change(slot, |flash| flash.write(at, &word.to_le_bytes()))
    }

    fn hold(&self, slot: Option<Slot>) {
        self.in_use.set(slot);
    }
}
