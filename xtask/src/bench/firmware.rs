//! The firmware's figures: what it costs, counted in the emulator, and the memory that the flashable image takes.

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::files::fresh_folder;
use crate::process::{cargo, run};
use crate::{checks, firmware, setup};

/// Builds the images, counts, prints the tables and gives back the figures; `bless` renews the record of the tests.
pub fn measure(bless: bool) -> Result<Value> {
    setup::everything()?;
    checks::target_builds()?;
    let sizes = firmware::build(&firmware::BOARDS[0])?;
    let as_flashed = firmware::emulated_as_flashed()?;
    let path = fresh_folder("firmware")?.join("figures.json");
    let mut count = cargo();
    count.args(["run", "--release", "--package", "rig-tests", "--bin", "firmware_figures", "--", "--json"]).arg(&path);
    count.arg("--image").arg(firmware::image()).arg("--stack").arg(sizes.stack.to_string());
    if bless {
        count.arg("--bless");
    }
    run("firmware", &mut count)?;
    let mut count = cargo();
    count.args(["run", "--release", "--package", "rig-tests", "--bin", "firmware_figures", "--", "--counts-only"]);
    run("firmware, optimised as flashed", count.env("CATHETER_EMULATED_IMAGE", as_flashed))?;
    println!("Flashable image: {} bytes of flash, {} of RAM, of which {} are stack.", sizes.flash, sizes.ram, sizes.stack);
    let text = std::fs::read_to_string(&path).with_context(|| format!("the figures are missing: {}", path.display()))?;
    let mut figures: Value = serde_json::from_str(&text).with_context(|| format!("{}: no JSON", path.display()))?;
    for (name, bytes) in [("flash_bytes", sizes.flash), ("ram_bytes", sizes.ram), ("stack_reserved_bytes", sizes.stack)] {
        figures[name] = json!(bytes);
    }
    Ok(figures)
}
