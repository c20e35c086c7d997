//! A rig that people operate through the dashboard: the link's client behind [`dashboard::Rig`].
//!
//! What keeps a running device running leaves only in [`renew`](dashboard::Rig::renew) and within [`RENEWAL_WINDOW`](dashboard::RENEWAL_WINDOW) of it, so
//! that a device whose operator is silent is silent for the device too. Settings that a session needs (telemetry at the full rate, the control law, the
//! playback's period) are borrowed: never saved, and set back at its end.

mod act;
mod borrow;
mod excite;
mod follow;
mod limits;
mod listen;
mod measure;
mod offers;
mod pace;
mod play;
mod reach;
mod rig;
mod run_task;
mod session;
mod simulated;
mod task;
#[cfg(test)]
mod tests;
mod told;
mod wizard;
mod words;

pub use offers::{Controller, Offers};
pub use pace::Line;
pub use rig::OperatedRig;
