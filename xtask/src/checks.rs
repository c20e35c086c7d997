//! The checks a change must pass: format, lints, documentation, tests, builds for the microcontroller.

use anyhow::Result;

use crate::process::{cargo, run};
use crate::setup::TARGET;

/// Everything that runs on a desktop with nothing but Rust.
pub fn desktop() -> Result<()> {
    run("format", cargo().args(["fmt", "--all", "--check"]))?;
    run("lints", cargo().args(["clippy", "--workspace", "--all-targets", "--", "--deny", "warnings"]))?;
    // With the examples, dependencies have the features that the lints have checked them with, and are not checked again.
    let mut documentation = cargo();
    documentation.args(["doc", "--workspace", "--no-deps", "--lib", "--bins", "--examples"]);
    run("documentation", documentation.env("RUSTDOCFLAGS", "--deny warnings"))?;
    run("tests", cargo().args(["test", "--workspace", "--no-fail-fast"]))
}

/// The packages that run on the microcontroller, built for it, its binaries linked against `memory.x`.
pub fn target_builds() -> Result<()> {
    run(
        "target builds",
        cargo().args(["build", "--release", "--target", TARGET, "-p", "hysteresis", "-p", "model-export", "-p", "firmware"]),
    )?;
    run(
        "target tests, built only: they need the chip",
        cargo().args(["test", "--no-run", "--release", "--target", TARGET, "-p", "firmware", "--test", "on_target"]),
    )?;
    run("target lints", cargo().args(["clippy", "--release", "--target", TARGET, "-p", "firmware", "--", "--deny", "warnings"]))
}

/// Changed files for every reader, for so many minutes.
pub fn fuzz(minutes: f64, seed: u64) -> Result<()> {
    let mut command = cargo();
    command.args(["test", "--release", "-p", "fuzz", "--test", "bounded", "--", "--nocapture"]);
    run("changed files", command.env("FUZZ_MINUTES", minutes.to_string()).env("FUZZ_SEED", seed.to_string()))
}
