//! Power cuts at every word of a save, of a model upload and of an activation, with every way a word or an erase can stay half done.

use firmware::settings;
use firmware::storage::{Flash, Slot, StorageError, Store};
use model_export::blob::crc32;
use model_export::link::settings::Settings;

const SLOT_BYTES: usize = 4096;

/// What the cut leaves of the operation it hits.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cut {
    /// Nothing of it happened.
    Before,
    /// It happened, but nothing after it.
    After,
    /// Some bits moved: a program cleared only those under the mask, an erase set only those.
    Partly(u32),
    /// An erase came as far as half of the slot.
    HalfErased,
}

const CUTS: [Cut; 10] = [
    Cut::Before,
    Cut::After,
    Cut::HalfErased,
    Cut::Partly(0x0000_ffff),
    Cut::Partly(0xffff_0000),
    Cut::Partly(0x5555_5555),
    Cut::Partly(0x0000_0001),
    Cut::Partly(0x8421_1248),
    Cut::Partly(0x0000_0100),
    Cut::Partly(0x7fff_ffff),
];

/// Flash in memory that loses its power at the given operation.
#[derive(Clone, Debug)]
struct MemoryFlash {
    slots: [Vec<u8>; 2],
    operations: u32,
    cut: Option<(u32, Cut)>,
    dead: bool,
}

#[derive(Debug)]
struct NoPower;

impl MemoryFlash {
    fn new() -> Self {
        // What a new chip holds is not defined; ones are the kindest, and the tests of garbage are below.
        Self { slots: [vec![0xff; SLOT_BYTES], vec![0xff; SLOT_BYTES]], operations: 0, cut: None, dead: false }
    }

    fn slot(&mut self, slot: Slot) -> &mut Vec<u8> {
        &mut self.slots[usize::from(slot == Slot::B)]
    }

    /// What happens to the next operation: `None` that it happens whole.
    fn power(&mut self) -> Result<Option<Cut>, NoPower> {
        if self.dead {
            return Err(NoPower);
        }
        self.operations += 1;
        match self.cut {
            Some((operation, cut)) if operation == self.operations => {
                self.dead = true;
                Ok(Some(cut))
            }
            _ => Ok(None),
        }
    }

    fn after_power_up(mut self) -> Self {
        self.cut = None;
        self.dead = false;
        self.operations = 0;
        self
    }
}

impl Flash for MemoryFlash {
    type Error = NoPower;

    fn contents(&self, slot: Slot) -> &[u8] {
        &self.slots[usize::from(slot == Slot::B)]
    }

    fn erase(&mut self, slot: Slot) -> Result<(), NoPower> {
        let cut = self.power()?;
        for (at, byte) in self.slot(slot).iter_mut().enumerate() {
            *byte |= match cut {
                None | Some(Cut::After) => 0xff,
                Some(Cut::Before) => 0,
                Some(Cut::HalfErased) => 0xff * u8::from(at < SLOT_BYTES / 2),
                Some(Cut::Partly(mask)) => mask.to_le_bytes()[at % 4],
            };
        }
        if cut.is_some() { Err(NoPower) } else { Ok(()) }
    }

    fn program(&mut self, slot: Slot, offset: u32, word: u32) -> Result<(), NoPower> {
        let cut = self.power()?;
        assert!(offset.is_multiple_of(4));
        let mask = match cut {
            None | Some(Cut::After) => u32::MAX,
            Some(Cut::Before | Cut::HalfErased) => 0,
            Some(Cut::Partly(mask)) => mask,
        };
        let at = offset as usize;
        let bytes = &mut self.slot(slot)[at..at + 4];
        let before = u32::from_le_bytes(bytes.try_into().unwrap());
        assert_eq!(before, u32::MAX, "a word is programmed once between erases");
        bytes.copy_from_slice(&(before & (word | !mask)).to_le_bytes());
        if cut.is_some() { Err(NoPower) } else { Ok(()) }
    }
}

