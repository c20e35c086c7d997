//! The last two seconds before a fault, in memory that a reset does not clear.
//!
//! Every tick leaves a **row** in a ring of [`ROWS`]. The first fault **holds** the ring: the row of the fault is the last one. A ring that is
//! found at a start belongs to the run before and is held as well. It is held until the dump valve closes for the next time, so that it can be
//! fetched at leisure; what comes before that is without pressure.
//!
//! The memory keeps words. A row is three of them and carries its own check, so that a run which ended in the middle of a write loses that row
//! and no other. What does not carry the ring's name is what RAM holds after power-up, and is no ring.

use model_export::link::history::{HistoryRow, ROW_BYTES};

use crate::number::round_to_i32;

/// Rows of the ring: two seconds.
pub const ROWS: usize = 2000;
const ROW_WORDS: usize = ROW_BYTES / 4;
const HEADER_WORDS: usize = 3;
/// Words that the memory has.
pub const WORDS: usize = HEADER_WORDS + ROWS * ROW_WORDS;

const NAME: usize = 0;
/// Rows since the ring was emptied, capped at twice its length; the last ones are there.
const COUNT: usize = 1;
const PHASE: usize = 2;

const RING: u32 = u32::from_be_bytes(*b"HIS1");
const RECORDING: u32 = 0x5ec0_4d1e;
const HELD: u32 = 0xfa17_ed00;

/// Words that survive a reset, to read.
pub trait HistoryWords {
    /// A word; anything beyond [`WORDS`].
    fn read(&self, word: usize) -> u32;
}

/// Words that survive a reset.
pub trait HistoryMemory: HistoryWords {
    /// Writes a word; nothing beyond [`WORDS`].
    fn write(&mut self, word: usize, value: u32);
}

/// Words of a device that lives in RAM as a whole.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RamHistory(pub [u32; WORDS]);

impl Default for RamHistory {
    fn default() -> Self {
        Self([0; WORDS])
    }
}

impl HistoryWords for RamHistory {
    fn read(&self, word: usize) -> u32 {
        self.0.get(word).copied().unwrap_or(0)
    }
}

impl HistoryMemory for RamHistory {
    fn write(&mut self, word: usize, value: u32) {
        if let Some(place) = self.0.get_mut(word) {
            *place = value;
        }
    }
}

/// The tick's side of a ring.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct History {
    was_energised: bool,
    /// Rows so far and the phase, read once at the start: nobody else writes the ring.
    count: u32,
    is_held: bool,
    is_started: bool,
}

impl History {
    /// A ring that has not been looked at.
    pub const fn new() -> Self {
        Self { was_energised: false, count: 0, is_held: false, is_started: false }
    }

    /// Takes a tick's row. `energised` is whether the dump valve is closed, `fault` whether one is latched.
    ///
    /// # Deadline
    /// Seven words of memory at most, no loops.
    pub fn step(&mut self, memory: &mut impl HistoryMemory, row: HistoryRow, energised: bool, fault: bool) {
        if !self.is_started {
            self.is_started = true;
            self.is_held = rows(memory) > 0;
            self.count = memory.read(COUNT);
            memory.write(PHASE, if self.is_held { HELD } else { RECORDING });
        }
        let closes = energised && !self.was_energised;
        self.was_energised = energised;
        if closes || rows_of(memory.read(NAME), self.count).is_none() {
            (self.count, self.is_held) = (0, false);
            memory.write(COUNT, 0);
            memory.write(NAME, RING);
            memory.write(PHASE, RECORDING);
        }
        if self.is_held {
            return;
        }
        let place = usize::try_from(self.count).unwrap_or(0) % ROWS;
        let first = HEADER_WORDS + place * ROW_WORDS;
        let [a, b, c] = words(row.encode());
        memory.write(first, a);
        memory.write(first + 1, b);
        memory.write(first + 2, c);
        self.count += 1;
        if self.count >= 2 * CAPACITY {
            self.count -= CAPACITY;
        }
        memory.write(COUNT, self.count);
        if fault {
            self.is_held = true;
            memory.write(PHASE, HELD);
        }
    }
}

const CAPACITY: u32 = 2000;
const _: () = assert!(ROWS == 2000 && ROW_WORDS == 3, "the two constants of the ring's length");

fn words(bytes: [u8; ROW_BYTES]) -> [u32; ROW_WORDS] {
    let [a, b, c, d, e, f, g, h, i, j, k, l] = bytes;
    [u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]), u32::from_le_bytes([i, j, k, l])]
}

/// Rows that a ring with this name and count holds; `None` if it is no ring.
fn rows_of(name: u32, count: u32) -> Option<u16> {
    (name == RING && count < 2 * CAPACITY).then(|| u16::try_from(count.min(CAPACITY)).unwrap_or(0))
}

