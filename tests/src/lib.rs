//! Helpers shared by the tests that need more than one package.

pub mod board;
pub mod board_faults;
pub mod board_model;
pub mod drift;
pub mod emulator;
pub mod figures;
pub mod flashable;
pub mod hybrid;
pub mod models;
pub mod snapshot;