fn store(flash: MemoryFlash) -> Store<MemoryFlash> {
    Store::new(flash, 7, 1)
}

fn thing(seed: u8, length: usize) -> Vec<u8> {
    (0..length).map(|at| seed.wrapping_mul(31).wrapping_add((at * 7) as u8)).collect()
}

/// Cuts `change` at every one of its operations in every way. Afterwards the store holds the old or the new thing, whole, and works.
fn cut_everywhere(
    before: &MemoryFlash,
    old: Option<&[u8]>,
    new: &[u8],
    change: impl Fn(&mut Store<MemoryFlash>) -> Result<(), StorageError>,
) {
    let mut whole = store(before.clone().after_power_up());
    change(&mut whole).unwrap();
    assert_eq!(whole.active_payload(), Some(new));
    let operations = whole.release().operations;
    let (mut saw_old, mut saw_new) = (false, false);
    for operation in 1..=operations {
        for cut in CUTS {
            let mut flash = before.clone().after_power_up();
            flash.cut = Some((operation, cut));
            let mut cut_store = store(flash);
            assert_eq!(change(&mut cut_store), Err(StorageError::Flash), "the cut is noticed");

            let mut booted = store(cut_store.release().after_power_up());
            let found = booted.active_payload().map(<[u8]>::to_vec);
            let what = format!("operation {operation} of {operations}, {cut:?}");
            assert!(found.as_deref() == old || found.as_deref() == Some(new), "{what}: neither old nor new");
            assert!(!booted.select().is_damaged, "{what}: a cut is no damage");
            saw_old |= found.as_deref() == old;
            saw_new |= found.as_deref() == Some(new);

            // The next change works, whatever the cut left behind.
            let next = thing(99, 301);
            booted.save(&next).unwrap_or_else(|error| panic!("{what}: {error:?}"));
            assert_eq!(booted.active_payload(), Some(next.as_slice()), "{what}");
        }
    }
    assert!(saw_old && saw_new, "the cuts fall before and after the change takes effect");
}

#[test]
fn a_power_cut_at_any_word_of_a_settings_save_leaves_the_old_or_the_new_ones() {
    let old = settings::encode(&Settings::default()).unwrap();
    let new = settings::encode(&Settings { ceiling_bar: 2.0, host_timeout_ms: 100, ..Settings::default() }).unwrap();
    // The first save ever, one after it, and one that comes back to the first slot.
    let mut flash = MemoryFlash::new();
    cut_everywhere(&flash, None, &old, |store| store.save(&old));
    for _ in 0..2 {
        let mut saved = store(flash);
        saved.save(&old).unwrap();
        flash = saved.release();
        cut_everywhere(&flash, Some(&old), &new, |store| store.save(&new));
    }
}

#[test]
fn a_power_cut_at_any_word_of_a_model_upload_leaves_the_old_or_the_new_one() {
    let (old, new) = (thing(1, 1_000), thing(2, 1_203));
    let mut first = store(MemoryFlash::new());
    first.save(&old).unwrap();
    let upload = |store: &mut Store<MemoryFlash>| {
        let mut upload = store.begin(new.len() as u32, crc32(0, &new))?;
        for (index, piece) in new.chunks(256).enumerate() {
            store.write(&mut upload, (index * 256) as u32, piece)?;
        }
        let slot = store.finish(upload)?;
        store.activate(slot)
    };
    cut_everywhere(first.flash(), Some(&old), &new, upload);
}

#[test]
fn a_power_cut_in_a_roll_back_leaves_one_or_the_other() {
    let (old, new) = (thing(1, 1_000), thing(2, 1_200));
    let mut both = store(MemoryFlash::new());
    both.save(&old).unwrap();
    both.save(&new).unwrap();
    cut_everywhere(both.flash(), Some(&new), &old, |store| {
        let slot = store.inactive_whole().expect("the old one is still there");
        store.activate(slot)
    });
}

