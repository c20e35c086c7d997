//! Sessions: which requests are of now.

use model_export::blob::crc32;

/// Which requests are of now: those of the session that the last Hello began, in rising order of their tokens.
#[derive(Debug, Default)]
pub(super) struct Sessions {
    pub(super) number: Option<u32>,
    is_used: bool,
    last_token: u32,
    /// Takes requests of every session, in whatever order.
    pub(super) every: bool,
}

/// What to make of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    Admitted,
    /// Sent before one that was taken already.
    Old,
    OtherSession,
}

impl Sessions {
    /// Begins a session; `noise` makes its number another one than after the last start.
    pub(super) fn begin(&mut self, noise: u32) {
        if self.number.is_none() || self.is_used {
            let before = self.number.unwrap_or(0).to_le_bytes();
            // Zero is no number: it stands for a device that has no sessions.
            let number = crc32(crc32(0, &before), &noise.to_le_bytes()).max(1);
            *self = Self { number: Some(number), every: self.every, ..Self::default() };
        }
    }

    pub(super) fn load(&mut self, session: u32, token: u32) -> Admission {
        if self.every {
            return Admission::Admitted;
        }
        if self.number != Some(session) {
            return Admission::OtherSession;
        }
        if token <= self.last_token {
            return Admission::Old;
        }
        self.is_used = true;
        self.last_token = token;
        Admission::Admitted
    }
}
