//! Settings in flash: pairs of number and value, so that firmware versions that know other settings still read the rest.

use heapless::Vec;
use model_export::link::settings::{Entry, NUMBERS, SettingError, Settings};
use model_export::wire::{Reader, Wire, Writer};

use crate::storage::{Flash, Store};

/// Kind of a settings slot.
pub const STORE_KIND: u16 = 0x5345;
/// Version of the encoding.
pub const STORE_VERSION: u16 = 1;
/// Longest encoding: up to nine bytes an entry, and the count.
pub const MAX_BYTES: usize = 9 * NUMBERS.len() + 4;

/// Settings as they came out of flash.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stored {
    /// The settings; what is missing or not acceptable has its default.
    pub settings: Settings,
    /// Entries with numbers unknown to this version.
    pub unknown: u16,
    /// Entries whose value this version does not accept.
    pub rejected: u16,
    /// Something saved is lost or not acceptable: the settings are not what the operator chose.
    pub is_damaged: bool,
}

/// Encodes all settings; `None` never happens, since [`MAX_BYTES`] is the longest encoding.
pub fn encode(settings: &Settings) -> Option<Vec<u8, MAX_BYTES>> {
    let mut bytes = Vec::new();
    encode_into(settings, &mut bytes)?;
    Some(bytes)
}

/// As [`encode`], in a place of the caller's.
pub fn encode_into(settings: &Settings, bytes: &mut Vec<u8, MAX_BYTES>) -> Option<()> {
    bytes.resize(MAX_BYTES, 0).ok()?;
    let mut writer = Writer::new(bytes);
    for number in NUMBERS {
        Entry { number: *number, value: settings.get(*number)? }.write(&mut writer);
    }
    let length = writer.finish()?;
    bytes.truncate(length);
    Some(())
}

/// The settings in a store. What is damaged never passes for settings that were saved earlier, nor for the defaults, without saying so.
pub fn load<F: Flash>(store: &Store<F>) -> Stored {
    let stored = store.active_payload().map(decode).unwrap_or_default();
    let is_damaged = stored.is_damaged || stored.rejected > 0 || store.select().is_damaged;
    Stored { is_damaged, ..stored }
}

/// Decodes settings of any version of the firmware.
pub fn decode(bytes: &[u8]) -> Stored {
    let mut stored = Stored::default();
    let mut reader = Reader::new(bytes);
    let mut entry = Entry::default();
    while reader.finish().is_some_and(|rest| !rest.is_empty()) {
        entry.read(&mut reader);
        if reader.finish().is_none() {
            stored.is_damaged = true;
            break;
        }
        match stored.settings.set(entry.number, entry.value) {
            Ok(()) => {}
            Err(SettingError::Unknown) => stored.unknown = stored.unknown.saturating_add(1),
            Err(_) => stored.rejected = stored.rejected.saturating_add(1),
        }
    }
    stored
}

#[cfg(test)]
mod tests {
    use model_export::link::settings::SettingValue;

    use super::*;

    #[test]
    fn settings_survive_the_flash() {
        let settings = Settings { ceiling_bar: 2.5, laser_required: false, host_timeout_ms: 100, ..Settings::default() };
        let stored = decode(&encode(&settings).unwrap());
        assert_eq!(stored, Stored { settings, ..Stored::default() });
    }

    #[test]
    fn a_setting_of_another_version_is_skipped_and_an_impossible_one_takes_its_default() {
        let mut bytes: Vec<u8, 64> = Vec::new();
        let mut buffer = [0; 16];
        for (number, value) in [(60_000, SettingValue::Flag(true)), (1, SettingValue::Float(99.0)), (5, SettingValue::Integer(100))] {
            let length = model_export::wire::write(&Entry { number, value }, &mut buffer).unwrap();
            bytes.extend_from_slice(&buffer[..length]).unwrap();
        }
        let stored = decode(&bytes);
        assert_eq!((stored.unknown, stored.rejected, stored.is_damaged), (1, 1, false));
        assert_eq!(stored.settings, Settings { host_timeout_ms: 100, ..Settings::default() });
        assert!(decode(&bytes[..bytes.len() - 1]).is_damaged);
    }
}
