//! The headline measurements, as tables ready for the README and as JSON: accuracy over fresh seeds, measured recordings, training speed,
//! the firmware's instructions and memory, what discovery finds in hidden cases, controllers.
//!
//! Nothing of ours is linked in: every figure comes from running the built commands, as a user would.

mod accuracy;
mod arguments;
mod board_model;
mod control;
mod discover;
mod files;
mod firmware;
mod jumps;
mod measured;
mod reading;
mod table;
mod time_to_error;
mod training;

use anyhow::Result;
use serde_json::{Map, Value};

pub use arguments::Arguments;

use crate::process::{cargo, run};
use arguments::What;
use files::{machine, write_json};

/// Runs the measurements asked for and prints their tables.
pub fn bench(arguments: &Arguments) -> Result<()> {
    let wanted = |what| arguments.what.is_empty() || arguments.what.contains(&what);
    if arguments.what == [What::BoardModel] {
        let figures = board_model::measure()?;
        return arguments.json.as_ref().map_or(Ok(()), |path| write_json(path, &figures));
    }
    if arguments.what == [What::Firmware] {
        let figures = firmware::measure(arguments.bless)?;
        return arguments.json.as_ref().map_or(Ok(()), |path| write_json(path, &figures));
    }
    run(
        "build",
        cargo().args([
            "build",
            "--release",
            "--package",
            "host-tool",
            "--bin",
            "catheter",
            "--example",
            "training_throughput",
            "--example",
            "time_to_error",
            "--package",
            "recording",
            "--example",
            "reading_rate",
        ]),
    )?;
    let mut results = Map::new();
    results.insert("machine".to_owned(), machine());
    if wanted(What::Training) {
        results.insert("training".to_owned(), training::measure()?);
    }
    if wanted(What::Reading) {
        results.insert("reading".to_owned(), reading::measure()?);
    }
    if wanted(What::TimeToError) {
        results.insert("time_to_error".to_owned(), time_to_error::measure(arguments)?);
    }
    if wanted(What::Control) {
        results.insert("control".to_owned(), control::measure(arguments)?);
    }
    if wanted(What::Measured) {
        match &arguments.recordings {
            Some(folder) => {
                let folder = std::path::absolute(folder)?;
                results.insert("measured".to_owned(), measured::measure(&folder, arguments)?);
            }
            None if arguments.what.contains(&What::Measured) => {
                anyhow::bail!(
                    "the measured sets are not part of the project; name their folder with --recordings (docs/how-to/import-recordings.md says where to get them)"
                )
            }
            None => eprintln!("the measured sets are left out: no --recordings"),
        }
    }
    if wanted(What::Jumps) {
        results.insert("jumps".to_owned(), jumps::measure(arguments)?);
    }
    if wanted(What::Firmware) {
        results.insert("firmware".to_owned(), firmware::measure(arguments.bless)?);
    }
    if wanted(What::BoardModel) {
        results.insert("board_model".to_owned(), board_model::measure()?);
    }
    if wanted(What::Discover) {
        results.insert("discover".to_owned(), discover::measure(arguments)?);
    }
    if wanted(What::Accuracy) {
        results.insert("accuracy".to_owned(), accuracy::measure(arguments)?);
    }
    if let Some(path) = &arguments.json {
        write_json(path, &Value::Object(results))?;
    }
    Ok(())
}
