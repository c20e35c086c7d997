//! An excitation on its way to the device, a chunk at a time.

use model_export::link::message::{MAX_CHUNK_POINTS, PlaybackChunk, Refusal, Reply};

/// The points of an excitation and how far they have come.
#[derive(Clone, Debug)]
pub struct Feed {
    points: Vec<f32>,
    confirmed: u32,
    free: u32,
}

impl Feed {
    /// Nothing of it is sent yet.
    #[must_use]
    pub fn new(points: Vec<f32>) -> Self {
        Self { points, confirmed: 0, free: u32::MAX }
    }

    /// Begins again.
    pub fn rewind(&mut self) {
        (self.confirmed, self.free) = (0, u32::MAX);
    }

    /// Points it has.
    #[must_use]
    pub fn length(&self) -> u32 {
        u32::try_from(self.points.len()).unwrap_or(u32::MAX)
    }

    /// Index of the next point that the device wants.
    #[must_use]
    pub fn confirmed(&self) -> u32 {
        self.confirmed
    }

    /// Whether the device has all of them.
    #[must_use]
    pub fn is_sent(&self) -> bool {
        self.confirmed >= self.length()
    }

    /// Whether a whole chunk, or all that is left, fits.
    #[must_use]
    pub fn has_room(&self) -> bool {
        let left = self.length() - self.confirmed;
        left > 0 && self.free >= left.min(MAX_CHUNK_POINTS as u32)
    }

    /// The next chunk; an empty one says that the host is there.
    #[must_use]
    pub fn chunk(&self) -> PlaybackChunk {
        let at = self.confirmed as usize;
        let count = if self.has_room() { (self.points.len() - at).min(MAX_CHUNK_POINTS) } else { 0 };
        let values_bar = heapless::Vec::from_slice(&self.points[at..at + count]).unwrap_or_default();
        PlaybackChunk { first_index: self.confirmed, last: count > 0 && at + count == self.points.len(), values_bar }
    }

    /// What the device said of the last chunk.
    pub fn take(&mut self, reply: &Reply) {
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
