//! Firmware logic for the catheter rig: no heap, no panic, and every line of it runs on the desktop too.
#![no_std]
#![forbid(unsafe_code)]

pub mod calibration;
pub mod control;
pub mod decimate;
pub mod estimator;
pub mod limiter;
pub mod link;
pub mod model;
pub mod number;
pub mod plausibility;
pub mod retain;
pub mod seam;
pub mod self_test;
pub mod settings;
pub mod storage;
pub mod supervisor;
pub mod tick;
