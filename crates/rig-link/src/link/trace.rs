//! The host's side of a trace: pieces put together again, and each record with the request that it names.
//!
//! What the host sent is kept until a record says in which tick the device took it. Where anything is missing the trace is cut: what
//! follows cannot be run again, however much of it comes.

use std::collections::HashMap;

use firmware::tick::Origin;
use model_export::link::trace::{TraceCommand, TraceFlags, TracePiece, TraceRecord};
use serde::{Deserialize, Serialize};

/// A traced tick.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TracedTick {
    /// What the device told of it.
    pub record: TraceRecord,
    /// The frames of the requests that it took, as they were sent.
    pub from_host: Vec<u8>,
}

/// A trace as it arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trace {
    /// What the device kept when it began again.
    pub origin: Origin,
    /// The ticks from then on.
    pub ticks: Vec<TracedTick>,
    /// Why it does not go on to the end that was asked for.
    pub cut: Option<Cut>,
}

/// Why a trace ends too early.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cut {
    /// Bytes were lost on the line.
    Lost {
        /// How many, at least.
        bytes: u32,
    },
    /// The device had more to tell than the line takes.
    TooSlow,
    /// The device did not end it: it was reset, or is gone.
    NoEnd,
    /// A tick took a request that this program did not send.
    Stranger {
        /// The request's token.
        token: u32,
    },
    /// Bytes that are no record.
    NoRecord,
}

impl Cut {
    /// What happened and what to do about it.
    #[must_use]
    pub fn in_words(&self) -> String {
        match self {
            Self::Lost { bytes } => format!(
                "{bytes} bytes of the trace were lost on the line. Use a shorter cable or another adapter; `catheter rig status` counts the \
                 frames that arrive damaged."
            ),
            Self::TooSlow => {
                "The device had more to tell than the line takes. Telemetry less often (telemetry.period_ms) leaves more room \
                              for the trace."
                    .to_owned()
            }
            Self::NoEnd => {
                "The device did not say that the trace is over: it was reset, or is gone. What it did in the last hundredths of a \
                            second before was not sent; `catheter rig explain` tells the fault that survived the reset."
                    .to_owned()
            }
            Self::Stranger { token } => format!(
                "A tick took the request {token}, which this program did not send. Let no other program use the port during a recording."
            ),
            Self::NoRecord => {
                "Bytes of the trace are no record: firmware and program differ in its format. Build both from the same sources.".to_owned()
            }
        }
    }
}

/// A trace on its way.
#[derive(Debug, Default)]
pub(super) struct Stream {
    /// Offset of the next piece, once there was one.
    next_offset: Option<u32>,
    /// What is no whole record yet.
    rest: Vec<u8>,
    /// Frames sent and not yet taken, by token.
    sent: HashMap<u32, Vec<u8>>,
    /// The frame of the last vent, which no token names.
    vent: Vec<u8>,
    ticks: Vec<TracedTick>,
    end: Option<Result<(), Cut>>,
}

impl Stream {
    /// Keeps a request's frame.
    pub(super) fn sent(&mut self, token: u32, is_vent: bool, frame: &[u8]) {
        if is_vent {
            self.vent = frame.to_vec();
        } else {
            self.sent.insert(token, frame.to_vec());
        }
    }

    /// Whether nothing more will be taken.
    pub(super) fn has_ended(&self) -> bool {
        self.end.is_some()
    }

    /// Ticks so far.
    pub(super) fn len(&self) -> usize {
        self.ticks.len()
    }

    /// Takes a piece.
    pub(super) fn take(&mut self, piece: &TracePiece) {
        if self.has_ended() {
            return;
        }
        let expected = self.next_offset.unwrap_or(piece.offset);
        if piece.offset != expected {
            self.end = Some(Err(Cut::Lost { bytes: piece.offset.wrapping_sub(expected) }));
            return;
        }
        // A piece is far shorter than 32 bits count.
        self.next_offset = Some(expected.wrapping_add(piece.bytes.len() as u32));
        self.rest.extend_from_slice(&piece.bytes);
        let bytes = std::mem::take(&mut self.rest);
        let mut rest = bytes.as_slice();
        while !self.has_ended() {
            match TraceRecord::take(rest) {
                Ok(Some((record, behind))) => {
                    rest = behind;
                    if let Err(cut) = self.record(record) {
                        self.end = Some(Err(cut));
                    }
                }
                Ok(None) => break,
                Err(_) => self.end = Some(Err(Cut::NoRecord)),
            }
        }
        self.rest = rest.to_vec();
    }

