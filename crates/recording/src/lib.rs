//! Recordings: runs of inputs and an output over time, read from and written to text, archives of numpy, MAT files and MCAP.
//!
//! Terms. A *recording* is one run: a file, or a part of a file that a column sets apart. A *gap* is a step of time in which something
//! that matters could have gone unseen, see [`clock`]; *jitter* is any smaller unevenness of the steps. A *glitch* is a time stamp that is
//! wrong and whose neighbours are right; it is repaired and a [`Note`] says so. A *note* is what reading found or did, said once.
//!
//! Our own files have one header line and the columns `time_s,pressure_bar,displacement_mm`, optionally `pressure_measured_bar`,
//! `sequence`, `temperature_c` and `session_time_s`. Any other file is read with a [`ColumnMap`].

mod arrays;
pub mod check;
pub mod clock;
mod columns;
pub mod condition;
pub mod drift;
mod error;
mod format;
pub mod groups;
mod hashed;
mod header;
pub mod held;
mod history;
mod lines;
mod note;
mod number;
mod options;
mod parts;
pub mod prepare;
mod read;
mod record;
mod repair;
pub mod repeatability;
pub mod resample;
mod row_lines;
pub mod scale;
pub mod simulation;
mod surface;
mod table;
mod unfold;
mod write;

pub use columns::{ColumnMap, ColumnName, signal};
pub use error::RecordingError;
pub use note::{Note, Subject};
pub use options::{Prepare, ReadOptions, Resample};
pub use parts::LARGEST;
pub use read::{files, load, load_with, parse, read};
pub use record::{Channel, ExtraColumn, Recording, Signal, Timing};
pub use write::{ENDINGS, encode, write, write_as};

#[cfg(test)]
mod tests;
