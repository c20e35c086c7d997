//! Who may do what: tokens, roles, and which Host and Origin a request may name.

use std::net::SocketAddr;

use axum::http::{HeaderMap, header};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::rig::Action;

/// What a client may do; each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// Watch, and vent.
    Observe,
    /// Arm, start, set set-points, play, record, acknowledge; break and change a simulated rig.
    Operate,
    /// Change and save settings, upload models.
    Configure,
}

impl Role {
    /// All, the least first.
    pub const ALL: [Self; 3] = [Self::Observe, Self::Operate, Self::Configure];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Observe => "observe",
            Self::Operate => "operate",
            Self::Configure => "configure",
        }
    }

    /// The least role that may do this.
    pub(crate) const fn needed(action: &Action) -> Self {
        match action {
            Action::Vent => Self::Observe,
            Action::Set { .. } | Action::Save | Action::Revert { .. } | Action::Accept => Self::Configure,
            _ => Self::Operate,
        }
    }
}

impl std::str::FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let role = Self::ALL.into_iter().find(|role| role.name() == text);
        role.ok_or_else(|| "observe, operate or configure is wanted".to_owned())
    }
}

/// A token for each role that is handed out.
#[derive(Clone, Debug)]
pub(crate) struct Tokens {
    tokens: Vec<(Role, String)>,
}

impl Tokens {
    /// Fresh ones for every role up to `most`.
    pub fn new(most: Role) -> Result<Self, getrandom::Error> {
        let roles = Role::ALL.into_iter().filter(|role| *role <= most);
        let tokens = roles.map(|role| Ok((role, secret()?))).collect::<Result<_, _>>()?;
        Ok(Self { tokens })
    }

    /// Role and token, the least role first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = (Role, &str)> {
        self.tokens.iter().map(|(role, token)| (*role, token.as_str()))
    }

    /// The role that a token proves. The hashes are compared, so that the time taken tells nothing about the token.
    pub fn role(&self, token: &str) -> Option<Role> {
        let given = Sha256::digest(token.as_bytes());
        self.tokens.iter().find(|(_, token)| Sha256::digest(token.as_bytes()) == given).map(|(role, _)| *role)
    }
}

/// 128 random bits in hexadecimal.
pub(crate) fn secret() -> Result<String, getrandom::Error> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Names under which the server may be addressed: a page of somebody else's that resolves its own name to this machine names another one.
#[derive(Clone, Debug)]
pub(crate) struct Names {
    hosts: Vec<String>,
    scheme: &'static str,
}

impl Names {
    /// The names of a server at this address; `more` are names that the operator gave.
    pub fn new(address: SocketAddr, tls: bool, more: &[String]) -> Self {
        let port = address.port();
        let mut names = vec![address.ip().to_string(), "127.0.0.1".to_owned(), "localhost".to_owned(), "[::1]".to_owned()];
        if address.is_ipv6() {
            names.push(format!("[{}]", address.ip()));
        }
        names.extend(more.iter().map(|name| name.to_ascii_lowercase()));
        let hosts = names.iter().map(|name| format!("{name}:{port}")).collect();
        Self { hosts, scheme: if tls { "https" } else { "http" } }
    }

    /// Why a request that names another server is not heard.
    pub fn check_host(&self, headers: &HeaderMap) -> Result<(), &'static str> {
        let host = headers.get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or_default().to_ascii_lowercase();
        if self.hosts.contains(&host) {
            Ok(())
        } else {
            Err("the Host is not this server's; open the address that `catheter dashboard` printed, or give the name with --name")
        }
    }

    /// Why a request that names another server or comes from another page is not heard.
    pub fn check(&self, headers: &HeaderMap) -> Result<(), &'static str> {
        self.check_host(headers)?;
        let Some(origin) = headers.get(header::ORIGIN) else { return Ok(()) };
        let origin = origin.to_str().unwrap_or_default().to_ascii_lowercase();
        let ours =
            origin.split_once("://").is_some_and(|(scheme, host)| scheme == self.scheme && self.hosts.iter().any(|name| name == host));
        if ours { Ok(()) } else { Err("the Origin is another page's") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_proves_its_role_and_no_other_text_does() {
        let tokens = Tokens::new(Role::Operate).unwrap();
        let all: Vec<(Role, &str)> = tokens.iter().collect();
        assert_eq!(all.iter().map(|(role, _)| *role).collect::<Vec<_>>(), [Role::Observe, Role::Operate]);
        for (role, token) in &all {
            assert_eq!(tokens.role(token), Some(*role));
            assert_eq!((token.len(), tokens.role(&token[1..])), (32, None));
        }
        assert_ne!(all[0].1, all[1].1);
        assert_eq!(tokens.role(""), None);
    }

    #[test]
    fn only_this_servers_names_and_pages_are_heard() {
        let names = Names::new("127.0.0.1:4000".parse().unwrap(), false, &["Rig.lab".to_owned()]);
        let headers = |host: &str, origin: Option<&str>| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, host.parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, origin.parse().unwrap());
            }
            headers
        };
        for (host, origin) in [
            ("127.0.0.1:4000", None),
            ("localhost:4000", Some("http://localhost:4000")),
            ("rig.lab:4000", Some("http://127.0.0.1:4000")),
            ("LOCALHOST:4000", Some("http://rig.lab:4000")),
        ] {
            assert_eq!(names.check(&headers(host, origin)), Ok(()), "{host} {origin:?}");
        }
        for (host, origin) in [
            ("evil.example:4000", None),
            ("127.0.0.1", None),
            ("127.0.0.1:4001", None),
            ("127.0.0.1:4000", Some("http://evil.example")),
            ("127.0.0.1:4000", Some("https://127.0.0.1:4000")),
            ("127.0.0.1:4000", Some("http://127.0.0.1:4001")),
            ("127.0.0.1:4000", Some("null")),
        ] {
            assert!(names.check(&headers(host, origin)).is_err(), "{host} {origin:?}");
        }
        assert!(names.check(&HeaderMap::new()).is_err());
    }
}
