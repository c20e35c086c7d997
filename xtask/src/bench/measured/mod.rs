//! The public measured sets: `catheter fit` beside independent baselines, and what `identify` and `train` reach by themselves.

mod checks;
mod compare;
mod distort;
mod fit;
mod identify;

use std::path::Path;

use anyhow::Result;
use serde_json::{Value, json};

use super::arguments::{Arguments, Maps};

/// Measures the maps asked for and prints the tables.
pub fn measure(recordings: &Path, arguments: &Arguments) -> Result<Value> {
    let fitted = fit::measure(recordings, arguments)?;
    let identified = if arguments.maps == Maps::All { Some(identify::measure(recordings, arguments)?) } else { None };
    Ok(json!({ "fit": fitted, "identify": identified }))
}
