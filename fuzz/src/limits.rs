//! How long and how large: of a reader, and of a run.

/// More processor time than this is a hang, s.
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
