//! The flashable image on a register-level model of its chip: a package with a lock file and a compiler of its own.

use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::firmware;
use crate::process::{answer, cargo, command, exists, root, run};
use crate::setup;

/// The package's folder.
const FOLDER: &str = "virtual-board";

/// The program that runs the image.
pub fn program() -> std::path::PathBuf {
    root().join(FOLDER).join("target/release/virtual-board")
}

/// Builds it, with the compiler that its folder names.
pub fn build() -> Result<()> {
    toolchain()?;
    run("board model", own_cargo().args(["build", "--release", "--locked"]))
}

/// The package's own lints and tests.
pub fn checks() -> Result<()> {
    run("board model: format", own_cargo().args(["fmt", "--check"]))?;
    run("board model: lints", own_cargo().args(["clippy", "--release", "--locked", "--all-targets", "--", "--deny", "warnings"]))?;
    run("board model: its own tests", own_cargo().args(["test", "--release", "--locked"]))
}

/// The image on it: closed loop, settings, faults.
pub fn tests() -> Result<()> {
    let mut tests = cargo();
    tests.args(["test", "--workspace", "--test", "board_model", "--test", "cli", "--", "--ignored", "--nocapture"]);
    run("board model: the flashable image", environment(&mut tests)?)
}

/// Names program and image for whoever starts them.
pub fn environment(command: &mut Command) -> Result<&mut Command> {
    let image = std::path::absolute(firmware::image())?;
    Ok(command.env("CATHETER_BOARD_MODEL", std::path::absolute(program())?).env("CATHETER_RIG_IMAGE", image))
}

/// Cargo in the package's folder, which chooses its own compiler; the one that runs us has put its choice into the environment.
fn own_cargo() -> Command {
    let mut cargo = command("cargo");
    cargo.current_dir(root().join(FOLDER));
    for variable in ["RUSTUP_TOOLCHAIN", "CARGO", "RUSTC", "CARGO_TARGET_DIR"] {
        cargo.env_remove(variable);
    }
    cargo
}

/// Installs the compiler that the folder names, if it is not there.
fn toolchain() -> Result<()> {
    let path = root().join(FOLDER).join("rust-toolchain.toml");
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let channel = text.lines().find_map(|line| line.strip_prefix("channel = \"")?.strip_suffix('"')).context("no channel is named")?;
    // A listing, because asking the compiler itself would fetch it, or fail where rustup may not.
    let installed = answer(command("rustup").args(["toolchain", "list"])).unwrap_or_default();
    let complete = installed.lines().any(|line| line.starts_with(&format!("{channel}-")))
        && answer(own_cargo().args(["clippy", "--version"])).is_some()
        && answer(own_cargo().args(["fmt", "--version"])).is_some();
    if complete {
        return Ok(());
    }
    if !exists("rustup") {
        bail!("the board's model needs Rust {channel} and there is no rustup to install it; see https://rustup.rs");
    }
    setup::toolchain(channel, &["--component", "clippy", "--component", "rustfmt"])
}
