//! Recordings made ready: common scales, rest, roles, outliers, noise.

pub mod bursts;
pub mod fast_noise;
pub mod frozen;
pub mod late_steps;
pub mod mask;
pub mod noise;
pub mod phasors;
pub mod prepare;
pub mod session;
pub mod statistics;
pub mod strokes;
pub mod test_view;
pub mod turning;
pub mod worked;