/// Rows there are.
pub fn rows(memory: &impl HistoryWords) -> u16 {
    rows_of(memory.read(NAME), memory.read(COUNT)).unwrap_or(0)
}

/// Whether they stand still, so that they can be fetched.
pub fn is_held(memory: &impl HistoryWords) -> bool {
    rows(memory) > 0 && memory.read(PHASE) == HELD
}

/// The bytes of a row, the oldest first.
pub fn row(memory: &impl HistoryWords, index: u16) -> [u8; ROW_BYTES] {
    let count = memory.read(COUNT);
    let oldest = if count > CAPACITY { count % CAPACITY } else { 0 };
    let place = usize::try_from((oldest + u32::from(index)) % CAPACITY).unwrap_or(0);
    let first = HEADER_WORDS + place * ROW_WORDS;
    let mut bytes = [0; ROW_BYTES];
    for (word, four) in (first..).zip(bytes.as_chunks_mut::<4>().0) {
        *four = memory.read(word).to_le_bytes();
    }
    bytes
}

/// A value in thousandths, saturated; the lowest number stands for none.
pub fn thousandths(value: Option<f32>) -> i16 {
    let scaled = value.and_then(|value| round_to_i32(value * 1000.0));
    scaled.map_or(i16::MIN, |scaled| i16::try_from(scaled.clamp(-32_767, 32_767)).unwrap_or(i16::MIN))
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use model_export::link::state::State;

    use super::*;

    fn numbered(number: u16) -> HistoryRow {
        HistoryRow { laser_code: number, state: State::Running, ..HistoryRow::default() }
    }

    fn read(memory: &RamHistory) -> Vec<Option<u16>> {
        (0..rows(memory)).map(|index| HistoryRow::decode(&row(memory, index)).map(|row| row.laser_code)).collect()
    }

    #[test]
    fn the_ring_holds_the_last_two_seconds_before_the_fault_and_its_own_row() {
        for ticks in [1, 5, 1999, 2000, 2001, 3999, 4000, 4001, 9000] {
            let (mut history, mut memory) = (History::new(), RamHistory::default());
            for tick in 0..ticks {
                history.step(&mut memory, numbered(tick), true, false);
                assert!(!is_held(&memory));
            }
            history.step(&mut memory, numbered(ticks), false, true);
            assert!(is_held(&memory));
            for tick in 0..100 {
                history.step(&mut memory, numbered(60_000 + tick), false, true);
            }
            let expected: Vec<_> = (ticks.saturating_sub(1999)..=ticks).map(Some).collect();
            assert_eq!(read(&memory), expected, "{ticks} ticks");
        }
    }

    #[test]
    fn a_ring_found_at_the_start_is_held_until_the_dump_valve_closes() {
        let (mut history, mut memory) = (History::new(), RamHistory::default());
        (0..3000).for_each(|tick| history.step(&mut memory, numbered(tick), true, false));
        // A reset in the middle of the run: nothing held it.
        let mut history = History::new();
        (0..500).for_each(|tick| history.step(&mut memory, numbered(7000 + tick), false, tick > 200));
        assert!(is_held(&memory));
        assert_eq!(read(&memory), (1000..3000).map(Some).collect::<Vec<_>>());
        history.step(&mut memory, numbered(1), true, false);
        history.step(&mut memory, numbered(2), true, false);
        assert!(!is_held(&memory));
        assert_eq!(read(&memory), [Some(1), Some(2)]);
    }

    #[test]
    fn ram_after_power_up_is_no_ring_and_a_torn_row_is_lost_alone() {
        for noise in [0, u32::MAX, 0xa5a5_a5a5] {
            let mut memory = RamHistory([noise; WORDS]);
            assert_eq!(rows(&memory), 0);
            let mut history = History::new();
            history.step(&mut memory, numbered(9), false, false);
            assert_eq!((rows(&memory), is_held(&memory)), (1, false));
        }
        let (mut history, mut memory) = (History::new(), RamHistory::default());
        (0..10).for_each(|tick| history.step(&mut memory, numbered(tick), true, false));
        for bit in 0..32 * ROW_WORDS {
            let mut torn = memory.clone();
            torn.0[HEADER_WORDS + 4 * ROW_WORDS + bit / 32] ^= 1 << (bit % 32);
            assert_eq!(read(&torn)[4], None, "bit {bit}");
            assert_eq!(read(&torn)[5], Some(5));
        }
    }

    #[test]
    fn thousandths_saturate_and_tell_what_is_missing() {
        assert_eq!(
            [Some(1.2345), Some(-40.0), Some(1e9), None, Some(f32::NAN)].map(thousandths),
            [1235, -32_767, 32_767, i16::MIN, i16::MIN]
        );
    }
}
