//! Set-up: what the tests need beyond Rust, installed where the machine lets us, else an error with the command to type.

use std::process::Command;

use anyhow::{Result, bail};

use crate::process::{answer, command, exists, root, run};

/// The microcontroller's target: Cortex-M4 with single-precision floating point.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// The emulator of the microcontroller.
pub const EMULATOR: &str = "qemu-system-arm";
/// What drives a browser.
pub const BROWSER_DRIVER: &str = "chromedriver";

/// What a build from nothing, with all the tests, leaves on the disk at most, in MiB: 8.0 GiB in the build folder, 0.6 GiB in the board model's.
const BUILD_MIB: u64 = 9216;

/// Installs whatever is missing.
pub fn everything() -> Result<()> {
    room()?;
    components()?;
    target()?;
    emulator()?;
    browser()
}

/// Installs a compiler beside the one in use, with what `more` asks for.
pub fn toolchain(channel: &str, more: &[&str]) -> Result<()> {
    run("set-up", command("rustup").args(["toolchain", "install", channel, "--profile", "minimal"]).args(more))
}

/// Cargo of another compiler than the one that runs us, which has put its choice into the environment.
pub fn cargo_of(channel: &str) -> Command {
    let mut cargo = command("rustup");
    cargo.args(["run", channel, "cargo"]);
    for variable in ["RUSTUP_TOOLCHAIN", "CARGO", "RUSTC"] {
        cargo.env_remove(variable);
    }
    cargo
}

/// Room on the disk for a build from nothing. On a full disk the linker dies of a bus error that tells nobody why.
fn room() -> Result<()> {
    let built = crate::process::target_folder().join("debug").join("catheter").exists();
    if built {
        return Ok(());
    }
    let Some(table) = answer(command("df").args(["-P", "-k"]).arg(root())) else {
        return Ok(());
    };
    match free_mib(&table) {
        Some(free) if free < BUILD_MIB => {
            bail!("{free} MiB are free on the disk and the build takes up to {BUILD_MIB} MiB; make room, or set CARGO_TARGET_DIR")
        }
        _ => Ok(()),
    }
}

/// The free space in what `df -P -k` prints: the fourth column of the second line, in KiB.
fn free_mib(table: &str) -> Option<u64> {
    Some(table.lines().nth(1)?.split_whitespace().nth(3)?.parse::<u64>().ok()? / 1024)
}

/// rustfmt and clippy; a minimal rustup profile lacks them.
fn components() -> Result<()> {
    for (tool, component) in [("fmt", "rustfmt"), ("clippy", "clippy")] {
        if answer(crate::process::cargo().args([tool, "--version"])).is_some() {
            continue;
        }
        if !exists("rustup") {
            bail!("`cargo {tool}` is missing; install the package `{component}` of the distribution your Rust came from");
        }
        run("set-up", command("rustup").args(["component", "add", component]))?;
    }
    Ok(())
}

/// The microcontroller's Rust target.
pub fn target() -> Result<()> {
    if target_is_installed() {
        return Ok(());
    }
    if !exists("rustup") {
        bail!(
            "the Rust target {TARGET} is missing and there is no rustup to add it; see https://rustup.rs, then type `rustup target add {TARGET}`"
        );
    }
    run("set-up", command("rustup").args(["target", "add", TARGET]))
}

/// Asks the compiler, not rustup: the compiler of a distribution has targets as packages of its own.
fn target_is_installed() -> bool {
    answer(command("rustc").args(["--print", "target-libdir", "--target", TARGET]))
        .is_some_and(|folder| std::path::Path::new(folder.trim()).is_dir())
}

fn emulator() -> Result<()> {
    if exists(EMULATOR) {
        return Ok(());
    }
    install(
        EMULATOR,
        &[EMULATOR],
        &[
            ("apt-get", "sudo apt-get install qemu-system-arm"),
            ("dnf", "sudo dnf install qemu-system-arm"),
            ("pacman", "sudo pacman -S qemu-system-arm"),
            ("zypper", "sudo zypper install qemu-arm"),
            ("brew", "brew install qemu"),
        ],
        "install QEMU from https://www.qemu.org",
    )
}

/// A browser and its driver, which operate the dashboard in tests.
fn browser() -> Result<()> {
    if exists(BROWSER_DRIVER) {
        return Ok(());
    }
    install(
        BROWSER_DRIVER,
        &["chromium", "chromium-driver"],
        &[
            ("apt-get", "sudo apt-get install chromium chromium-driver"),
            ("dnf", "sudo dnf install chromium chromedriver"),
            ("pacman", "sudo pacman -S chromium"),
            ("brew", "brew install --cask chromium chromedriver"),
        ],
        "install Chromium and its driver",
    )
}

/// Installs packages of Debian where that is possible, else says what to type.
fn install(program: &str, packages: &[&str], managers: &[(&str, &str)], otherwise: &str) -> Result<()> {
    let is_root = answer(Command::new("id").arg("-u")).is_some_and(|id| id.trim() == "0");
    if !(is_root && exists("apt-get")) {
        let advice = managers.iter().find(|(manager, _)| exists(manager)).map_or(otherwise, |(_, line)| line);
        bail!(
            "{program} is missing; type `{advice}` and run this again (`cargo xtask ci` runs everything that needs neither emulator nor browser)"
        );
    }
    let mut install = command("apt-get");
    install.env("DEBIAN_FRONTEND", "noninteractive").args(["install", "--yes", "--no-install-recommends"]).args(packages);
    if run("set-up", &mut install).is_ok() {
        return Ok(());
    }
    // A fresh container has no package lists yet.
    run("set-up", command("apt-get").arg("update"))?;
    run("set-up", &mut install)
}

#[cfg(test)]
mod tests {
    use super::free_mib;

    #[test]
    fn the_free_space_is_read_from_the_table() {
        let table = "Filesystem 1024-blocks Used Available Capacity Mounted on\n/dev/sda1 264000000 91000000 4823449 95% /\n";
        assert_eq!(free_mib(table), Some(4710));
        assert_eq!(free_mib("no table"), None);
    }
}
