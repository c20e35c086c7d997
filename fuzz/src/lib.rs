//! Damaged and hostile files for every reader.
//!
//! Valid files are changed at random from a fixed seed: bytes flip, pieces vanish, repeat or change places, numbers become those that hurt,
//! two files are joined. A reader must end in a result or a clear refusal within [`SECONDS`] and [`MEMORY_BYTES`]. Readers that are called
//! run in a child process (`fuzz-readers`), which a crash takes with it; commands are processes anyway.
//!
//! The seeds are the project's own: no fuzzer's corpus is kept. An input is told by its target, seed and number, and can be made again.

pub mod mutate;
pub mod parent;
pub mod readers;
pub mod seeds;
pub mod targets;

/// Longer than this is a hang, s.
pub const SECONDS: u64 = 5;
/// More memory than this is too much.
pub const MEMORY_BYTES: u64 = 1 << 30;

/// Minutes that a run lasts: `FUZZ_MINUTES`, else so many.
#[must_use]
pub fn minutes(otherwise: f64) -> f64 {
    std::env::var("FUZZ_MINUTES").ok().and_then(|text| text.parse().ok()).filter(|minutes: &f64| *minutes > 0.0).unwrap_or(otherwise)
}

/// The seed of a run: `FUZZ_SEED`, else 1.
#[must_use]
pub fn seed() -> u64 {
    std::env::var("FUZZ_SEED").ok().and_then(|text| text.parse().ok()).unwrap_or(1)
}
