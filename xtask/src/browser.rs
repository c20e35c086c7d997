//! The dashboard in a real browser.

use anyhow::{Result, ensure};

use crate::process::{cargo, exists, run};
use crate::setup::BROWSER_DRIVER;

/// The tests that plain `cargo test` leaves out. One after the other: two browsers at a time make each other late.
pub fn tests() -> Result<()> {
    ensure!(
        exists(BROWSER_DRIVER),
        "{BROWSER_DRIVER} is missing, and without it nobody tests the dashboard; `cargo xtask setup` installs it"
    );
    run(
        "dashboard in a browser",
        cargo().args(["test", "--workspace", "--test", "dashboard", "--", "--ignored", "--nocapture", "--test-threads", "1"]),
    )
}
