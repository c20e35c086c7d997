//! Meeting a rig beside the session: a slow one takes seconds, and whoever asks for the state is answered meanwhile.

use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::rig::{Problem, Rig};

/// What comes of an attempt.
type Opened = Result<Box<dyn Rig>, Problem>;

/// Opens the rig, again when it was gone.
pub type Opener = Box<dyn FnMut() -> Opened + Send>;

/// How often one tries to open a rig that is gone.
const RETRY: Duration = Duration::from_secs(1);

/// Attempts, one after the other.
pub(crate) struct Opening {
    /// Not here while an attempt has it.
    opener: Option<Opener>,
    attempt: Option<JoinHandle<(Opener, Opened)>>,
    next: Instant,
}

impl Opening {
    /// Nothing is tried yet.
    pub fn new(opener: Opener) -> Self {
        Self { opener: Some(opener), attempt: None, next: Instant::now() }
    }

    /// What the attempt came to that has ended since; begins one when it is time.
    pub fn poll(&mut self) -> Option<Opened> {
        if self.attempt.as_ref().is_some_and(JoinHandle::is_finished) {
            let ended = self.attempt.take()?.join();
            let (opener, opened) = ended.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            self.opener = Some(opener);
            self.next = Instant::now() + RETRY;
            return Some(opened);
        }
        if Instant::now() >= self.next
            && let Some(mut opener) = self.opener.take()
        {
            self.attempt = Some(thread::spawn(move || {
                let opened = opener();
                (opener, opened)
            }));
        }
        None
    }
}
