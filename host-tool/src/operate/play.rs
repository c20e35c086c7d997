//! An excitation on its way to the device, a chunk at a time.

use std::time::{Duration, Instant};

use model_export::link::message::{MAX_CHUNK_POINTS, PlaybackChunk, Refusal, Reply};

/// A reply that has not come by then was lost; the device confirms again what it has.
const REPLY_WITHIN: Duration = Duration::from_millis(100);

/// The points of an excitation and how far they have come.
pub struct Play {
    points: Vec<f32>,
    /// Time from one point to the next, ms.
    pub period_ms: u32,
    /// Index of the next point that the device wants.
    pub confirmed: u32,
    free: u32,
    waiting: Option<(u32, Instant)>,
}

impl Play {
    /// Nothing of it is sent yet.
    pub fn new(points: Vec<f32>, period_ms: u32) -> Self {
        Self { points, period_ms, confirmed: 0, free: u32::MAX, waiting: None }
    }

    /// Begins again.
    pub fn rewind(&mut self) {
        (self.confirmed, self.free, self.waiting) = (0, u32::MAX, None);
    }

    /// Points it has.
    pub fn length(&self) -> u32 {
        u32::try_from(self.points.len()).unwrap_or(u32::MAX)
    }

    /// Whether the device has all of them.
    pub fn is_sent(&self) -> bool {
        self.confirmed >= self.length()
    }

    /// Whether a whole chunk, or all that is left, fits.
    pub fn has_room(&self) -> bool {
        let left = self.length() - self.confirmed;
        left > 0 && self.free >= left.min(MAX_CHUNK_POINTS as u32)
    }

    /// The next chunk; an empty one says that the host is there.
    pub fn chunk(&self) -> PlaybackChunk {
        let at = self.confirmed as usize;
        let count = if self.has_room() { (self.points.len() - at).min(MAX_CHUNK_POINTS) } else { 0 };
        let values_bar = heapless::Vec::from_slice(&self.points[at..at + count]).unwrap_or_default();
        PlaybackChunk { first_index: self.confirmed, last: count > 0 && at + count == self.points.len(), values_bar }
    }

    /// A chunk went out with this token.
    pub fn sent(&mut self, token: u32) {
        self.waiting = Some((token, Instant::now()));
    }

    /// The token whose reply is waited for.
    pub fn waits_for(&self) -> Option<u32> {
        self.waiting.filter(|(_, since)| since.elapsed() < REPLY_WITHIN).map(|(token, _)| token)
    }

    /// What the device said of the last chunk.
    pub fn take(&mut self, reply: &Reply) {
        self.waiting = None;
        match reply {
            Reply::Playback { next_index, free } => {
                self.confirmed = (*next_index).min(self.length());
                self.free = u32::from(*free);
            }
            Reply::Refused(Refusal::PlaybackIndex(index)) => self.confirmed = (*index).min(self.length()),
            Reply::Refused(Refusal::PlaybackFull(free)) => self.free = u32::from(*free),
            _ => {}
        }
    }
}
