//! The tick's length, in numbers.

/// Ticks in a second.
pub const TICKS_PER_S: f32 = 1000.0;
/// The same as an integer.
pub const TICKS_IN_A_SECOND: u32 = 1000;
