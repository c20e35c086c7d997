//! Controllers by name, and the settings that choose one.

use model_export::link::settings::{SettingValue, by_name};

/// Settings by number.
pub type SettingValues = Vec<(u16, SettingValue)>;

/// A controller by its name: what chooses it in the settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Controller {
    /// Its name.
    pub name: &'static str,
    /// Number of the feed-forward.
    pub feed_forward: u32,
    /// Number of the feedback's sensor.
    pub sensor: u32,
}

/// Every controller that has a name.
pub const CONTROLLERS: [Controller; 9] = [
    Controller { name: "open-loop", feed_forward: 1, sensor: 0 },
    Controller { name: "pi-inverse", feed_forward: 2, sensor: 0 },
    Controller { name: "physics-inverse", feed_forward: 3, sensor: 0 },
    Controller { name: "learned-inverse", feed_forward: 4, sensor: 0 },
    Controller { name: "pid", feed_forward: 0, sensor: 1 },
    Controller { name: "open-loop+pid", feed_forward: 1, sensor: 1 },
    Controller { name: "pi-inverse+pid", feed_forward: 2, sensor: 1 },
    Controller { name: "physics-inverse+pid", feed_forward: 3, sensor: 3 },
    Controller { name: "sensorless", feed_forward: 3, sensor: 2 },
];

/// The controller of this name.
#[must_use]
pub fn controller(name: &str) -> Option<Controller> {
    CONTROLLERS.iter().copied().find(|controller| controller.name == name)
}

/// A setting by its dotted name.
///
/// # Panics
/// When no setting has this name: a mistake in the program that every test would meet.
#[must_use]
pub fn setting(name: &str, value: SettingValue) -> (u16, SettingValue) {
    match by_name(name) {
        Some(info) => (info.number, value),
        None => panic!("there is no setting {name}"),
    }
}

impl Controller {
    /// The settings that choose it.
    #[must_use]
    pub fn settings(&self) -> SettingValues {
        vec![
            setting("control.law", SettingValue::Integer(2)),
            setting("control.feed_forward", SettingValue::Integer(self.feed_forward)),
            setting("control.sensor", SettingValue::Integer(self.sensor)),
        ]
    }

    /// Whether it feeds back.
    #[must_use]
    pub fn feeds_back(&self) -> bool {
        self.sensor != 0
    }
}
