//! Damaged and hostile files for every reader.
//!
//! Valid files are changed at random from a fixed seed: bytes flip, pieces vanish, repeat or change places, numbers become those that hurt,
//! two files are joined. A reader must end in a result or a clear refusal within [`SECONDS`] and [`MEMORY_BYTES`]. Readers that are called
//! run in a child process (`fuzz-readers`), which a crash takes with it; commands are processes anyway.
//!
//! The seeds are the project's own: no fuzzer's corpus is kept. An input is told by its target, seed and number, and can be made again.

mod limits;
pub mod mutate;
pub mod parent;
pub mod readers;
pub mod seeds;
pub mod targets;

pub use limits::{MEMORY_BYTES, SECONDS, minutes, seed};
