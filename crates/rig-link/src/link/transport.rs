//! What carries bytes to a device.

use std::time::Duration;

use super::error::LinkError;

/// A line to a device.
pub trait Transport {
    /// Sends bytes, all of them.
    ///
    /// # Errors
    /// When the device is gone.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;

    /// Waits until bytes come, at most `limit` of this transport's time, and adds them to `into`; none by then is no error.
    ///
    /// # Errors
    /// When the device is gone.
    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError>;

    /// Time since the transport was opened, by its own clock.
    fn elapsed(&self) -> Duration;

    /// Where it leads, for messages.
    fn place(&self) -> &str;

    /// What can be seen of the other end when it does not answer, for messages; empty where nothing can.
    fn condition(&self) -> String {
        String::new()
    }

    /// The token before the first request's. A line that others may have used begins at random, so that a reply that was for somebody else is not
    /// taken for one of ours; a rig in simulated time begins at zero, so that the same command gives the same bytes.
    fn token_before_the_first(&self) -> u32 {
        0
    }
}

impl<T: Transport + ?Sized> Transport for &mut T {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        (**self).send(bytes)
    }

    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        (**self).receive(limit, into)
    }

    fn elapsed(&self) -> Duration {
        (**self).elapsed()
    }

    fn place(&self) -> &str {
        (**self).place()
    }

    fn condition(&self) -> String {
        (**self).condition()
    }

    fn token_before_the_first(&self) -> u32 {
        (**self).token_before_the_first()
    }
}
