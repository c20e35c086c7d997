//! Control laws: what pressure to ask for, given set-points and measurements.
//!
//! A control law knows no clock, no HAL and no limits: the limiter behind it does not trust it, and the supervisor decides whether it runs at
//! all. Every law implements [`ControlLaw`]; [`Controller`] is the one in use, chosen by the settings. To add a law: implement the
//! trait in its own file, add a variant to [`Controller`] and a number to the setting `control.law`.

mod actuator;
mod compensator;
mod controller;
mod law;
mod observer;
mod pid;
mod playback;
mod points;
mod reference;
mod set_point;
mod tracking;

#[cfg(test)]
mod tests;

pub use actuator::{Actuator, ActuatorState, TICK_S};
pub use compensator::{CATCH_UP_S, Compensator, CompensatorState};
pub use controller::{Controller, ControllerState};
pub use law::{Accepted, ControlInputs, ControlLaw, ControlOutput, Demand, SetPoint};
pub use observer::{Blend, ObserverConfig, ObserverState};
pub use pid::{Pid, PidConfig, PidState};
pub use playback::{Playback, PlaybackConfig, PlaybackState};
pub use points::{PLAYBACK_CAPACITY, PointBuffer};
pub use reference::{Progress, Reference, ReferenceState};
pub use set_point::{PressureSetPoint, PressureSetPointState};
pub use tracking::{FeedForward, FeedbackSensor, OutsideDomain, Tracking, TrackingConfig, TrackingState};
