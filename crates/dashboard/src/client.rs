//! Clients: pages and scripts that have proven their role, each with a secret that its requests repeat.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::access::{Role, secret};

/// Most clients at a time; a script that asks for leases in a loop shall not fill the memory.
const MOST: usize = 256;

/// A page or a script.
#[derive(Clone, Debug)]
pub(crate) struct Client {
    /// Its number, which others may see.
    pub number: u64,
    /// What it calls itself, and where it is.
    pub name: String,
    /// What it may do.
    pub role: Role,
    /// Whether it is a script, which nobody sees go.
    pub script: bool,
}

/// Those that are there.
#[derive(Clone, Debug, Default)]
pub(crate) struct Clients {
    inner: Arc<Mutex<Inner>>,
}

#[derive(Debug, Default)]
struct Inner {
    last: u64,
    by_secret: HashMap<String, Client>,
}

impl Clients {
    /// A new one with its secret; `None` if there are too many pages.
    pub fn enter(&self, name: String, role: Role, script: bool) -> Option<(Client, String)> {
        let secret = secret().ok()?;
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        if inner.by_secret.len() >= MOST {
            // The oldest script makes room.
            let oldest = inner.by_secret.iter().filter(|(_, client)| client.script).min_by_key(|(_, client)| client.number)?.0.clone();
            inner.by_secret.remove(&oldest);
        }
        inner.last += 1;
        let client = Client { number: inner.last, name, role, script };
        inner.by_secret.insert(secret.clone(), client.clone());
        Some((client, secret))
    }

    /// The one with this secret.
    pub fn find(&self, secret: &str) -> Option<Client> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner).by_secret.get(secret).cloned()
    }

    /// It is gone.
    pub fn leave(&self, secret: &str) -> Option<Client> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner).by_secret.remove(secret)
    }
}
