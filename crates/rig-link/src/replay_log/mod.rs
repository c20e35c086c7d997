//! Journals: everything that went into a rig, tick by tick, so that the same library can be run again on the desktop, bit for bit.
//!
//! Terms. A *replay log* begins with what the device started from: its flash (settings and models), its name and its line's speed. Then it has
//! one *event* a tick: the raw codes, what the host's line brought, and what came out. A start of the processor is an event too, and so is
//! a tick that passed without it. [`Recorder`] writes one while a simulated rig runs, from its start on and without its knowing. A board is
//! asked for a *trace* instead ([`Tracing`]): it begins again and tells its ticks over the link, and the replay log has them as they came.
//! [`replay()`] runs both again.
//!
//! | offset | bytes | what |
//! |---|---|---|
//! | 0 | 8 | `CATHJRNL` |
//! | 8 | 2 | version of the format, now 3: 1 had no traces, 2 no hash of the recording |
//! | 10 | 2 | zero |
//! | 12 | 4 | CRC-32 (IEEE 802.3) of everything behind it |
//! | 16 | | [`Header`], then the [`Event`]s, in postcard |

mod file;
mod replay;
mod story;
mod traced;

pub use file::{Event, Header, Outputs, Recorder, ReplayLog, Tick, VERSION};
pub use replay::{Difference, Replay, replay};
pub use story::{Cause, Moment, Story, Turning, story};
pub use traced::{Tracing, TracingError};
