//! Flash memory of a simulated rig: two pairs of slots in RAM that behave like flash, kept in a file between commands if wanted.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use firmware::storage::{Flash, Slot, Store};
use model_export::link::settings::Settings;

/// Bytes of a settings slot: as much of the board's sector of 128 KiB as settings ever need.
pub const SETTINGS_SLOT_BYTES: usize = 16 * 1024;
/// Bytes of a model slot: a sector of 128 KiB on the board.
pub const MODEL_SLOT_BYTES: usize = 128 * 1024;

/// Two slots.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SlotPair {
    slots: [Vec<u8>; 2],
}

impl SlotPair {
    /// Erased slots.
    #[must_use]
    pub fn erased(bytes: usize) -> Self {
        Self { slots: [vec![0xff; bytes], vec![0xff; bytes]] }
    }

    /// The bytes of a slot, to damage them.
    pub fn contents_mut(&mut self, slot: Slot) -> &mut [u8] {
        &mut self.slots[usize::from(slot == Slot::B)]
    }
}

/// A write outside the slot or off the word grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutOfSlot;

impl Flash for SlotPair {
    type Error = OutOfSlot;

    fn contents(&self, slot: Slot) -> &[u8] {
        &self.slots[usize::from(slot == Slot::B)]
    }

    fn erase(&mut self, slot: Slot) -> Result<(), OutOfSlot> {
        self.contents_mut(slot).fill(0xff);
        Ok(())
    }

    fn program(&mut self, slot: Slot, offset: u32, word: u32) -> Result<(), OutOfSlot> {
        let at = usize::try_from(offset).map_err(|_| OutOfSlot)?;
        let bytes = self.contents_mut(slot).get_mut(at..at + 4).filter(|_| at.is_multiple_of(4)).ok_or(OutOfSlot)?;
        // Programming clears bits and sets none.
        bytes.iter_mut().zip(word.to_le_bytes()).for_each(|(byte, new)| *byte &= new);
        Ok(())
    }
}

/// The whole flash that a rig keeps things in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlashMemory {
    /// For settings.
    pub settings: SlotPair,
    /// For models.
    pub models: SlotPair,
}

impl Default for FlashMemory {
    /// That of a device nobody has set up.
    fn default() -> Self {
        Self { settings: SlotPair::erased(SETTINGS_SLOT_BYTES), models: SlotPair::erased(MODEL_SLOT_BYTES) }
    }
}

impl FlashMemory {
    /// That of a device with this model active.
    ///
    /// # Errors
    /// When the bytes are no blob or do not fit.
    pub fn with_model(blob: &[u8]) -> Result<Self> {
        model_export::blob::decode(blob).map_err(|error| anyhow::anyhow!("is no blob this program knows: {error}"))?;
        let flash = Self::default();
        let mut store = Store::new(flash.models, firmware::model::STORE_KIND, firmware::model::STORE_VERSION);
        store.save(blob).map_err(|error| anyhow::anyhow!("does not fit the device's flash: {error:?}"))?;
        Ok(Self { models: store.release(), ..flash })
    }

    /// The same with these settings saved.
    ///
    /// # Errors
    /// Never: settings fit their slot.
    pub fn with_settings(self, settings: &Settings) -> Result<Self> {
        let mut store = Store::new(self.settings, firmware::settings::STORE_KIND, firmware::settings::STORE_VERSION);
        let bytes = firmware::settings::encode(settings).context("settings that cannot be encoded")?;
        store.save(&bytes).map_err(|error| anyhow::anyhow!("settings do not fit the device's flash: {error:?}"))?;
        Ok(Self { settings: store.release(), ..self })
    }

    /// The whole flash as one piece: settings A and B, models A and B.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        self.settings.slots.iter().chain(&self.models.slots).flatten().copied().collect()
    }

    /// From one piece.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        if bytes.len() != 2 * (SETTINGS_SLOT_BYTES + MODEL_SLOT_BYTES) {
            return None;
        }
        let (settings, models) = bytes.split_at(2 * SETTINGS_SLOT_BYTES);
        let pair = |bytes: &[u8], length: usize| SlotPair { slots: [bytes[..length].to_vec(), bytes[length..].to_vec()] };
        Some(Self { settings: pair(settings, SETTINGS_SLOT_BYTES), models: pair(models, MODEL_SLOT_BYTES) })
    }

    /// What a file keeps; erased flash if there is no such file yet.
    ///
    /// # Errors
    /// When the file cannot be read or is none of ours.
    pub fn read(path: &Path) -> Result<Self> {
        if !path.exists() {
            return Ok(Self::default());
        }
        let bytes = output::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let flash = Self::from_bytes(&bytes);
        ensure!(
            flash.is_some(),
            "{}: is no flash memory of a simulated rig ({} bytes); name another file, a new one is made",
            path.display(),
            bytes.len()
        );
        Ok(flash.unwrap_or_default())
    }

    /// Keeps it in a file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        output::write_atomic(path, &self.to_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flash_clears_bits_and_only_erasing_sets_them() {
        let mut flash = SlotPair::erased(64);
        flash.program(Slot::B, 8, 0xffff_00ff).unwrap();
        flash.program(Slot::B, 8, 0x0fff_ffff).unwrap();
        assert_eq!(flash.contents(Slot::B)[8..12], [0xff, 0x00, 0xff, 0x0f]);
        assert_eq!(flash.contents(Slot::A), [0xff; 64]);
        assert_eq!(flash.program(Slot::A, 62, 0), Err(OutOfSlot));
        assert_eq!(flash.program(Slot::A, 6, 0), Err(OutOfSlot));
        flash.erase(Slot::B).unwrap();
        assert_eq!(flash.contents(Slot::B), [0xff; 64]);
    }

    #[test]
    fn flash_survives_its_file_and_foreign_files_are_refused() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("flash");
        let mut flash = FlashMemory::read(&path)?;
        assert_eq!(flash, FlashMemory::default());
        flash.models.program(Slot::A, 4, 0x1234_5678).unwrap();
        flash.write(&path)?;
        assert_eq!(FlashMemory::read(&path)?, flash);
        std::fs::write(&path, b"something else")?;
        assert!(FlashMemory::read(&path).is_err());
        Ok(())
    }
}
