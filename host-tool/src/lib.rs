//! The host side of the catheter rig: everything behind the `catheter` command.
//!
//! Data flows one way through the modules: [`excitation`] makes input signals, [`plant`] turns them into recordings,
//! [`recording`] reads and writes them, [`identify`] and [`train`] fit models to them, [`import`] takes
//! networks trained elsewhere, [`model`] is what all models have in common,
//! [`evaluate`] judges them, [`export`] takes them to the microcontroller, [`link`] speaks to it
//! through a [`backend`], [`experiment`] plays excitations to it, [`operate`] lets people operate it, [`journal`] keeps what it did and runs it again, and [`report`] shows them.

// Standard output goes through `say!`, which does not panic when its reader has left.
#![cfg_attr(not(test), warn(clippy::print_stdout))]

pub use {output, output::say, recording, virtual_rig as rig};

pub mod backend;
pub mod bootloader;
pub mod calibrate;
pub mod cli;
pub mod demo;
pub mod device_settings;
pub mod discover;
pub mod energise;
pub mod evaluate;
pub mod excitation;
pub mod experiment;
pub mod export;
pub mod feed;
pub mod fit;
pub mod history;
pub mod identify;
pub mod import;
pub mod interrupt;
pub mod journal;
pub mod link;
pub mod model;
pub mod network;
pub mod operate;
pub mod plant;
pub mod report;
pub mod setting_words;
pub mod track;
pub mod train;
pub mod tune;
