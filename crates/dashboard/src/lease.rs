//! The control lease: one client may operate, as long as it gives signs of life.

use std::time::{Duration, Instant};

use serde::Serialize;

/// How long an operator may be silent while the rig is vented: a page that the browser suspended for a moment keeps its place.
pub const VENTED_LENGTH: Duration = Duration::from_secs(2);

/// Who operates.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Holder {
    /// Number of the client.
    pub client: u64,
    /// What it calls itself.
    pub name: String,
}

/// Who operates, and when it was last heard.
#[derive(Debug, Default)]
pub struct Lease {
    holder: Option<(Holder, Instant)>,
}

impl Lease {
    /// Gives the lease to a client, or tells who has it.
    pub fn take(&mut self, holder: Holder, now: Instant) -> Result<(), Holder> {
        match &self.holder {
            Some((other, _)) if other.client != holder.client => Err(other.clone()),
            _ => {
                self.holder = Some((holder, now));
                Ok(())
            }
        }
    }

    /// Whether the sign of life came from the operator.
    pub fn renew(&mut self, client: u64, now: Instant) -> bool {
        match &mut self.holder {
            Some((holder, heard)) if holder.client == client => {
                *heard = now;
                true
            }
            _ => false,
        }
    }

    /// Gives the lease back; whether the client had it.
    pub fn release(&mut self, client: u64) -> bool {
        let held = self.is_held_by(client);
        if held {
            self.holder = None;
        }
        held
    }

    /// Takes the lease from an operator that was silent for longer than `length`.
    pub fn expire(&mut self, length: Duration, now: Instant) -> Option<Holder> {
        let (_, heard) = self.holder.as_ref()?;
        if now.saturating_duration_since(*heard) <= length {
            return None;
        }
        self.holder.take().map(|(holder, _)| holder)
    }

    /// Whether this client operates.
    pub fn is_held_by(&self, client: u64) -> bool {
        self.holder.as_ref().is_some_and(|(holder, _)| holder.client == client)
    }

    /// Who operates.
    pub fn holder(&self) -> Option<&Holder> {
        self.holder.as_ref().map(|(holder, _)| holder)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn holder(client: u64) -> Holder {
        Holder { client, name: format!("page {client}") }
    }

    #[test]
    fn one_client_operates_until_it_falls_silent_or_gives_the_lease_back() {
        let (mut lease, begin) = (Lease::default(), Instant::now());
        let at = |milliseconds| begin + Duration::from_millis(milliseconds);
        let length = Duration::from_millis(250);
        assert_eq!(lease.take(holder(1), at(0)), Ok(()));
        assert_eq!(lease.take(holder(2), at(1)), Err(holder(1)));
        assert!(!lease.renew(2, at(2)), "a watcher's sign of life is nobody's");
        assert!(lease.renew(1, at(200)));
        assert_eq!(lease.expire(length, at(450)), None);
        assert_eq!(lease.expire(length, at(451)), Some(holder(1)));
        assert!(!lease.renew(1, at(452)), "what ran out is not renewed");
        assert_eq!(lease.take(holder(2), at(453)), Ok(()));
        assert!(!lease.release(1) && lease.is_held_by(2));
        assert!(lease.release(2) && lease.holder().is_none());
    }
}
