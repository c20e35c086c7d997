//! The dashboard in a real browser.

use anyhow::{Result, ensure};

use crate::process::{cargo, exists, run};
use crate::setup::BROWSER_DRIVER;
use crate::{board_model, demo, emulator};

/// Tests that measure times of the device or of the processor: one after the other, for two browsers make each other late.
const TIMED: [&str; 3] = ["abandoned", "four_watchers", "the_first_sample"];

/// The tests that plain `cargo test` leaves out, but for those that measure times. Most of them wait for a rig in real time, and two wait beside
/// each other.
pub fn tests() -> Result<()> {
    ensure!(
        exists(BROWSER_DRIVER),
        "{BROWSER_DRIVER} is missing, and without it nobody tests the dashboard; `cargo xtask setup` installs it"
    );
    run("dashboard in a browser", test("2")?.args(TIMED.iter().flat_map(|name| ["--skip", name])))
}

/// Those that measure times; nothing else should run.
pub fn timed_tests() -> Result<()> {
    run("dashboard in a browser, times", test("1")?.args(TIMED))
}

/// With the page of the demo and the images that rigs behind the dashboard run.
fn test(threads: &str) -> Result<std::process::Command> {
    let mut command = cargo();
    command.env("CATHETER_DEMO_PAGE", demo::page()?);
    emulator::environment(board_model::environment(&mut command)?)?;
    command.args(["test", "--workspace", "--test", "dashboard", "--", "--ignored", "--nocapture", "--test-threads", threads]);
    Ok(command)
}
