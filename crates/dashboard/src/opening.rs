//! Meeting a rig beside the session: a slow one takes seconds, and whoever asks for the state is answered meanwhile. A fast one is waited for,
//! so that the first request of a script finds it.

use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::rig::{Problem, Rig};

/// What comes of an attempt.
type Opened = Result<Box<dyn Rig>, Problem>;

/// Opens the rig, again when it was gone.
pub type Opener = Box<dyn FnMut() -> Opened + Send>;

/// How often one tries to open a rig that is gone.
const RETRY: Duration = Duration::from_secs(1);
/// An attempt that takes longer goes on beside the session.
const FAST: Duration = Duration::from_millis(500);

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
        if Instant::now() >= self.next
            && let Some(mut opener) = self.opener.take()
        {
            let attempt = thread::spawn(move || {
                let opened = opener();
                (opener, opened)
            });
            let begun = Instant::now();
            while !attempt.is_finished() && begun.elapsed() < FAST {
                thread::sleep(Duration::from_millis(1));
            }
            self.attempt = Some(attempt);
        }
        let ended = self.attempt.take_if(|attempt| attempt.is_finished())?.join();
        let (opener, opened) = ended.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        self.opener = Some(opener);
        self.next = Instant::now() + RETRY;
        Some(opened)
    }
}