    fn record(&mut self, record: TraceRecord) -> Result<(), Cut> {
        if record.flags.contains(TraceFlags::END) {
            let overflowed = record.flags.contains(TraceFlags::OVERFLOW);
            self.end = Some(if overflowed { Err(Cut::TooSlow) } else { Ok(()) });
            return Ok(());
        }
        if self.ticks.is_empty() != record.flags.contains(TraceFlags::FIRST) {
            // The beginning did not arrive, or is that of another trace.
            return Err(if self.ticks.is_empty() { Cut::Lost { bytes: 0 } } else { Cut::NoEnd });
        }
        let mut from_host = Vec::new();
        if record.flags.contains(TraceFlags::VENT) {
            from_host.extend_from_slice(&self.vent);
        }
        if let Some(TraceCommand::Request(token)) = record.extra.map(|extra| extra.command) {
            from_host.append(&mut self.sent.remove(&token).ok_or(Cut::Stranger { token })?);
        }
        self.ticks.push(TracedTick { record, from_host });
        Ok(())
    }

    /// What came.
    pub(super) fn finish(self, origin: Origin) -> Trace {
        let cut = self.end.unwrap_or(Err(Cut::NoEnd)).err();
        Trace { origin, ticks: self.ticks, cut }
    }
}

#[cfg(test)]
mod tests {
    use model_export::link::trace::{MAX_RECORD_BYTES, TraceExtra};

    use super::*;

    fn bytes(records: &[TraceRecord]) -> Vec<u8> {
        let mut all = Vec::new();
        for record in records {
            let mut place = [0; MAX_RECORD_BYTES];
            let length = record.encode(1000, &mut place).length;
            all.extend_from_slice(&place[..length]);
        }
        all
    }

    fn records() -> Vec<TraceRecord> {
        let first = TraceRecord { flags: TraceFlags::FIRST, laser_code: 3000, ..TraceRecord::default() };
        let command = TraceCommand::Request(7);
        let second = TraceRecord { extra: Some(TraceExtra { lost_ticks: 2, command }), check: 700, ..TraceRecord::default() };
        vec![first, second, TraceRecord::default(), TraceRecord::end(false)]
    }

    fn through(pieces: &[(u32, &[u8])], sent: &[u32]) -> Trace {
        let mut stream = Stream::default();
        sent.iter().for_each(|token| stream.sent(*token, false, &token.to_le_bytes()));
        for (offset, bytes) in pieces {
            stream.take(&TracePiece { offset: *offset, bytes: heapless::Vec::from_slice(bytes).unwrap() });
        }
        stream.finish(Origin::default())
    }

    #[test]
    fn records_come_whole_out_of_pieces_cut_anywhere() {
        let bytes = bytes(&records());
        for cut in 1..bytes.len() {
            // The offset counts from the device's start, so that of the first piece says nothing, and it may wrap.
            let begin = u32::MAX - 3;
            let trace = through(&[(begin, &bytes[..cut]), (begin.wrapping_add(cut as u32), &bytes[cut..])], &[7, 8]);
            assert_eq!(trace.cut, None);
            assert_eq!(trace.ticks.iter().map(|tick| tick.record).collect::<Vec<_>>(), records()[..3]);
            assert_eq!(trace.ticks[1].from_host, [7, 0, 0, 0]);
        }
    }

    #[test]
    fn a_trace_ends_where_something_is_missing_and_says_what() {
        let bytes = bytes(&records());
        let (head, tail) = bytes.split_at(8);
        let cut = |pieces: &[(u32, &[u8])], sent: &[u32]| {
            let trace = through(pieces, sent);
            (trace.ticks.len(), trace.cut)
        };
        assert_eq!(cut(&[(0, head), (208, tail)], &[7]), (1, Some(Cut::Lost { bytes: 200 })));
        assert_eq!(cut(&[(8, &self::bytes(&records()[1..]))], &[7]), (0, Some(Cut::Lost { bytes: 0 })));
        assert_eq!(cut(&[(0, &bytes)], &[8]), (1, Some(Cut::Stranger { token: 7 })));
        assert_eq!(cut(&[(0, &bytes[..bytes.len() - 5])], &[7]), (3, Some(Cut::NoEnd)));
        assert_eq!(cut(&[(0, &self::bytes(&[records()[0], TraceRecord::end(true)]))], &[]), (1, Some(Cut::TooSlow)));
        assert_eq!(cut(&[(0, &[0xff; 40])], &[]), (0, Some(Cut::NoRecord)));
        // Nothing that comes behind the gap is taken.
        assert_eq!(cut(&[(0, head), (208, tail), (8, tail)], &[7]), (1, Some(Cut::Lost { bytes: 200 })));
    }
}
