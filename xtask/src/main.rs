//! The project's tasks, the same for a person and for continuous integration. `cargo xtask --help` lists each with its time.

mod bench;
mod beside;
mod board_model;
mod book;
mod browser;
mod checks;
mod demo;
mod emulator;
mod firmware;
mod licences;
mod process;
mod publish;
mod python;
mod setup;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The project's tasks. Times are of two idle cores; the first run of most of them also builds.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", max_term_width = 120)]
struct Cli {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Everything, as continuous integration: format, lints, documentation, tests, target builds, the emulated target, the board's model, the
    /// browser, the demo, the Python package, the book. Installs what is missing. 33 min from nothing.
    Test,
    /// What needs nothing but Rust with rustfmt and clippy: format, lints, documentation, tests. Installs nothing. 25 min from nothing.
    Ci,
    /// Measurements behind the Results of the book; each bench's help says its time. Minutes to hours.
    Bench(bench::Arguments),
    /// Build the book into target/book. 2 s; 2 min more when mdBook must be installed.
    Book(OfBook),
    /// Check licences, sources and duplicates of dependencies by deny.toml. Needs cargo-deny. 10 s.
    Deny(OfDeny),
    /// Check licences and sources of all dependencies by deny.toml, with nothing to install. 2 s.
    Licences,
    /// Check that hysteresis and model-export build with the oldest compiler they promise and as a registry would get them. 2 min.
    Publishable,
    /// Compare the public items of hysteresis and model-export with an earlier commit. Needs cargo-semver-checks. 1 min.
    Semver(OfRevision),
    /// Write what the firmware and the command are made of into target/sbom, as CycloneDX. 2 s.
    Sbom,
    /// Build the flashable image of a board and add its CRC. 2 min.
    Firmware(OfBoard),
    /// Build the flashable image, and the program that runs it on a model of its chip (`catheter ... --backend board-model`). 4 min once.
    BoardModel,
    /// Prove at link time that no panic is reachable from the tick. 2 min.
    PanicFree,
    /// Build and flash the image with a debug probe, then show its logs. 2 min, then until Ctrl-C.
    Flash(OfBoard),
    /// Build the image in this folder and in another one, and see that both are the same file. 4 min.
    Reproducible(OfBoard),
    /// Change files at random, and see that every reader ends in a result or a clear refusal, soon and in little memory. 60 min, or `--minutes`.
    Fuzz(FuzzArguments),
    /// Build the Python package in an environment of its own and run its tests and its notebook. 4 min.
    Python,
    /// Build what the later stages of `test` need: images, board model, release command. `test` does it beside its tests. 10 min.
    Builds,
    /// What `test` proves by builds alone: the image is reproducible, its tick panic-free, the packages publishable. Also beside tests. 8 min.
    Proofs,
    /// Install what `test` needs and this machine lacks: the Rust target, rustfmt, clippy, QEMU, a browser. Minutes once.
    Setup,
    /// Turn the equations of the book into MathML; mdBook calls this.
    #[command(hide = true)]
    Equations {
        /// `supports RENDERER`: whether that is possible; it always is.
        asked: Vec<String>,
    },
}

/// How to show the book.
#[derive(clap::Args)]
struct OfBook {
    /// Open it in the browser.
    #[arg(long)]
    open: bool,
}

/// What to compare with.
#[derive(clap::Args)]
struct OfRevision {
    /// A commit or tag, usually that of the last release.
    #[arg(long, value_name = "REVISION")]
    against: String,
}

/// What to check.
#[derive(clap::Args)]
struct OfDeny {
    /// Also ask the advisory database, which is fetched from the network.
    #[arg(long)]
    advisories: bool,
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
    let result = match Cli::parse().task {
        Task::Test => test(),
        Task::Ci => checks::desktop(),
        Task::Bench(arguments) => bench::bench(&arguments),
        Task::Firmware(of) => setup::target().and_then(|()| firmware::build(of.board)).map(drop),
        Task::BoardModel => setup::target().and_then(|()| firmware::build(&firmware::BOARDS[0])).and_then(|_| board_model::build()),
        Task::PanicFree => setup::target().and_then(|()| firmware::panic_free()),
        Task::Flash(of) => setup::target().and_then(|()| firmware::flash(of.board)),
        Task::Reproducible(of) => setup::target().and_then(|()| firmware::reproducible(of.board)),
        Task::Builds => beside::builds(),
        Task::Proofs => beside::proofs(),
        Task::Fuzz(of) => checks::fuzz(of.minutes, of.seed),
        Task::Python => python::tests(),
        Task::Setup => setup::everything(),
        Task::Book(of) => book::build(of.open),
        Task::Deny(of) => book::deny(of.advisories),
        Task::Licences => licences::check(),
        Task::Publishable => publish::check(),
        Task::Semver(of) => publish::semver(&of.against),
        Task::Sbom => publish::bill_of_materials(),
        Task::Equations { asked } if asked.is_empty() => book::equations(),
        Task::Equations { .. } => Ok(()),
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
    let builds = beside::start(beside::Task::Builds)?;
    checks::desktop()?;
    builds.finish()?;
    let proofs = beside::start(beside::Task::Proofs)?;
    demo::runs()?;
    browser::tests()?;
    emulator::boots()?;
    emulator::tests()?;
    emulator::flashable_image()?;
    emulator::processor_in_the_loop()?;
    board_model::tests()?;
    python::tests()?;
    licences::check()?;
    publish::bill_of_materials()?;
    book::build(false)?;
    proofs.finish()?;
    browser::timed_tests()
}
