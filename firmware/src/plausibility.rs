//! Plausibility: which samples to believe, when to stop believing a sensor, and whether two quantities agree that should.

mod residual;
mod sensor;
mod stillness;

pub use residual::{ResidualMonitor, ResidualMonitorConfig, ResidualState};
pub use sensor::{RECOVERY_TICKS, Rejection, Sensor, SensorConfig, SensorState, Verdict};
pub use stillness::STILL_SHARE;
