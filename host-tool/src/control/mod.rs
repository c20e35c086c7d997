//! What tuning and tracking share: controllers by name, references, and how well a reference is followed.

mod controller;
pub mod figures;
pub mod reference;

pub use controller::{CONTROLLERS, Controller, SettingValues, controller, setting};
pub use figures::{Figures, Sample};
pub use reference::{PERIOD_S, Reach, Reference};
