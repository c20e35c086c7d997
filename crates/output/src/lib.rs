//! What commands leave behind: files written whole or not at all, JSON results, lines on standard output, progress.
//!
//! # Example
//! ```
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("result.json");
//! output::write_json(&path, &[0.0064, 0.0069])?; // mm
//! assert_eq!(serde_json::from_str::<Vec<f64>>(&output::read_text(&path)?)?, [0.0064, 0.0069]);
//! # Ok::<(), anyhow::Error>(())
//! ```

// First: the other files use its macros.
#[macro_use]
mod console;
mod files;
mod input;
mod kind;
mod lock;
mod manner;
mod piped;
mod place;
mod plain;
mod progress;
pub mod provenance;
pub mod text;

pub use console::{finish, print_bytes, print_detail, print_line};
pub use files::{
    check_file, check_folder, file_argument, folder_argument, free_folder, refuse_overwriting, write_atomic, write_json, write_result,
};
pub use input::{MOST_BYTES, open, read, read_text};
pub use lock::{Locked, lock};
pub use manner::{Loudness, allow_replacing, loudness, may_replace, refuse_any, refuse_replacing, set_loudness};
pub use plain::{brief, plain};
pub use progress::{Stages, Working, progress, stages, working};
