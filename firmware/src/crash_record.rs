//! The record that survives a reset: a few bytes of RAM that start-up code does not clear.
//!
//! The board copies the sealed record there whenever the tick says that it changed; a panic or hard-fault handler adds what struck. At the
//! next start the board opens it: what does not carry the right checksum is what RAM holds after power-up, and is no record.

use model_export::blob::crc32;
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::message::FaultRecord;

/// Bytes of a sealed record.
pub const SEALED_BYTES: usize = 96;
const MAGIC: [u8; 4] = *b"RETN";
const BODY_BYTES: usize = SEALED_BYTES - MAGIC.len() - 4;

/// What survives a reset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CrashRecord {
    /// The fault record of the run before.
    pub record: FaultRecord,
    /// What crashed it: [`Fault::Panicked`] or [`Fault::HardFault`].
    pub crash: Option<Fault>,
}

impl CrashRecord {
    /// As bytes for the RAM that is kept.
    pub fn encode(&self) -> [u8; SEALED_BYTES] {
        let mut body = [0; BODY_BYTES];
        // The longest record takes fewer bytes than the body has; a test holds that.
        let _ = postcard::to_slice(&(self.crash.map_or(0, Fault::number), &self.record), &mut body);
        let checksum = crc32(0, &body).to_le_bytes();
        let mut sealed = [0; SEALED_BYTES];
        let parts = MAGIC.iter().chain(&body).chain(&checksum);
        sealed.iter_mut().zip(parts).for_each(|(byte, part)| *byte = *part);
        sealed
    }

    /// From bytes found in RAM; `None` if they are no record.
    pub fn open(sealed: &[u8; SEALED_BYTES]) -> Option<Self> {
        let (magic, rest) = sealed.split_first_chunk::<4>()?;
        let (body, checksum) = rest.split_last_chunk::<4>()?;
        if *magic != MAGIC || crc32(0, body) != u32::from_le_bytes(*checksum) {
            return None;
        }
        let ((crash, record), _) = postcard::take_from_bytes::<(u8, FaultRecord)>(body).ok()?;
        Some(Self { record, crash: Fault::from_number(crash) })
    }

    /// What to raise at the start because of it.
    pub fn faults(&self) -> FaultSet {
        self.crash.into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::link::state::State;

    fn crash_record() -> CrashRecord {
        let record = FaultRecord {
            first: u8::MAX,
            second: u8::MAX,
            all: FaultSet(u64::MAX),
            time_ms: u64::MAX,
            state: State::Fault,
            output_ubar: i32::MIN,
            pressure_code: u16::MAX,
            laser_code: u16::MAX,
            pressure_bar: 1.0,
            displacement_mm: 2.0,
            estimate_mm: 3.0,
            set_point: 4.0,
            late_ticks: u32::MAX,
        };
        CrashRecord { record, crash: Some(Fault::Panicked) }
    }

    #[test]
    fn the_longest_record_survives() {
        assert_eq!(CrashRecord::open(&crash_record().encode()), Some(crash_record()));
        assert_eq!(crash_record().faults().first(), Some(Fault::Panicked));
    }

    #[test]
    fn ram_after_power_up_is_no_record_and_neither_is_one_with_any_bit_flipped() {
        assert_eq!(CrashRecord::open(&[0; SEALED_BYTES]), None);
        assert_eq!(CrashRecord::open(&[0xff; SEALED_BYTES]), None);
        let sealed = crash_record().encode();
        for bit in 0..SEALED_BYTES * 8 {
            let mut flipped = sealed;
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(CrashRecord::open(&flipped), None, "bit {bit}");
        }
    }
}
