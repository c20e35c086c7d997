//! The last ticks before a fault: what every channel was, once a millisecond.
//!
//! ```text
//! offset  bytes  what
//!      0      2  laser code             2      2  pressure code
//!      4      2  drive of the valve, share of full scale out of 65535
//!      6      2  set-point, thousandths of its unit; -32768 for none
//!      8      2  estimate, thousandths of mm; -32768 for none
//!     10      1  state (bits 0 to 2), emergency stop (3), late (4), dump valve closed (5)
//!     11      1  CRC-8 of the bytes before (SMBus)
//! ```
//! Little-endian. The device keeps these bytes as they are and sends them as they are.
//!
//! # Example
//! ```
//! use model_export::link::history::{HistoryPiece, HistoryRow, MAX_PIECE_ROWS, ROW_BYTES};
//! use model_export::link::state::State;
//!
//! // Half of full scale at the valve, a set-point of 1.5 bar, an estimate of 7.25 mm.
//! let row = HistoryRow {
//!     valve_share: 32_768,
//!     set_point_thousandths: 1500,
//!     estimate_thousandths: 7250,
//!     state: State::Running,
//!     energised: true,
//!     ..HistoryRow::default()
//! };
//! let bytes: [u8; ROW_BYTES] = row.encode();
//! assert_eq!(HistoryRow::decode(&bytes), Some(row));
//! assert_eq!(HistoryRow::decode(&[0xff; ROW_BYTES]), None, "the check is wrong");
//!
//! let piece = HistoryPiece { rows: 2000, bytes: bytes.into_iter().collect() };
//! assert!(piece.bytes.len() <= MAX_PIECE_ROWS * ROW_BYTES);
//! ```

use crc::{CRC_8_SMBUS, Crc, NoTable};
use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::state::State;

/// Bytes of a row.
pub const ROW_BYTES: usize = 12;
/// Most rows of a piece.
pub const MAX_PIECE_ROWS: usize = 8;

const CHECK: Crc<u8, NoTable> = Crc::<u8, NoTable>::new(&CRC_8_SMBUS);

/// A tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HistoryRow {
    /// Code of the laser.
    pub laser_code: u16,
    /// Code of the pressure sensor.
    pub pressure_code: u16,
    /// What went to the valve, out of 65535.
    pub valve_share: u16,
    /// Set-point in force, thousandths of bar or mm; the lowest number for none.
    pub set_point_thousandths: i16,
    /// Estimate, thousandths of mm; the lowest number for none.
    pub estimate_thousandths: i16,
    /// State after the tick.
    pub state: State,
    /// Whether the emergency stop was pressed.
    pub emergency_stop: bool,
    /// Whether ticks were lost before it, or the one before took too long.
    pub late: bool,
    /// Whether the dump valve was closed after it.
    pub energised: bool,
}

impl HistoryRow {
    /// As bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; ROW_BYTES] {
        let state = State::ALL.iter().zip(0u8..).find(|(state, _)| **state == self.state).map_or(0, |(_, number)| number);
        let flags = state | (u8::from(self.emergency_stop) << 3) | (u8::from(self.late) << 4) | (u8::from(self.energised) << 5);
        let [a, b] = self.laser_code.to_le_bytes();
        let [c, d] = self.pressure_code.to_le_bytes();
        let [e, f] = self.valve_share.to_le_bytes();
        let [g, h] = self.set_point_thousandths.to_le_bytes();
        let [i, j] = self.estimate_thousandths.to_le_bytes();
        let check = CHECK.checksum(&[a, b, c, d, e, f, g, h, i, j, flags]);
        [a, b, c, d, e, f, g, h, i, j, flags, check]
    }

    /// From bytes; `None` if they are no row.
    #[must_use]
    pub fn decode(bytes: &[u8; ROW_BYTES]) -> Option<Self> {
        let [a, b, c, d, e, f, g, h, i, j, flags, check] = *bytes;
        if CHECK.checksum(bytes.first_chunk::<{ ROW_BYTES - 1 }>()?) != check {
            return None;
        }
        Some(Self {
            laser_code: u16::from_le_bytes([a, b]),
            pressure_code: u16::from_le_bytes([c, d]),
            valve_share: u16::from_le_bytes([e, f]),
            set_point_thousandths: i16::from_le_bytes([g, h]),
            estimate_thousandths: i16::from_le_bytes([i, j]),
            state: State::ALL.get(usize::from(flags & 7)).copied()?,
            emergency_stop: flags & 1 << 3 != 0,
            late: flags & 1 << 4 != 0,
            energised: flags & 1 << 5 != 0,
        })
    }
}

/// Rows in a row.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HistoryPiece {
    /// Rows there are; the last one is that of the fault.
    pub rows: u16,
    /// The bytes of those from the one that was asked for on, none beyond the last.
    pub bytes: Vec<u8, { MAX_PIECE_ROWS * ROW_BYTES }>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back_as_they_were_kept_and_with_no_bit_flipped() {
        for state in State::ALL {
            let row = HistoryRow {
                laser_code: 0x1234,
                pressure_code: u16::MAX,
                valve_share: 0x8001,
                set_point_thousandths: -1500,
                estimate_thousandths: i16::MIN,
                state,
                emergency_stop: state == State::Fault,
                late: state == State::Idle,
                energised: state.is_energised(),
            };
            let bytes = row.encode();
            assert_eq!(HistoryRow::decode(&bytes), Some(row));
            for bit in 0..8 * ROW_BYTES {
                let mut flipped = bytes;
                flipped[bit / 8] ^= 1 << (bit % 8);
                assert_eq!(HistoryRow::decode(&flipped), None, "bit {bit}");
            }
        }
        assert_eq!(HistoryRow::decode(&[0; ROW_BYTES]).map(|row| row.state), Some(State::Boot));
    }
}