#[test]
fn an_upload_is_not_active_before_it_is_activated_and_can_be_rolled_back_many_times() {
    let (old, new) = (thing(1, 64), thing(2, 61));
    let mut store = store(MemoryFlash::new());
    store.save(&old).unwrap();
    let mut upload = store.begin(61, crc32(0, &new)).unwrap();
    assert_eq!(store.write(&mut upload, 4, &new), Err(StorageError::Offset(0)));
    assert_eq!(store.write(&mut upload, 0, &new[..30]), Err(StorageError::PieceLength));
    store.write(&mut upload, 0, &new[..32]).unwrap();
    assert_eq!(store.write(&mut upload, 32, &[0; 40]), Err(StorageError::PieceLength));
    store.write(&mut upload, 32, &new[32..]).unwrap();
    store.finish(upload).unwrap();
    assert_eq!(store.active_payload(), Some(old.as_slice()));
    for round in 0..100 {
        let slot = store.inactive_whole().unwrap();
        store.activate(slot).unwrap();
        let expected = if round % 2 == 0 { &new } else { &old };
        assert_eq!(store.active_payload(), Some(expected.as_slice()), "round {round}");
    }
    let full = (0..40).find_map(|_| {
        let slot = store.inactive_whole().unwrap();
        store.activate(slot).err()
    });
    assert_eq!(full, Some(StorageError::LogFull), "the log says that it is full instead of losing the order");
}

#[test]
fn a_damaged_active_slot_falls_back_to_the_other_and_says_so() {
    let (old, new) = (thing(1, 1_000), thing(2, 1_000));
    let mut both = store(MemoryFlash::new());
    both.save(&old).unwrap();
    both.save(&new).unwrap();
    for bit in (0..1_000 * 8).step_by(61) {
        let mut flash = both.flash().clone();
        flash.slots[1][1024 + bit / 8] ^= 1 << (bit % 8);
        let damaged = store(flash);
        assert_eq!(damaged.active_payload(), Some(old.as_slice()));
        assert!(damaged.select().is_damaged);
    }
}

/// Settings as they are told apart in these tests.
fn saved_with(ceiling_bar: f32) -> Settings {
    Settings { ceiling_bar, ..Settings::default() }
}

fn encoded(ceiling_bar: f32) -> Vec<u8> {
    settings::encode(&saved_with(ceiling_bar)).unwrap().to_vec()
}

fn settings_store(flash: MemoryFlash) -> Store<MemoryFlash> {
    Store::new(flash, settings::STORE_KIND, settings::STORE_VERSION)
}

/// Flips every bit of both slots, one at a time: what is loaded is a fault, or one of the allowed ceilings. The number of faults.
fn flip_every_bit(flash: &MemoryFlash, allowed: &[f32], what: &str) -> u32 {
    let longest = 1024 + settings::MAX_BYTES;
    let mut detected = 0;
    let mut flash = flash.clone();
    for slot in 0..2 {
        for bit in 0..longest * 8 {
            flash.slots[slot][bit / 8] ^= 1 << (bit % 8);
            let store = settings_store(flash);
            let stored = settings::load(&store);
            detected += u32::from(stored.is_damaged);
            let is_allowed = allowed.contains(&stored.settings.ceiling_bar);
            assert!(
                stored.is_damaged || is_allowed,
                "{what}, slot {slot}, word {} bit {}: {}",
                bit / 32,
                bit % 32,
                stored.settings.ceiling_bar
            );
            flash = store.release();
            flash.slots[slot][bit / 8] ^= 1 << (bit % 8);
        }
    }
    detected
}

