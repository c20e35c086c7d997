//! The trace: everything that a tick takes in, so that another computer can do the tick again, and a check of what came out.
//!
//! Terms. A **record** is one tick. Records stand behind each other in a stream of bytes, which goes to the host in [`TracePiece`]s; their
//! offsets show what was lost on the way. What the host itself sent is not sent back: a record names the request's token.
//!
//! A tick without a command takes 9 bytes, with the frames around the pieces about 10 of the 92 that the line carries in a millisecond.
//!
//! # Example
//! ```
//! use model_export::link::trace::{Encoded, MAX_PIECE_BYTES, MAX_RECORD_BYTES, NoRecord, TraceCommand, TraceExtra, TraceFlags, TracePiece, TraceRecord};
//!
//! let mut flags = TraceFlags::FIRST;
//! flags.insert_if(true, TraceFlags::MODEL);
//! let extra = TraceExtra { lost_ticks: 0, command: TraceCommand::Request(2) };
//! let record = TraceRecord { flags, laser_code: 2048, pressure_code: 1024, extra: Some(extra), check: 0x1234 };
//!
//! let mut place = [0; MAX_RECORD_BYTES];
//! let Encoded { length, overflowed } = record.encode(MAX_PIECE_BYTES, &mut place);
//! assert!(!overflowed);
//! let piece = TracePiece { offset: 0, bytes: place[..length].iter().copied().collect() };
//! assert_eq!(TraceRecord::take(&piece.bytes), Ok(Some((record, &[][..]))));
//! assert_eq!(TraceRecord::take(&piece.bytes[..1]), Ok(None), "the rest comes with the next piece");
//! assert_eq!(TraceRecord::take(&[0xff; MAX_RECORD_BYTES]), Err(NoRecord));
//!
//! let end = TraceRecord::end(true);
//! assert!(end.flags.contains(TraceFlags::END) && end.flags.contains(TraceFlags::OVERFLOW));
//! ```

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::fault::FaultSet;
use super::kind::Kind;
use super::message::Message;

/// Most bytes of a piece.
pub const MAX_PIECE_BYTES: usize = 256;
/// Most bytes of a record; a test holds it.
pub const MAX_RECORD_BYTES: usize = 30;

/// A piece of the stream of records.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TracePiece {
    /// Bytes of the stream before this piece, since the device started; wraps.
    pub offset: u32,
    /// The piece; a record may begin in one and end in the next.
    pub bytes: Vec<u8, MAX_PIECE_BYTES>,
}

/// What is either so or not in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TraceFlags(pub u8);

impl TraceFlags {
    /// The emergency stop was pressed.
    pub const EMERGENCY_STOP: Self = Self(1);
    /// The tick before took too long.
    pub const OVERRAN: Self = Self(1 << 1);
    /// The background had shown life since the tick before.
    pub const BEAT: Self = Self(1 << 2);
    /// A vent was asked for past the queue of commands.
    pub const VENT: Self = Self(1 << 3);
    /// There was a model to run.
    pub const MODEL: Self = Self(1 << 4);
    /// The trace begins with this record.
    pub const FIRST: Self = Self(1 << 5);
    /// The trace ended; the record is no tick.
    pub const END: Self = Self(1 << 6);
    /// It ended because the line was too slow for it.
    pub const OVERFLOW: Self = Self(1 << 7);

    /// Whether all of `other` are set.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Sets `other` if `condition`.
    pub const fn insert_if(&mut self, condition: bool, other: Self) {
        if condition {
            self.0 |= other.0;
        }
    }
}

/// A command that the tick took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TraceCommand {
    /// None.
    #[default]
    None,
    /// That of the host's request with this token.
    Request(u32),
    /// Another self-test, asked for by the background.
    Retest,
    /// What the self-test found.
    SelfTestReport {
        /// What is wrong.
        faults: FaultSet,
        /// Ticks from one model step to the next; zero without a model.
        model_period: u16,
    },
    /// A fault with this number that the background found.
    Raise(u8),
}

/// What most ticks do not have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TraceExtra {
    /// Ticks that were lost before this one.
    pub lost_ticks: u16,
    /// The command it took.
    pub command: TraceCommand,
}

/// A tick: what went in, and a check of what came out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TraceRecord {
    /// Yes or no.
    pub flags: TraceFlags,
    /// Code of the laser.
    pub laser_code: u16,
    /// Code of the pressure sensor.
    pub pressure_code: u16,
    /// What most ticks do not have.
    pub extra: Option<TraceExtra>,
    /// Low half of the CRC-32 over the outputs of every tick of the trace so far.
    pub check: u16,
}

impl TraceRecord {
    /// What stands behind the last tick of a trace.
    #[must_use]
    pub const fn end(overflowed: bool) -> Self {
        let mut flags = TraceFlags::END;
        flags.insert_if(overflowed, TraceFlags::OVERFLOW);
        Self { flags, laser_code: 0, pressure_code: 0, extra: None, check: 0 }
    }

