//! A page in the browser that operates a rig, and the server behind it.
//!
//! Terms. A [`Rig`] is what is operated: a trait, so that this crate knows neither links nor firmware. The **session** is the one thread that owns it.
//! A **client** is a page or a script that has proven its [`Role`] with a token. The **lease** says which client is the operator; it is worth
//! nothing without its **heartbeats**: only a heartbeat lets the session renew what keeps the device running, so a device whose operator is gone
//! vents by its own time-to-live, whatever died in between.
//!
//! ```text
//! page ── WebSocket: samples, state │ heartbeats, vent ──┐
//!      ── HTTP: actions, settings, jobs ─────────────────┤ server ── orders ──► session ──► Rig
//! script ── HTTP under /api/ ────────────────────────────┘        ◄─ broadcast ─┘
//! ```

mod access;
mod api;
mod assets;
mod audit;
mod client;
mod folder;
mod frame;
mod jobs;
mod lease;
mod load;
mod opening;
mod recorder;
mod rig;
mod server;
mod session;
mod shared;
mod socket;
mod tls;
mod viewer;

pub use access::Role;
pub use frame::{HEADER_BYTES, SAMPLE_BYTES, VERSION};
pub use jobs::{JobKind, Jobs};
pub use load::{Foreign, Loaded, Loader};
pub use opening::Opener;
pub use rig::{
    Account, Action, Asked, Entry, Explained, Identity, Mode, Phase, Playing, Preview, Problem, RENEWAL_WINDOW, Rig, RigState, Sample,
    Setting, Task,
};
pub use server::{Config, ServeError, Server};
pub use tls::Tls;