#[test]
fn every_flipped_bit_of_saved_settings_is_harmless_or_a_fault() {
    let lowest = 0.8;
    let mut flash = MemoryFlash::new();
    for slot in &mut flash.slots {
        slot.truncate(2048);
    }
    assert_eq!(flip_every_bit(&flash, &[Settings::DEFAULT.ceiling_bar], "a new chip"), 0, "a new chip has no settings, which is no fault");
    let mut before = Settings::DEFAULT.ceiling_bar;
    // The first save, one after a stricter one, one after a laxer one, and back.
    for (round, ceiling_bar) in [lowest, 2.0, lowest, 2.5, lowest].into_iter().enumerate() {
        let save = |flash: MemoryFlash| {
            let mut store = settings_store(flash);
            let saved = store.save(&encoded(ceiling_bar));
            (saved, store.release())
        };
        let (saved, after) = save(flash.clone().after_power_up());
        saved.unwrap();
        let detected = flip_every_bit(&after, &[ceiling_bar], &format!("save {round}"));
        // All of the payload and of the header's five words; in an activation it is corrected, elsewhere it changes nothing.
        assert_eq!(detected, 8 * encoded(ceiling_bar).len() as u32 + 160, "save {round}");
        // A save that is cut short where old becomes new: either is what the operator chose, and nothing else.
        for operation in (after.operations - 4..=after.operations).filter(|_| round < 3) {
            for cut in [Cut::Before, Cut::Partly(0x7fff_ffff)] {
                let mut interrupted = flash.clone().after_power_up();
                interrupted.cut = Some((operation, cut));
                let (_, interrupted) = save(interrupted);
                flip_every_bit(&interrupted, &[before, ceiling_bar], &format!("save {round}, operation {operation}, {cut:?}"));
            }
        }
        (flash, before) = (after, ceiling_bar);
    }
}

#[test]
fn settings_of_another_layout_version_are_a_fault() {
    let mut other = Store::new(MemoryFlash::new(), settings::STORE_KIND, settings::STORE_VERSION + 1);
    other.save(&encoded(0.8)).unwrap();
    assert!(settings::load(&settings_store(other.release())).is_damaged);
}

#[test]
fn a_slot_that_is_lost_whole_does_not_bring_the_settings_before_it_back_unsaid() {
    let mut both = settings_store(MemoryFlash::new());
    both.save(&encoded(3.0)).unwrap();
    both.save(&encoded(0.8)).unwrap();
    let mut flash = both.release();
    flash.slots[1].fill(0xff);
    let stored = settings::load(&settings_store(flash.clone()));
    assert!(stored.is_damaged, "{} bar", stored.settings.ceiling_bar);
    // Saving again mends it.
    let mut mended = settings_store(flash.after_power_up());
    mended.save(&encoded(0.8)).unwrap();
    assert_eq!(settings::load(&mended), settings::Stored { settings: saved_with(0.8), ..settings::Stored::default() });
}

#[test]
fn garbage_and_things_of_another_kind_are_not_seen() {
    let mut flash = MemoryFlash::new();
    let mut noise = 1u32;
    for byte in flash.slots.iter_mut().flatten() {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *byte = noise.to_be_bytes()[0];
    }
    assert_eq!(store(flash).active_payload(), None);
    let mut other = Store::new(MemoryFlash::new(), 8, 1);
    other.save(&thing(1, 10)).unwrap();
    assert_eq!(store(other.release()).active_payload(), None);
}

#[test]
fn a_thing_that_is_too_long_or_arrives_damaged_leaves_the_active_one_alone() {
    let old = thing(1, 500);
    let mut store = store(MemoryFlash::new());
    store.save(&old).unwrap();
    assert_eq!(store.begin(3_073, 0), Err(StorageError::TooLong(3_072)));
    let mut upload = store.begin(8, 0x1234_5678).unwrap();
    store.write(&mut upload, 0, &[1; 8]).unwrap();
    assert_eq!(store.finish(upload), Err(StorageError::Checksum));
    let upload = store.begin(8, crc32(0, &[])).unwrap();
    assert_eq!(store.finish(upload), Err(StorageError::Checksum), "nothing was written");
    assert_eq!(store.active_payload(), Some(old.as_slice()));
}
