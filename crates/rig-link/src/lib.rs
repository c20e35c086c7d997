//! The host's end of a rig.
//!
//! [`link`] speaks to it through a [`backend`]; [`experiment`] plays excitations to it and [`operate`] lets people operate it; [`calibrate`] measures its
//! sensors and its valve; [`replay_log`] keeps what it did and runs it again; [`bootloader`] writes a new image into it. [`device_settings`] is the one
//! place that reads, compares and borrows its settings, [`history`] what it remembers of a fault.
//!
//! # Example
//! ```
//! use model_export::link::settings::{SettingValue, by_name};
//! use rig_link::setting_words;
//!
//! // A setting as people write it: choices by name.
//! let law = by_name("control.law").expect("a setting");
//! assert_eq!(setting_words::choices(law), Some(&["playback", "pressure", "tracking"][..]));
//! assert_eq!(setting_words::shown(law, SettingValue::Integer(1)), "pressure");
//! ```

pub mod backend;
pub mod bootloader;
pub mod calibrate;
pub mod device_settings;
pub mod energise;
pub mod experiment;
pub mod feed;
pub mod history;
pub mod interrupt;
pub mod link;
pub mod operate;
pub mod replay_log;
pub mod setting_words;
pub mod status;
