//! Tracking: a reference run on a rig with one controller after the other, and how well each did.

pub mod bench;
pub mod beyond;
pub mod compare;
pub mod learn;
pub mod missed;
pub mod rig;
pub mod run;

pub use crate::control::{
    CONTROLLERS, Controller, Figures, Reach, Reference, Sample, SettingValues, controller, figures, reference, setting,
};
pub use beyond::Beyond;
pub use rig::rig_settings;
pub use run::RunError;
