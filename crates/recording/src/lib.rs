//! Recordings: runs of inputs and an output over time, read from and written to text, archives of numpy, MAT files and MCAP.
//!
//! Terms. A *recording* is one run: a file, or a part of a file that a column sets apart. A *gap* is a step of time in which something
//! that matters could have gone unseen, see [`clock`]; *jitter* is any smaller unevenness of the steps. A *glitch* is a time stamp that is
//! wrong and whose neighbours are right; it is repaired and a [`Note`] says so. A *note* is what reading found or did, said once.
//!
//! Our own files have one header line and the columns `time_s,pressure_bar,displacement_mm`, optionally `pressure_measured_bar`,
//! `sequence`, `temperature_c` and `session_time_s`. Any other file is read with a [`ColumnMap`].
//!
//! # Example
//! ```
//! use std::path::Path;
//!
//! use recording::ColumnMap;
//!
//! let text = "time_s,pressure_bar,displacement_mm\n0,0,0\n0.02,0.5,0.1\n0.04,1,0.4\n0.06,0.5,0.35\n";
//! let run = recording::parse(Path::new("loop.csv"), text.as_bytes(), &ColumnMap::own())?;
//! assert_eq!(run.len(), 4);
//! assert!((run.sample_period_s - 0.02).abs() < 1e-12);
//! assert_eq!(run.output_signal.column(), "displacement_mm");
//!
//! // Columns of others, with their units.
//! let text = "t_s;voltage_V;displacement_um\n0;0;0\n0.01;1;2\n0.02;2;5\n0.03;1;4\n";
//! let map = ColumnMap::parse("time=t_s,input=voltage_V,output=displacement_um").expect("three roles");
//! assert_eq!(recording::parse(Path::new("piezo.csv"), text.as_bytes(), &map)?.output, [0.0, 2.0, 5.0, 4.0]);
//! # Ok::<(), recording::RecordingError>(())
//! ```

mod arrays;
pub mod check;
pub mod clock;
mod columns;
pub mod condition;
pub mod drift;
mod error;
mod extremes;
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
mod plain;
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
mod text;
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
