//! Which chip this is.

use model_export::link::hello::Build;

use crate::board::chip::facts::{IDCODE, UNIQUE_NUMBER};

/// What the chip says of itself; nothing unless it is one, since an emulator may have nothing at these addresses.
pub fn read(is_chip: bool) -> Build {
    if !is_chip {
        return Build::default();
    }
    let mut chip_number = [0; 12];
    for (place, four) in (UNIQUE_NUMBER..).step_by(4).zip(chip_number.as_chunks_mut::<4>().0) {
        *four = word(place).to_le_bytes();
    }
    Build { chip: word(IDCODE), chip_number, ..Build::default() }
}

fn word(address: usize) -> u32 {
    // SAFETY: one of the two places above, readable for ever.
    unsafe { core::ptr::with_exposed_provenance::<u32>(address).read_volatile() }
}
