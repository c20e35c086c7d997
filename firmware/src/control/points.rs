//! Points of an experiment, sent ahead in chunks.
//!
//! Chunks carry the index of their first point. A chunk that was already taken is confirmed again and changes nothing, so a host that
//! missed a reply may repeat itself; a gap is refused with the index to go on from. A chunk without points is a host saying that it still
//! stands behind the experiment; after the last point was sent it keeps the host-loss timeout fed.

use heapless::Deque;
use model_export::link::message::{PlaybackChunk, Refusal};

/// Points the buffer holds: five seconds at the paper's 50 Hz.
pub const PLAYBACK_CAPACITY: usize = 256;

/// The points that were sent and not yet used.
#[derive(Clone, Debug, Default)]
pub struct PointBuffer {
    points: Deque<f32, PLAYBACK_CAPACITY>,
    next_index: u32,
    has_end: bool,
}

impl PointBuffer {
    /// Forgets points and index.
    pub fn clear(&mut self) {
        // In place: a fresh buffer would be built on the stack of the tick first.
        self.points.clear();
        (self.next_index, self.has_end) = (0, false);
    }

    /// Index the next chunk must begin with.
    pub fn next_index(&self) -> u32 {
        self.next_index
    }

    /// Points there is room for.
    pub fn free(&self) -> u16 {
        u16::try_from(PLAYBACK_CAPACITY.saturating_sub(self.points.len())).unwrap_or(0)
    }

    /// Points there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Whether the last chunk was taken.
    pub fn has_end(&self) -> bool {
        self.has_end
    }

    /// Takes the oldest point out.
    pub fn pop(&mut self) -> Option<f32> {
        self.points.pop_front()
    }

    /// The point this many places behind the oldest; the newest one if there are not that many.
    pub fn at(&self, index: usize) -> Option<f32> {
        self.points.get(index).or_else(|| self.points.back()).copied()
    }

    /// Takes a chunk.
    ///
    /// # Errors
    /// When a value is not a number, the chunk does not follow the last one, or there is no room.
    pub fn take(&mut self, chunk: &PlaybackChunk) -> Result<(), Refusal> {
        if chunk.values_bar.iter().any(|value| !value.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        let length = u32::try_from(chunk.values_bar.len()).unwrap_or(u32::MAX);
        let end = chunk.first_index.checked_add(length).ok_or(Refusal::PlaybackIndex(self.next_index))?;
        if length > 0 && end <= self.next_index {
            return Ok(());
        }
        if chunk.first_index != self.next_index || (self.has_end && length > 0) {
            return Err(Refusal::PlaybackIndex(self.next_index));
        }
        if length > u32::from(self.free()) {
            return Err(Refusal::PlaybackFull(self.free()));
        }
        for value in &chunk.values_bar {
            // The room was checked above.
            let _ = self.points.push_back(*value);
        }
        self.next_index = end;
        self.has_end |= chunk.last;
        Ok(())
    }
}
