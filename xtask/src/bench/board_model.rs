//! The flashable image on the model of its chip.

use anyhow::Result;
use serde_json::Value;

use super::files::{fresh_folder, read_json};
use crate::process::{cargo, run};
use crate::{board_model, firmware, setup};

/// Builds image and program, runs the closed loop and the faults, and gives back the figures.
pub fn measure() -> Result<Value> {
    setup::target()?;
    firmware::build(&firmware::BOARDS[0])?;
    board_model::build()?;
    let path = fresh_folder("board-model")?.join("figures.json");
    let mut measure = cargo();
    measure.args(["run", "--release", "--package", "rig-tests", "--bin", "board_model_figures", "--", "--json"]).arg(&path);
    run("board model", board_model::environment(&mut measure)?)?;
    read_json(&path)
}
