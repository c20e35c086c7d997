//! Firmware logic for the catheter rig: no heap, no panic, and every line of it runs on the desktop too.
#![no_std]
#![forbid(unsafe_code)]

pub mod estimator;
