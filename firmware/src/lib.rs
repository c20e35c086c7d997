//! Firmware logic for the catheter rig: no heap, no panic, and every line of it runs on the desktop too.
#![no_std]
// On the microcontroller the fast kernel's file and the board's registers allow what is denied here; nothing else in the library may.
#![cfg_attr(not(target_os = "none"), forbid(unsafe_code))]
#![cfg_attr(target_os = "none", deny(unsafe_code))]
// What can panic or narrow silently is kept out of the library; tests may.
#![cfg_attr(
    not(test),
    deny(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        clippy::cast_sign_loss,
        clippy::expect_used,
        clippy::indexing_slicing,
        clippy::panic,
        clippy::unwrap_used
    )
)]

pub mod adaptation;
pub mod background;
pub mod board;
pub mod calibration;
pub mod certificate;
pub mod control;
pub mod crash_record;
pub mod decimate;
pub mod device;
pub mod domain;
pub mod drivers;
pub mod estimator;
pub mod history;
pub mod limiter;
pub mod link;
pub mod model;
pub mod number;
pub mod parity;
pub mod plausibility;
pub mod redundant;
pub mod self_test;
pub mod settings;
pub mod storage;
pub mod supervisor;
pub mod tick;
pub mod time;

/// Version of the firmware, as its Hello tells it: major, minor, patch.
pub const VERSION: [u16; 3] =
    [decimal(env!("CARGO_PKG_VERSION_MAJOR")), decimal(env!("CARGO_PKG_VERSION_MINOR")), decimal(env!("CARGO_PKG_VERSION_PATCH"))];

/// The number that decimal digits stand for; anything else fails to compile.
const fn decimal(digits: &str) -> u16 {
    match u16::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => unreachable!(),
    }
}
