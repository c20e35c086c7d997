//! The project's chores: `cargo xtask test | ci | bench | fuzz | firmware | flash | python | setup`, the same for a person and for continuous integration.

mod bench;
mod board_model;
mod browser;
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
    /// Build and seal the flashable image of a board.
    Firmware(OfBoard),
    /// Build the flashable image, and the program that runs it on a model of its chip (`catheter ... --backend board-model`).
    BoardModel,
    /// Prove at link time that no panic is reachable from the tick.
    PanicFree,
    /// Build, seal and flash the image with a debug probe, then show its logs.
    Flash(OfBoard),
    /// Build the image in this folder and in another one, and see that both are the same file.
    Reproducible(OfBoard),
    /// Change files at random, and see that every reader ends in a result or a clear refusal, soon and in little memory.
    Fuzz(FuzzArguments),
    /// Build the Python package in an environment of its own and run its tests and its notebook.
    Python,
    /// Install what `test` needs and this machine lacks: the Rust target, rustfmt, clippy, QEMU.
    Setup,
}

/// How long to search.
#[derive(clap::Args)]
struct FuzzArguments {
    /// Minutes.
    #[arg(long, value_name = "N", default_value_t = 60.0)]
    minutes: f64,
    /// Seed of the changes; an input is told by it and can be made again.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
}

/// Which board.
#[derive(clap::Args)]
struct OfBoard {
    /// The board.
    #[arg(long, value_name = "NAME", default_value = firmware::BOARDS[0].name, value_parser = firmware::Board::named)]
    board: &'static firmware::Board,
}

fn main() -> ExitCode {
    let result = match Cli::parse().chore {
        Chore::Test => test(),
        Chore::Ci => checks::desktop(),
        Chore::Bench(arguments) => bench::bench(&arguments),
        Chore::Firmware(of) => setup::target().and_then(|()| firmware::build(of.board)).map(drop),
        Chore::BoardModel => setup::target().and_then(|()| firmware::build(&firmware::BOARDS[0])).and_then(|_| board_model::build()),
        Chore::PanicFree => setup::target().and_then(|()| firmware::panic_free()),
        Chore::Flash(of) => setup::target().and_then(|()| firmware::flash(of.board)),
        Chore::Reproducible(of) => setup::target().and_then(|()| firmware::reproducible(of.board)),
        Chore::Fuzz(of) => checks::fuzz(of.minutes, of.seed),
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
    for board in &firmware::BOARDS {
        firmware::build(board)?;
    }
    firmware::reproducible(&firmware::BOARDS[0])?;
    firmware::panic_free()?;
    emulator::boots()?;
    emulator::tests()?;
    emulator::flashable_image()?;
    emulator::processor_in_the_loop()?;
    board_model::tests()?;
    browser::tests()?;
    demo::runs()?;
    python::tests()
}