    /// Writes the record to the front of `place`, of which `room` bytes will find room on the way to the host; gives the length. Where not even
    /// another record would fit behind it, it writes instead that the trace ends here, which always fits.
    pub fn encode(&self, room: usize, place: &mut [u8; MAX_RECORD_BYTES]) -> Encoded {
        let overflowed = room < 2 * MAX_RECORD_BYTES && !self.flags.contains(TraceFlags::END);
        let end = Self::end(true);
        // Every record fits its place; a test holds that.
        let length = postcard::to_slice(if overflowed { &end } else { self }, place).map_or(0, |bytes| bytes.len());
        Encoded { length, overflowed }
    }

    /// Takes a record off the front of `bytes`; gives it with what is left, `None` if it is not whole.
    ///
    /// # Errors
    /// [`NoRecord`] when the bytes are none, however many follow.
    pub fn take(bytes: &[u8]) -> Result<Option<(Self, &[u8])>, NoRecord> {
        match postcard::take_from_bytes(bytes) {
            Ok(taken) => Ok(Some(taken)),
            Err(_) if bytes.len() < MAX_RECORD_BYTES => Ok(None),
            Err(_) => Err(NoRecord),
        }
    }
}

/// Bytes that are no record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoRecord;

/// What became of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Encoded {
    /// Bytes to send.
    pub length: usize,
    /// They are not the record but the end of the trace.
    pub overflowed: bool,
}

impl Message for TracePiece {
    const KIND: Kind = Kind::Trace;
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn record() -> impl Strategy<Value = TraceRecord> {
        let command = prop_oneof![
            Just(TraceCommand::None),
            any::<u32>().prop_map(TraceCommand::Request),
            Just(TraceCommand::Retest),
            (any::<u64>(), any::<u16>())
                .prop_map(|(faults, model_period)| TraceCommand::SelfTestReport { faults: FaultSet(faults), model_period }),
            any::<u8>().prop_map(TraceCommand::Raise),
        ];
        let extra = prop::option::of((any::<u16>(), command).prop_map(|(lost_ticks, command)| TraceExtra { lost_ticks, command }));
        (any::<u8>(), any::<u16>(), any::<u16>(), extra, any::<u16>()).prop_map(|(flags, laser_code, pressure_code, extra, check)| {
            TraceRecord { flags: TraceFlags(flags), laser_code, pressure_code, extra, check }
        })
    }

    #[test]
    fn the_longest_record_has_the_length_that_is_reserved_and_a_common_one_nine_bytes() {
        let command = TraceCommand::SelfTestReport { faults: FaultSet(u64::MAX), model_period: u16::MAX };
        let longest = TraceRecord {
            flags: TraceFlags(u8::MAX),
            laser_code: u16::MAX,
            pressure_code: u16::MAX,
            extra: Some(TraceExtra { lost_ticks: u16::MAX, command }),
            check: u16::MAX,
        };
        let mut place = [0; MAX_RECORD_BYTES];
        assert_eq!(postcard::to_slice(&longest, &mut place).unwrap().len(), 28);
        let common = TraceRecord { flags: TraceFlags(0x14), laser_code: 3000, pressure_code: 8190, extra: None, check: u16::MAX };
        assert_eq!(common.encode(64, &mut place), Encoded { length: 9, overflowed: false });
    }

    #[test]
    fn where_there_is_no_room_for_two_the_trace_ends() {
        let mut place = [0; MAX_RECORD_BYTES];
        let record = TraceRecord { laser_code: 7, ..TraceRecord::default() };
        let Encoded { length, overflowed } = record.encode(2 * MAX_RECORD_BYTES - 1, &mut place);
        assert!(overflowed);
        let (end, rest) = TraceRecord::take(&place[..length]).unwrap().unwrap();
        assert!(end.flags.contains(TraceFlags::END) && end.flags.contains(TraceFlags::OVERFLOW) && rest.is_empty());
    }

    proptest! {
        #[test]
        fn records_come_out_of_the_stream_as_they_went_in(records in prop::collection::vec(record(), 1..20)) {
            let mut stream = Vec::<u8, 1024>::new();
            for record in &records {
                let mut place = [0; MAX_RECORD_BYTES];
                let Encoded { length, overflowed } = record.encode(1024, &mut place);
                prop_assert!(!overflowed);
                stream.extend_from_slice(&place[..length]).unwrap();
            }
            let mut rest = stream.as_slice();
            for record in &records {
                for cut in 0..rest.len().min(6) {
                    prop_assert_eq!(TraceRecord::take(&rest[..cut]), Ok(None));
                }
                let (taken, left) = TraceRecord::take(rest).unwrap().unwrap();
                prop_assert_eq!(taken, *record);
                rest = left;
            }
            prop_assert!(rest.is_empty());
        }

        #[test]
        fn no_bytes_break_the_reading_of_records(bytes in prop::collection::vec(any::<u8>(), 0..100)) {
            let mut rest = bytes.as_slice();
            while let Ok(Some((_, left))) = TraceRecord::take(rest) {
                prop_assert!(left.len() < rest.len());
                rest = left;
            }
        }
    }
}
