//! An excitation that is fed to the device by signs of life.

use std::time::{Duration, Instant};

use model_export::link::message::Reply;

use crate::feed::Feed;

/// A reply that has not come by then was lost; the device confirms again what it has.
const REPLY_WITHIN: Duration = Duration::from_millis(100);

/// An excitation, loaded.
pub struct Play {
    /// Its points.
    pub feed: Feed,
    /// Time from one point to the next, ms.
    pub period_ms: u32,
    waiting: Option<(u32, Instant)>,
}

impl Play {
    /// Nothing of it is sent yet.
    pub fn new(points: Vec<f32>, period_ms: u32) -> Self {
        Self { feed: Feed::new(points), period_ms, waiting: None }
    }

    /// Begins again.
    pub fn rewind(&mut self) {
        self.feed.rewind();
        self.waiting = None;
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
        self.feed.take(reply);
    }
}
