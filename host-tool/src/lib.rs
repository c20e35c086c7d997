//! The host side of the catheter rig: everything behind the `catheter` command.
//!
//! Data flows one way through the modules: [`excitation`] makes input signals, [`plant`] turns them into recordings,
//! [`recording`] reads and writes them, [`identify`] and [`train`] fit models to them, [`import`] takes
//! networks trained elsewhere, [`model`] is what all models have in common,
//! [`evaluate`] judges them, [`export`] takes them to the microcontroller, [`link`] speaks to it
//! through a [`backend`], [`experiment`] plays excitations to it, [`operate`] lets people operate it, [`replay_log`] keeps what it did and runs it again, and [`report`] shows them.

// Standard output goes through `say!`, which does not panic when its reader has left.
#![cfg_attr(not(test), warn(clippy::print_stdout))]

pub use modelling::{discover, evaluate, export, fit, identify, import, model, network, train};
pub use rig_link::{
    backend, bootloader, calibrate, device_settings, energise, experiment, feed, history, interrupt, link, operate, replay_log,
    setting_words,
};
pub use simulation::{excitation, plant};
pub use {output, output::say, recording, virtual_rig as rig};

pub mod cli;
pub mod control;
pub mod demo;
pub mod report;
pub mod track;
pub mod tune;
