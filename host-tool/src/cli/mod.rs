//! The command line: what the user typed becomes validated objects here, once; the work is done elsewhere.

mod bench;
mod check;
mod common;
mod completions;
mod convert;
mod dashboard;
mod demo;
mod discover;
mod evaluate;
mod explain;
mod export;
mod fit;
mod help;
mod hide;
mod identify;
mod import_network;
mod init;
mod inspect;
mod lab;
mod man;
mod pil;
mod plan_experiment;
mod reading;
mod replay;
mod rig;
mod simulate;
mod track;
mod train;
mod tune;

use std::io::Write;
use std::process::ExitCode;

use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};

pub use common::{Common, Outcome, Results};
pub use reading::{Data, Reading};

use crate::output::{self, Loudness};

/// Hysteresis of a pneumatic catheter: simulate, identify, train, evaluate, export.
#[derive(Parser)]
#[command(name = "catheter", version, about, long_about = None, after_long_help = help::OVERVIEW)]
struct Cli {
    #[command(flatten)]
    manners: Manners,
    #[command(subcommand)]
    command: Command,
}

/// What every command understands.
#[derive(Args)]
struct Manners {
    /// Say nothing but errors, warnings and failed checks: the results are in the files and in the exit code.
    #[arg(long, short, global = true, conflicts_with = "verbose", help_heading = EVERYWHERE)]
    quiet: bool,
    /// Say on standard error what is read and written, and when.
    #[arg(long, short, global = true, help_heading = EVERYWHERE)]
    verbose: bool,
    /// Replace results that exist already. Without it they are kept: files are refused, report folders get a number. `CATHETER_FORCE=1` in the
    /// environment says the same.
    #[arg(long, global = true, help_heading = EVERYWHERE)]
    force: bool,
}

/// Heading of these options in the help.
const EVERYWHERE: &str = "Everywhere";

#[derive(Subcommand)]
enum Command {
    Simulate(simulate::Arguments),
    Fit(fit::Arguments),
    #[command(after_long_help = help::INIT)]
    Init(init::Arguments),
    Check(check::Arguments),
    #[command(after_long_help = help::CONVERT)]
    Convert(convert::Arguments),
    Identify(identify::Arguments),
    #[command(after_long_help = help::TRAIN)]
    Train(train::Arguments),
    #[command(after_long_help = help::EVALUATE)]
    Evaluate(evaluate::Arguments),
    Export(export::Arguments),
    #[command(after_long_help = help::IMPORT_NETWORK)]
    ImportNetwork(import_network::Arguments),
    Inspect(inspect::Arguments),
    #[command(after_long_help = help::RIG)]
    Rig(rig::Arguments),
    #[command(after_long_help = help::DASHBOARD)]
    Dashboard(dashboard::Arguments),
    #[command(after_long_help = help::REPLAY)]
    Replay(replay::Arguments),
    #[command(after_long_help = help::PIL)]
    Pil(pil::Arguments),
    #[command(after_long_help = help::EXPLAIN)]
    Explain(explain::Arguments),
    #[command(after_long_help = help::DEMO)]
    Demo(demo::Arguments),
    Tune(tune::Arguments),
    Track(track::Arguments),
    #[command(after_long_help = help::DISCOVER)]
    Discover(discover::Arguments),
    #[command(after_long_help = help::PLAN_EXPERIMENT)]
    PlanExperiment(plan_experiment::Arguments),
    #[command(after_long_help = help::HIDE)]
    Hide(hide::Arguments),
    #[command(hide = true)]
    Bench(bench::Arguments),
    #[command(after_long_help = help::COMPLETIONS)]
    Completions(completions::Arguments),
    #[command(after_long_help = help::MAN)]
    Man(man::Arguments),
}

/// Runs the command line and turns the outcome into the exit code: 0 done, 1 a check failed, 2 usage or input.
#[must_use]
pub fn main() -> ExitCode {
    // Before the parser, whose checks of the files to write need it. Benchmarks go on with the files they have.
    let mut words = std::env::args_os().skip(1);
    let is_bench = words.next().is_some_and(|word| word == "bench");
    let forced = std::env::args_os().any(|word| word == "--force") || std::env::var_os("CATHETER_FORCE").is_some_and(|value| value == "1");
    if forced || is_bench {
        output::allow_replacing();
    }
    let lab = lab::find();
    let backend = lab.as_ref().ok().and_then(|lab| lab.as_ref()?.rig.backend.clone());
    let matches = backend.map_or_else(Cli::command, |backend| with_backend(Cli::command(), backend)).get_matches();
    let seed = matches.subcommand().and_then(|(_, words)| words.try_get_one::<u64>("seed").ok().flatten().copied());
    output::provenance::begin(env!("CARGO_PKG_VERSION"), seed);
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    if cli.manners.quiet {
        output::set_loudness(Loudness::Quiet);
    } else if cli.manners.verbose {
        output::set_loudness(Loudness::Verbose);
    }
    output::detail!("catheter {}, seed {}", env!("CARGO_PKG_VERSION"), seed.map_or_else(|| "none".to_owned(), |seed| seed.to_string()));
    let result = match cli.command {
        // A rig of the lab's file must not become a simulated one because the file is wrong.
        Command::Rig(_) | Command::Track(_) | Command::Dashboard(_) if lab.is_err() => lab.map(|_| Outcome::Success),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Fit(arguments) => fit::run(&arguments),
        Command::Init(arguments) => init::run(&arguments),
        Command::Check(arguments) => check::run(&arguments),
        Command::Convert(arguments) => convert::run(&arguments),
        Command::Identify(arguments) => identify::run(&arguments),
        Command::Train(arguments) => train::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::ImportNetwork(arguments) => import_network::run(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Rig(arguments) => rig::run(&arguments),
        Command::Dashboard(arguments) => dashboard::run(&arguments),
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Pil(arguments) => pil::run(&arguments),
        Command::Explain(arguments) => explain::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Tune(arguments) => tune::run(&arguments),
        Command::Track(arguments) => track::run(&arguments),
        Command::Discover(arguments) => discover::run(&arguments),
        Command::PlanExperiment(arguments) => plan_experiment::run(&arguments),
        Command::Hide(arguments) => hide::run(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments, &mut Cli::command()),
        Command::Man(arguments) => man::run(&arguments, Cli::command()),
    };
    // What the command said belongs to its result: a full disk behind `> table.txt` must not look like success.
    let result = result.and_then(|outcome| output::finish().map(|()| outcome));
    match result {
        Ok(Outcome::Success) => ExitCode::SUCCESS,
        Ok(Outcome::CheckFailed) => ExitCode::from(1),
        Err(error) => {
            // Not eprintln: it panics when nobody reads standard error any more.
            let _ = writeln!(std::io::stderr(), "{}", output::plain(&output::brief(&format!("error: {error:#}"))));
            ExitCode::from(2)
        }
    }
}

/// Commands that speak to a rig.
const ON_A_RIG: [&str; 3] = ["rig", "track", "dashboard"];

/// The command line with the lab's rig where nothing else is said.
fn with_backend(command: clap::Command, backend: String) -> clap::Command {
    // Once in a process: the parser keeps its defaults for ever.
    let backend: &'static str = backend.leak();
    ON_A_RIG
        .into_iter()
        .fold(command, |command, name| command.mut_subcommand(name, |one| one.mut_arg("backend", |option| option.default_value(backend))))
}
