//! The project's chores: `cargo xtask test | ci | bench | firmware | flash | python | setup`, the same for a person and for continuous integration.

mod bench;
mod board_model;
mod checks;
mod demo;
mod emulator;
mod firmware;
mod process;
mod python;
mod setup;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The project's chores.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", max_term_width = 120)]
struct Cli {
    #[command(subcommand)]
    chore: Chore,
}

#[derive(Subcommand)]
enum Chore {
    /// Everything: installs what is missing, then format, lints, documentation, tests, target builds, the emulated target, the board's
    /// model, the demo, the Python package.
    Test,
    /// What needs nothing but Rust with rustfmt and clippy: format, lints, documentation, tests. Installs nothing.
    Ci,
    Bench(bench::Arguments),
    /// Build and seal the flashable image.
    Firmware,
    /// Build the flashable image, and the program that runs it on a model of its chip (`catheter ... --backend board-model`).
    BoardModel,
    /// Prove at link time that no panic is reachable from the tick.
    PanicFree,
    /// Build, seal and flash the image with a debug probe, then show its logs.
    Flash,
    /// Build the Python package in an environment of its own and run its tests and its notebook.
    Python,
    /// Install what `test` needs and this machine lacks: the Rust target, rustfmt, clippy, QEMU.
    Setup,
}

fn main() -> ExitCode {
    let result = match Cli::parse().chore {
        Chore::Test => test(),
        Chore::Ci => checks::desktop(),
        Chore::Bench(arguments) => bench::bench(&arguments),
        Chore::Firmware => setup::target().and_then(|()| firmware::build()).map(drop),
        Chore::BoardModel => setup::target().and_then(|()| firmware::build()).and_then(|_| board_model::build()),
        Chore::PanicFree => setup::target().and_then(|()| firmware::panic_free()),
        Chore::Flash => setup::target().and_then(|()| firmware::flash()),
        Chore::Python => python::tests(),
        Chore::Setup => setup::everything(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn test() -> anyhow::Result<()> {
    setup::everything()?;
    checks::desktop()?;
    checks::target_builds()?;
    firmware::build()?;
    firmware::panic_free()?;
    emulator::boots()?;
    emulator::tests()?;
    emulator::flashable_image()?;
    emulator::processor_in_the_loop()?;
    board_model::tests()?;
    demo::runs()?;
    python::tests()
}
