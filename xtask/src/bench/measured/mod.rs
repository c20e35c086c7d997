//! The public measured sets: `catheter fit` beside independent baselines, and what `identify` and `train` reach by themselves.

mod checks;
mod compare;
mod fit;
mod identify;

use std::path::Path;

use anyhow::Result;
use serde_json::{Value, json};

use super::Arguments;

/// Which of the maps in `tests/baselines/maps.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Maps {
    /// Those that may be looked at while `fit` is developed.
    Development,
    /// Those that published figures come from. Whoever tunes by them makes them worthless.
    Reporting,
    /// Both, and the figures of `identify` and `train`.
    All,
}

impl Maps {
    /// As the role stands in the index, or on the command line of the Python script.
    fn name(self) -> &'static str {
        match self {
            Self::Development => "development",
            Self::Reporting => "reporting",
            Self::All => "all",
        }
    }
}

/// Measures the maps asked for and prints the tables.
pub fn measure(recordings: &Path, arguments: &Arguments) -> Result<Value> {
    let fitted = fit::measure(recordings, arguments)?;
    let identified = if arguments.maps == Maps::All { Some(identify::measure(recordings, arguments)?) } else { None };
    Ok(json!({ "fit": fitted, "identify": identified }))
}
